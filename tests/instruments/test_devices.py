"""Every device folder: registered, told by its own bytes and by no other's, its queries harmless to all."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_devices import Counterpart, Uart, as_heard

from calrig.instruments import boards, drivers, stages
from calrig.instruments.boards.public_sketches import SKETCHES
from calrig.instruments.device import BoardDevice, Probe, StageDevice, recognise
from calrig.instruments.drivers import BOARDS, STAGES
from calrig.instruments.scan import converse, probes

DEVICES = {**STAGES, **BOARDS}
PROBES = probes(DEVICES.values())
QUERIES = [probe for probe in PROBES if probe.query]
OTHER_RATES = (9600, 19200, 38400, 57600, 115200, 230400, 250000)
ENDS_A_LINE = ("grbl", 57600)
"""GRBL drops bytes above 127, as was recorded: built for this rate, it takes the query at 115200 for a line's
end, and executes what somebody has left half sent. Its standard build has 115200.
"""
HALF_SENT = {"smc100": b"1PA20", "grbl": b"G0X20", "esp301": b"1PA20", "zaber": b"/1 move abs 90000"}
IDENTITIES = {
    "smc100": "SMC100CC",
    "grbl": "Grbl 1.1h.20190830, in Idle",
    "esp301": "ESP301 Version",
    "zaber": "at address 1, firmware 7.35",
    "calrig": "unit AS-0042",
}
SHARED = {
    "Initializing I2C devices...",
    "Testing device connections...",
    "MPU6050 connection successful",
    "Done!",
}
"""What several sketches say at their start."""
each_device = pytest.mark.parametrize("driver", DEVICES)
each_stage = pytest.mark.parametrize("driver", STAGES)
at_each_rate = pytest.mark.parametrize("own_baud", OTHER_RATES)


@pytest.mark.parametrize(
    ("driver", "options"),
    [*((driver, {}) for driver in DEVICES), ("i2cdev-raw", {"sketch": "i2cdev-raw-fast"})],
)
def test_a_device_is_recognised_by_what_its_counterpart_says_at_its_own_rate_alone(driver, options):
    """The rates are a UART's, so that all others hear is noise; a stage that is not homed does not move."""
    far = Counterpart(driver, **options)
    before_deg = far.table_deg()
    found, baudrate, words = converse(Uart(far, PROBES[0].baudrate), list(DEVICES.values()))
    assert found is not None, words
    assert (found.device.driver, baudrate) == (driver, DEVICES[driver].baudrate)
    assert found.identity.words
    assert IDENTITIES.get(driver, "") in found.identity.words
    assert np.array_equal(far.table_deg(), before_deg)


@each_device
def test_what_a_device_says_is_no_other_devices(driver):
    """Twelve seconds of it, in which a sketch passes from its banner to its records."""
    far = Counterpart(driver)
    heard = b""
    for query in [probe.query for probe in DEVICES[driver].probes] + [DEVICES[driver].version_query, b"s"]:
        heard += far.device.receive(query)
    for _ in range(120):
        far.now_s += 0.1
        heard += far.device.emit()
    others = [device for name, device in DEVICES.items() if name != driver]
    told = {message for other in others for message in other.messages(heard) if other.matches(message)}
    assert told <= SHARED
    assert recognise(heard, DEVICES.values()).device is DEVICES[driver]


def test_the_uart_is_right_at_its_own_rate_and_at_half_of_it():
    almost_57600 = 57601
    assert as_heard(b"1VE\r\n\x00\xff~", 57600, almost_57600) == b"1VE\r\n\x00\xff~"
    assert as_heard(b"\x00", 9600, 19200) == b"\x00"  # a start bit twice as long, and the rest of nothing


@at_each_rate
def test_no_query_is_a_real_time_command_of_grbl_or_in_a_motion_of_thorlabs_at_any_rate(own_baud):
    heard = b"".join(as_heard(probe.query, probe.baudrate, own_baud) for probe in QUERIES)
    resume_reset_door_jog_cancel, in_thorlabs_motion = b"~\x18\x84\x85", b"\x04"
    assert not set(heard) & set(resume_reset_door_jog_cancel + in_thorlabs_motion)


@at_each_rate
@each_stage
def test_no_query_moves_a_stage_whichever_comes_first_and_whatever_was_left_half_sent(driver, own_baud):
    for half_sent in (b"",) if (driver, own_baud) == ENDS_A_LINE else (b"", HALF_SENT[driver]):
        for queries in [*([probe] for probe in QUERIES), QUERIES]:
            far = Counterpart(driver)
            before_deg = far.table_deg()
            far.device.receive(half_sent)
            for probe in queries:
                far.device.receive(as_heard(probe.query, probe.baudrate, own_baud))
            assert np.array_equal(far.table_deg(), before_deg), (half_sent, queries)


