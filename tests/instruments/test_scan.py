"""Who answers on which port, found out without a byte that could move anything."""

from __future__ import annotations

import threading
import tomllib
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from instrument_fakes import FakeBoard, Wire
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from calrig.instruments import scan as scanning
from calrig.instruments.errors import PortError
from calrig.instruments.ports import open_port
from calrig.instruments.scan import LOOKS, Found, scan
from calrig.instruments.scan_stanza import stanza
from calrig.settings import Settings
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import DIALECTS, SimulatedRig

SKETCHES = [
    "i2cdev-raw",
    "tkj-kalman",
    "adafruit-plotter",
    "adafruit-basic",
    "mpu6050-light",
    "tockn",
    "dmp-ypr",
]
STAGES = {"smc100": "SMC100CC", "grbl": "Grbl 1.1h", "esp301": "ESP301 Version", "zaber": "firmware 7.35"}
OTHER_RATES = (9600, 19200, 38400, 57600, 115200, 230400, 250000)
HALF_SENT = {"smc100": b"1PA20", "grbl": b"G0X20", "esp301": b"1PA20", "zaber": b"/1 move abs 90000"}


@pytest.fixture(autouse=True)
def listed(monkeypatch):
    """The ports that the system lists; listening takes a fifth of the time."""
    ports: list[ListPortInfo] = []
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    quick = [replace(look, listen_s=look.listen_s / 5) for look in LOOKS]
    monkeypatch.setattr(scanning, "LOOKS", quick)
    return ports


@pytest.fixture
def wire():
    end = Wire()
    yield end
    end.vanish()


def adapter(device, serial=None):
    info = ListPortInfo(device)
    info.vid, info.pid, info.serial_number, info.description = 0x1A86, 0x7523, serial, "USB Serial"
    return info


def simulated(**options):
    return SimulatedRig(SimulatorSettings.from_options({"preset": "ideal", "time_scale": 20, **options}))


def table_deg(rig):
    """Where the table was, is, and is going to be."""
    with rig.bench.lock:
        return rig.bench.mechanics.table(np.linspace(0, rig.clock() + 600, 500)).angle_deg


def found(kind, driver, port="/dev/ttyUSB0", serial=None, axis=None, baudrate=None):
    return Found(port, kind, driver, "", axis, baudrate, None, serial, "")


@pytest.mark.parametrize("driver", STAGES)
def test_a_stage_and_a_board_are_recognised_and_nothing_moves(driver):
    with simulated(stage={"driver": driver}, board={"serial": "AS-0042"}) as rig:
        before_deg = table_deg(rig)
        on = {one.port: one for one in scan([rig.stage_port, rig.imu_port])}
        assert np.array_equal(table_deg(rig), before_deg)
        assert np.ptp(before_deg) == 0
    stage, board = on[rig.stage_port], on[rig.imu_port]
    assert (stage.kind, stage.driver) == ("stage", driver)
    assert STAGES[driver] in stage.identity
    assert (board.kind, board.driver) == ("board", "calrig")
    assert "AS-0042" in board.identity


def test_boards_that_print_text_are_recognised_side_by_side(monkeypatch):
    monkeypatch.setattr(scanning, "LOOKS", [replace(look, listen_s=look.listen_s / 2) for look in LOOKS])
    with ExitStack() as running:
        rigs = {
            sketch: running.enter_context(simulated(time_scale=1, board={"sketch": sketch}))
            for sketch in SKETCHES
        }
        on = {one.port: one for one in scan(rig.imu_port for rig in rigs.values())}
    assert {sketch: on[rig.imu_port].driver for sketch, rig in rigs.items()} == {s: s for s in SKETCHES}


@pytest.mark.parametrize("driver", STAGES)
def test_what_somebody_left_half_sent_is_not_completed(driver):
    """An unlocked stage, and a move without its line end already in its memory."""
    with simulated(stage={"driver": driver, "homing": False}) as rig:
        left = open_port(rig.stage_port, baudrate=9600, timeout_s=0.1)
        left.write(HALF_SENT[driver])
        left.close()
        before_deg = table_deg(rig)
        scan([rig.stage_port])
        assert np.array_equal(table_deg(rig), before_deg)


def as_heard(data: bytes, sent_baud: int, own_baud: int) -> bytes:
    """What a UART at its own rate makes of bytes sent at another: it samples the middle of each bit."""
    bits = "1" + "".join("0" + f"{byte:08b}"[::-1] + "1" for byte in data) + "1" * 30
    edges = [k / sent_baud for k in range(1, len(bits)) if bits[k - 1 : k + 1] == "10"]
    heard, free_s = [], 0.0
    for edge_s in edges:
        if edge_s < free_s:
            continue
        instants_s = [edge_s + (k + 0.5) / own_baud for k in range(1, 9)]
        levels = [bits[min(int(at_s * sent_baud), len(bits) - 1)] for at_s in instants_s]
        heard.append(int("".join(reversed(levels)), 2))
        free_s = edge_s + 9.5 / own_baud
    return bytes(heard)


def test_the_reckoning_of_a_uart_is_right_at_its_own_rate():
    assert as_heard(b"1VE\r\n\x00\xff~", 57600, 57600) == b"1VE\r\n\x00\xff~"
    assert as_heard(b"\x00", 9600, 19200) == b"\x00"  # a start bit twice as long, and the rest of nothing


@pytest.mark.parametrize("own_baud", OTHER_RATES)
def test_no_question_is_a_real_time_command_of_grbl_at_any_rate(own_baud):
    heard = b"".join(as_heard(look.question, look.baudrate, own_baud) for look in LOOKS)
    resume_reset_door_jog_cancel = b"~\x18\x84\x85"
    assert not set(heard) & set(resume_reset_door_jog_cancel)


