"""Who answers on which port, as it is told to a person; `test_devices` has who is recognised, and how."""

from __future__ import annotations

import errno
import json
import threading
import tomllib
from types import SimpleNamespace

import pytest
from instrument_fakes import IDENTITY, Wire, packet
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo
from simulated_devices import Counterpart, Uart

from calrig.instruments import scan as scanning
from calrig.instruments.device import Identity, Probe, StageDevice
from calrig.instruments.drivers import known_devices
from calrig.instruments.errors import PortError
from calrig.instruments.ports import open_port
from calrig.instruments.scan import Found, converse, probes, scan, stanza
from calrig.settings import Settings


@pytest.fixture(autouse=True)
def listed(monkeypatch):
    """The ports that the system lists."""
    ports: list[ListPortInfo] = []
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    return ports


def adapter(device, serial=None):
    info = ListPortInfo(device)
    info.vid, info.pid, info.serial_number, info.description = 0x1A86, 0x7523, serial, "USB Serial"
    return info


class Parrot:
    """A port whose clock goes on as it is read; it says the same thing again and again."""

    name = "test-port"

    def __init__(self, said: bytes = b"", baudrates: tuple[int, ...] = ()):
        self.said, self.baudrates = said, baudrates
        self.now_s = 0.0
        self.clock = SimpleNamespace(now_s=lambda: self.now_s)
        self.baudrate = 9600
        self.events: list[tuple[float, object]] = []

    def change_baudrate(self, baudrate):
        self.baudrate = baudrate
        self.events.append((self.now_s, baudrate))

    def write(self, data):
        self.events.append((self.now_s, data))

    def read_some(self):
        self.now_s += 0.02
        return self.said if not self.baudrates or self.baudrate in self.baudrates else b""


def told_of(port):
    return converse(port, known_devices())


def test_a_port_where_nothing_answers_says_so_after_all_that_is_to_be_tried():
    port = Parrot()
    assert told_of(port) == (None, 19200, "nothing answers: is the device switched on?")
    assert port.now_s == pytest.approx(sum(probe.listen_s for probe in probes(known_devices())), abs=0.3)
    asked = [event for _, event in port.events if isinstance(event, bytes)]
    assert asked == [probe.query for probe in probes(known_devices()) if probe.query]


def test_nothing_is_asked_while_it_is_listened():
    port = Parrot()
    told_of(port)
    first_query_s = next(at_s for at_s, event in port.events if isinstance(event, bytes))
    assert first_query_s >= sum(probe.listen_s for probe in probes(known_devices()) if not probe.query)


def test_garbage_is_nobody():
    assert told_of(Parrot(b"\xf0\x80\xff\r\n\x00"))[2] == "what it sends is no text at any baud rate tried"


def test_a_device_that_no_driver_knows_is_quoted():
    said = b"Failed to find MPU6050 chip\r\n"
    assert told_of(Parrot(said, (115200,)))[2] == "says 'Failed to find MPU6050 chip', which no driver knows"


def test_a_device_that_is_known_is_asked_nothing_more_of_others():
    port = Parrot(b"ESP301 Version 3.0.1\r\n", (19200,))
    found, baudrate, _ = told_of(port)
    assert (found.device.driver, found.identity.words, baudrate) == ("esp301", "ESP301 Version 3.0.1", 19200)
    port = Parrot(b"a/g:\t1\t2\t3\t4\t5\t6\r\n", (38400,))
    found, baudrate, _ = told_of(port)
    assert (found.device.driver, baudrate) == ("i2cdev-raw", 38400)
    assert not [event for _, event in port.events if isinstance(event, bytes)]


def test_what_several_devices_say_alike_tells_none_of_them():
    shared = "MPU6050 connection successful"
    found, _, words = told_of(Parrot(f"{shared}\r\n".encode(), (38400,)))
    assert (found, words) == (None, f"says '{shared}', which no driver knows")


def test_a_chain_of_zaber_devices_is_its_first_one_and_names_the_others():
    said = b"@01 0 OK IDLE WR 0\r\n@02 0 OK IDLE -- 0\r\n@04 0 OK BUSY -- 0\r\n@01 0 OK IDLE WR 7.35\r\n"
    found, _, _ = told_of(Parrot(said, (115200,)))
    assert found.identity == Identity("at address 1, firmware 7.35, and behind it addresses 2, 4", 1)