@each_stage
def test_the_half_sent_command_of_these_tests_would_move_the_stage_if_it_were_ended(driver):
    far = Counterpart(driver, homing=True)
    before_deg = far.table_deg()
    for line in (HALF_SENT[driver], b"1OR", b"1MO", b"$H", b"/1 home"):
        far.device.receive(line + b"\r\n")
    far.now_s += 0.1
    far.device.emit()
    assert not np.array_equal(far.table_deg(), before_deg)


def test_all_looks_together_take_less_than_eight_seconds():
    assert sum(probe.listen_s for probe in PROBES) < 8


def test_a_port_is_listened_to_before_anything_is_asked():
    assert [bool(probe.query) for probe in PROBES] == sorted(bool(probe.query) for probe in PROBES)


@pytest.mark.parametrize(
    ("query", "harmless", "words"),
    [
        (b"ID\n", "", "does not say why it is harmless"),
        (b"\nID\n", "asks", "begins with a line end"),
        (b"ID\x18\n", "asks", "which may be a command"),
        (b"\x85", "asks", "which may be a command"),
    ],
)
def test_a_question_against_the_rules_is_no_query(query, harmless, words):
    with pytest.raises(ValueError, match=words):
        Probe(115200, 0.5, query, harmless)


PARTS = {
    "driver": "ours",
    "title": "our table",
    "baudrate": 9600,
    "opens": print,
    "probes": (Probe(9600, 0.5),),
    "matches": bool,
    "identity": print,
    "version_query": b"",
}


@pytest.mark.parametrize("missing", PARTS)
def test_a_device_without_one_of_its_parts_cannot_be_declared(missing):
    StageDevice(**PARTS)
    with pytest.raises(TypeError, match=f"'{missing}'"):
        StageDevice(**{part: value for part, value in PARTS.items() if part != missing})


@pytest.mark.parametrize("empty", ["driver", "title", "baudrate", "probes"])
def test_a_device_with_an_empty_part_cannot_be_declared(empty):
    with pytest.raises(ValueError, match=f"has no {empty}"):
        StageDevice(**PARTS | {empty: type(PARTS[empty])()})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "declares no DEVICE that is a BoardDevice"),
        ("from calrig.instruments.stages.grbl import DEVICE", "declares no DEVICE that is a BoardDevice"),
        ("from calrig.instruments.boards.calrig import DEVICE", "declares driver 'calrig', whose folder has"),
    ],
)
def test_a_folder_that_declares_no_device_of_its_own_fails_at_import(tmp_path, monkeypatch, text, words):
    (tmp_path / "shelf" / "table").mkdir(parents=True)
    (tmp_path / "shelf" / "__init__.py").touch()
    (tmp_path / "shelf" / "table" / "__init__.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "shelf.table", raising=False)
    shelf = SimpleNamespace(__path__=[str(tmp_path / "shelf")], __name__="shelf")
    with pytest.raises(TypeError, match=rf"shelf\.table {words}"):
        drivers._built_in(shelf, BoardDevice)
    sys.modules.pop("shelf.table"), sys.modules.pop("shelf")


def test_every_folder_beside_the_shared_modules_is_a_device():
    own = BOARDS.keys() - {sketch.driver for sketch in SKETCHES}
    for shelf, registered in ((stages, STAGES), (boards, own)):
        folders = {path.parent.name for path in Path(shelf.__path__[0]).glob("*/__init__.py")}
        assert folders == {name.replace("-", "_") for name in registered}


def test_knowing_the_devices_takes_no_library_of_any():
    look = "import sys, calrig.instruments.drivers; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout
    assert not {"numpy", "serial", "zaber_motion"} & set(loaded.split())


@pytest.mark.parametrize(("column", "registered"), [("stage.driver", STAGES), ("imu.driver", BOARDS)])
def test_the_readme_says_of_each_driver_what_it_is(column, registered):
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    table = re.search(rf"^\| `{column}` \| is \|\n\| --- \| --- \|\n((?:\|.*\|\n)+)", readme, re.MULTILINE)[1]
    rows = dict(re.findall(r"^\| `(\S+)` \| (.*) \|$", table, re.MULTILINE))
    said = {name: re.sub(r"\[(.*?)\]\(.*?\)", r"\1", words) for name, words in rows.items()}
    assert said == {name: device.title for name, device in registered.items()}
