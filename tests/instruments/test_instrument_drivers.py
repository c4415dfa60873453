from __future__ import annotations

import re
import sys
from importlib.metadata import EntryPoint, EntryPoints
from importlib.resources import files

import pytest

from calrig.instruments import drivers
from calrig.instruments.axis import Axis
from calrig.instruments.device import recognise
from calrig.instruments.errors import Halted, InstrumentError, StageError
from calrig.instruments.scan import probes


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
    with pytest.raises(InstrumentError, match=rf"'nosuch'.*{known}"):
        open_it("nosuch", "/dev/null")


def test_another_package_adds_a_driver_by_an_entry_point(monkeypatch):
    offer(monkeypatch, theirs=f"{__name__}:make_stage")
    assert drivers.open_stage("theirs", "COM3", axis=2) == ("COM3", 2, None)


def test_a_driver_that_cannot_be_loaded_is_said(monkeypatch):
    offer(monkeypatch, broken="no_such_module:open")
    with pytest.raises(InstrumentError, match=r"'broken'.*cannot be loaded.*No module"):
        drivers.open_board("broken", "COM3")


@pytest.fixture
def page():
    return files("calrig").joinpath("docs/how-to/write-a-driver.md").read_text(encoding="utf-8")


def blocks(page, kind):
    return re.findall(rf"```{kind}\n(.*?)```", page, flags=re.DOTALL)


@pytest.fixture
def our_turntable(page, tmp_path, monkeypatch):
    """The module on the authors' page, as another package holds it."""
    (tmp_path / "our_turntable.py").write_text("".join(blocks(page, "python")))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "our_turntable", raising=False)


def test_the_driver_on_the_authors_page_runs_from_the_transcript_beside_it(
    page, our_turntable, tmp_path, monkeypatch
):
    (tmp_path / "turntable.txt").write_text(blocks(page, "text")[0])
    offer(monkeypatch, turntable="our_turntable:Turntable.open")
    stage = drivers.open_stage("turntable", f"replay://{tmp_path / 'turntable.txt'}")
    axis = Axis(stage)
    assert not axis.needs_home()
    assert axis.elevation_deg() == 12.5
    with pytest.raises(StageError, match="does not answer G=5"):
        axis.begin_move(5)
    axis.halt()
    with pytest.raises(Halted, match="G=6 was not sent"):
        axis.begin_move(6)
    axis.close()


def test_the_device_on_the_authors_page_is_opened_and_takes_part_in_a_scan(
    our_turntable, tmp_path, monkeypatch
):
    offer(monkeypatch, turntable="our_turntable:DEVICE")
    (tmp_path / "silent.txt").write_text("# calrig transcript of a port where nothing is said\n")
    drivers.open_stage("turntable", f"replay://{tmp_path / 'silent.txt'}").close()
    devices = drivers.known_devices()
    assert (9600, b"S?\nS?\n") in [(probe.baudrate, probe.query) for probe in probes(devices)]
    found = recognise(b"S=STANDING\r\n", devices)
    assert (found.device.driver, found.identity.words) == ("turntable", "a turntable, standing")


def test_a_package_that_cannot_be_loaded_is_said_in_the_log_and_a_scan_goes_on(monkeypatch, caplog):
    offer(monkeypatch, broken="no_such_module:DEVICE")
    assert {device.driver for device in drivers.known_devices()} == {*drivers.STAGES, *drivers.BOARDS}
    assert "driver 'broken'" in caplog.text
    assert "no_such_module" in caplog.text


def test_a_name_of_calrigs_own_is_not_taken_by_another_package(monkeypatch):
    offer(monkeypatch, grbl="no_such_module:DEVICE")
    assert [device for device in drivers.known_devices() if device.driver == "grbl"] == [
        drivers.STAGES["grbl"]
    ]
