from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints

import pytest

from calrig.instruments import drivers
from calrig.instruments.errors import InstrumentError


def make_stage(url, *, axis, baudrate):
    return url, axis, baudrate


def offer(monkeypatch, **named):
    def entry_points(group):
        return EntryPoints(EntryPoint(name, value, group) for name, value in named.items())

    monkeypatch.setattr(drivers, "entry_points", entry_points)


def test_the_built_in_drivers_open_by_name(controller, device):
    stage = drivers.open_stage("smc100", controller.path, axis=1)
    assert stage.status().state == "not_referenced"
    stage.close()
    board = drivers.open_board("calrig", device.path, baudrate=230400)
    assert board.identify().driver == "calrig"
    board.close()


@pytest.mark.parametrize(
    ("open_it", "known"), [(drivers.open_stage, "smc100"), (drivers.open_board, "calrig")]
)
def test_an_unknown_driver_names_those_there_are(open_it, known):
    with pytest.raises(InstrumentError, match=f"driver is called 'nosuch'; there are: .*{known}"):
        open_it("nosuch", "/dev/null")


def test_another_package_adds_a_driver_by_an_entry_point(monkeypatch):
    offer(monkeypatch, theirs=f"{__name__}:make_stage")
    assert drivers.open_stage("theirs", "COM3", axis=2) == ("COM3", 2, None)


def test_a_driver_that_cannot_be_loaded_is_said(monkeypatch):
    offer(monkeypatch, broken="no_such_module:open")
    with pytest.raises(InstrumentError, match="'broken' is installed but cannot be loaded: No module"):
        drivers.open_board("broken", "COM3")