def test_the_reset_of_a_slow_board_is_waited_for():
    """Whichever rate is the slowest, at it most boards are still silent."""
    device = StageDevice(
        driver="ours",
        title="our table",
        baudrate=300,
        opens=lambda url, *, axis, baudrate: None,
        probes=(Probe(300, 0.3), Probe(9600, 0.1)),
        matches=lambda line: line == "TABLE 1",
        identity=lambda lines: Identity("one"),
        version_query=b"",
    )
    assert [(probe.baudrate, probe.listen_s) for probe in probes([device])] == [(300, 2.3), (9600, 0.1)]


def test_devices_that_want_the_same_tried_have_it_tried_once():
    per_look = [(probe.baudrate, probe.query) for probe in probes(known_devices())]
    assert len(set(per_look)) == len(per_look)


@pytest.mark.parametrize(
    ("fault", "words"), [("hang", "nothing answers"), ("garbage", "which no driver knows")]
)
def test_a_stage_that_answers_nothing_to_the_letter_is_unknown(fault, words):
    far = Counterpart("grbl")
    far.device.fault = fault
    found, _, said = told_of(Uart(far))
    assert found is None
    assert words in said


def test_a_stage_and_a_board_on_terminals_are_found_side_by_side(listed):
    """Both say who they are all the time, so that nothing has to be waited for."""
    board, stage, ended = Wire(), Wire(), threading.Event()

    def speak():
        while not ended.wait(0.02):
            board.send(packet(1, json.dumps(IDENTITY).encode()))
            stage.send(b"Grbl 1.1h ['$' for help]\r\n")

    speaker = threading.Thread(target=speak, daemon=True)
    speaker.start()
    listed.append(adapter(board.path, "A10"))
    seen = {one.port: one for one in scan(["usb:A10", "usb:not-here", stage.path])}
    ended.set()
    speaker.join()
    board.vanish()
    stage.vanish()
    assert set(seen) == {board.path, stage.path}
    on_board, on_stage = seen[board.path], seen[stage.path]
    assert (on_stage.kind, on_stage.driver, on_stage.identity) == ("stage", "grbl", "Grbl 1.1h")
    assert (on_stage.usb_id, on_stage.baudrate, on_stage.description) == (None, None, "")
    assert (on_board.kind, on_board.driver, on_board.identity) == (
        "board",
        "calrig",
        "unit AS-0042, calrig 1.0, MPU-6050",
    )
    assert (on_board.usb_id, on_board.usb_serial, on_board.description) == ("1a86:7523", "A10", "USB Serial")


def test_a_port_in_use_is_left_alone(wire):
    user = open_port(wire.path, baudrate=9600, timeout_s=0.1)
    (busy,) = scan([wire.path])
    assert busy.kind == "busy"
    assert "in use by another program" in busy.identity
    wire.send(b"still here")
    assert user.read(10) == b"still here"
    user.close()


def test_a_port_of_the_services_own_is_not_even_opened(wire):
    user = open_port(wire.path, baudrate=9600, timeout_s=0.1)
    (kept,) = scan([wire.path], ours=[wire.path])
    user.close()
    assert (kept.kind, kept.driver) == ("busy", None)
    assert "a rig of this service" in kept.identity


def test_a_port_of_the_services_own_is_known_by_its_adapters_serial_number(listed, wire):
    """A rig's settings may name its adapter, and the system lists the port."""
    listed.append(adapter(wire.path, "A10"))
    (kept,) = scan(ours=["usb:A10"])
    assert (kept.port, kept.kind) == (wire.path, "busy")
    assert "a rig of this service" in kept.identity


def test_a_port_that_may_not_be_opened_says_what_to_do(monkeypatch):
    def refuse(name, **_):
        try:
            raise PermissionError(errno.EACCES, "Permission denied")
        except PermissionError as error:
            raise PortError(f"port {name} may not be opened by this user") from error

    monkeypatch.setattr(scanning, "open_port", refuse)
    (refused,) = scan(["/dev/ttyUSB7"])
    assert (refused.kind, refused.identity) == (
        "no permission",
        "port /dev/ttyUSB7 may not be opened by this user",
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


def found(kind, driver, port="/dev/ttyUSB0", serial=None, axis=None, baudrate=None):
    return Found(port, kind, driver, "", axis, baudrate, None, serial, "")


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