@pytest.mark.parametrize("own_baud", OTHER_RATES)
@pytest.mark.parametrize("driver", STAGES)
def test_no_question_moves_a_stage_that_hears_it_at_another_rate(driver, own_baud):
    rig = simulated(stage={"driver": driver, "homing": False})
    before_deg = table_deg(rig)
    for look in LOOKS:
        rig.stage.receive(as_heard(look.question, look.baudrate, own_baud))
    assert np.array_equal(table_deg(rig), before_deg)
    rig.stop()


def test_every_built_in_stage_is_among_those_tried():
    assert set(STAGES) == set(DIALECTS)


def test_all_looks_together_take_less_than_eight_seconds():
    assert sum(look.listen_s for look in LOOKS) < 8


def test_a_port_where_nothing_answers_says_so(wire):
    (silent,) = scan([wire.path])
    assert (silent.kind, silent.driver, silent.identity) == (
        "unknown",
        None,
        "nothing answers: is the device switched on?",
    )


def test_garbage_is_nobody(wire):
    scan_sees = scan_while(wire, b"\xf0\x80\xff\r\n\x00")
    assert (scan_sees.kind, scan_sees.identity) == (
        "unknown",
        "what it sends is no text at any baud rate tried",
    )


def test_a_device_that_no_driver_knows_is_quoted(wire):
    assert scan_while(wire, b"Failed to find MPU6050 chip\r\n").identity == (
        "says 'Failed to find MPU6050 chip', which no driver knows"
    )


def scan_while(wire, said: bytes) -> Found:
    """What a scan sees of a device that says this as soon as it is asked anything."""
    answering = threading.Thread(target=lambda: wire.recv() and wire.send(said))
    answering.start()
    (seen,) = scan([wire.path])
    answering.join()
    return seen


def test_a_port_in_use_is_left_alone(wire):
    user = open_port(wire.path, baudrate=9600, timeout_s=0.1)
    (busy,) = scan([wire.path])
    assert busy.kind == "busy"
    assert "in use by another program" in busy.identity
    wire.send(b"still here")
    assert user.read(10) == b"still here"
    user.close()


def test_a_listed_port_comes_with_its_adapter(listed):
    board = FakeBoard()
    listed.append(adapter(board.path, "A10"))
    (seen,) = scan(["usb:A10", "usb:not-here"])
    board.vanish()
    assert (seen.driver, seen.usb_id, seen.usb_serial, seen.description) == (
        "calrig",
        "1a86:7523",
        "A10",
        "USB Serial",
    )


def test_a_port_is_opened_by_the_serial_number_of_its_adapter(listed, wire):
    listed += [adapter("/dev/ttyUSB8", "B20"), adapter(wire.path, "A10")]
    port = open_port("usb:A10", baudrate=9600, timeout_s=0.2)
    port.write(b"x")
    assert wire.recv() == b"x"
    port.close()


def test_an_adapter_that_is_absent_is_named_with_those_there_are(listed):
    listed += [adapter("/dev/ttyUSB0", "B20"), adapter("/dev/ttyUSB1")]
    with pytest.raises(PortError, match=r"serial number 'A10' is plugged in.*: B20 \(/dev/ttyUSB0\)$"):
        open_port("usb:A10", baudrate=9600, timeout_s=0.1)


def test_a_serial_number_that_two_adapters_share_is_no_name(listed):
    listed += [adapter("/dev/ttyUSB0", "0001"), adapter("/dev/ttyUSB1", "0001")]
    with pytest.raises(PortError, match="may be any of /dev/ttyUSB0, /dev/ttyUSB1"):
        open_port("usb:0001", baudrate=9600, timeout_s=0.1)


def test_one_stage_and_one_board_are_a_rig_that_can_be_pasted():
    stage = found("stage", "smc100", serial="FT1", axis=3)
    board = found("board", "tockn", "COM4", baudrate=19200)
    text = stanza([stage, board], taken={"bench-1"})
    (rig,) = Settings.model_validate(tomllib.loads(text)).rig
    assert (rig.name, rig.stage.driver, rig.stage.port, rig.stage.axis) == ("bench-2", "smc100", "usb:FT1", 3)
    assert (rig.imu.driver, rig.imu.port, rig.imu.baudrate) == ("tockn", "COM4", 19200)


def test_two_stages_have_a_rig_each_and_their_boards_to_choose_from():
    stages = [found("stage", "grbl", "/dev/ttyUSB0"), found("stage", "esp301", "/dev/ttyUSB1")]
    board = found("board", "calrig", "/dev/ttyACM0", baudrate=115200)
    text = stanza([*stages, board])
    document = tomllib.loads(text)
    assert [rig["name"] for rig in document["rig"]] == ["bench-1", "bench-2"]
    chosen = text.replace("# imu", "imu")
    assert {rig.imu.port for rig in Settings.model_validate(tomllib.loads(chosen)).rig} == {"/dev/ttyACM0"}


def test_adapters_that_share_a_serial_number_are_bound_by_their_ports():
    stage = found("stage", "smc100", "/dev/ttyUSB0", serial="0001")
    board = found("board", "calrig", "/dev/ttyUSB1", serial="0001")
    (rig,) = tomllib.loads(stanza([stage, board]))["rig"]
    assert (rig["stage"]["port"], rig["imu"]["port"]) == ("/dev/ttyUSB0", "/dev/ttyUSB1")


def test_a_board_alone_makes_no_rig():
    assert stanza([found("board", "calrig")]) == ""
