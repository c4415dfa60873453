"""Sketches as recorded from unmodified firmware, and what simulator, drivers and scan make of them."""

from __future__ import annotations

import itertools
import re
import struct
from collections import Counter
from contextlib import ExitStack, closing

import numpy as np
import pytest
from instrument_fakes import SimulatedEnd, cobs_decode
from simulated_devices import Uart
from sketch_texts import SKETCH
from wire_recordings import BOOT_LOADER_S, in_pieces, recording, starts

from calrig.instruments.drivers import BOARDS, known_devices, open_board
from calrig.instruments.errors import BoardError
from calrig.instruments.scan import converse, probes
from calrig.simulator.bench import Bench
from calrig.simulator.board import Board
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import board_of
from calrig.simulator.sketch_board import BOOT_S

NUMBER = re.compile(r"-?\d+(?:\.(\d+))?")
SKETCHES = {  # recording: driver, fault of the simulated board, records a second
    "sketch-i2cdev-raw": ("i2cdev-raw", None, 9.9),
    "sketch-i2cdev-raw-clone-0x72": ("i2cdev-raw", "clone", 9.9),
    "sketch-i2cdev-raw-no-sensor": ("i2cdev-raw", "zeros", 9.9),
    "sketch-dmp6": ("dmp-ypr", None, 100),
    "sketch-tkj-kalman": ("tkj-kalman", None, 150),
    "sketch-mpu6050-light": ("mpu6050-light", None, 33.3),
    "sketch-tockn": ("tockn", None, 21.7),
    "sketch-adafruit-plotter": ("adafruit-plotter", None, 74),
    "sketch-adafruit-plotter-no-sensor": ("adafruit-plotter", "zeros", 0),
    "sketch-adafruit-basic": ("adafruit-basic", None, 1.98),
}
OWN = "sketch-calrig-115200"
RESET = [name for name, (_, fault, _) in SKETCHES.items() if fault is None]
COMPARED_LINES = 40
VALUE = {  # of the driver: of its samples the one compared, and the number of the record that it is
    "i2cdev-raw": (lambda block: block.accel_g[:, 1] * 16384, 1),
    "adafruit-plotter": (lambda block: block.accel_g[:, 1] * 9.80665, 1),
    "adafruit-basic": (lambda block: block.accel_g[:, 1] * 9.80665, 1),
    "tkj-kalman": (lambda block: block.angle_deg, 3),
    "mpu6050-light": (lambda block: block.angle_deg, 0),
    "tockn": (lambda block: block.angle_deg, 0),
    "dmp-ypr": (lambda block: block.angle_deg, 2),
}
sketch = pytest.mark.parametrize("name", SKETCHES)


def kind(text: str) -> str:
    """A line without its values: `f2` is a number of two decimals, `f0` a whole one."""
    return NUMBER.sub(lambda number: f"f{len(number[1] or '')}", text)


def by_line(pieces):
    """Lines with the time of their end; what came in parts is one, and a last one without an end is kept."""
    lines, text = [], ""
    for piece in pieces:
        text += piece.text
        if text.endswith("\n"):
            lines.append((piece.t_s, text))
            text = ""
    return [*lines, (pieces[-1].t_s, text)] if text else lines


def simulated(driver, fault, duration_s):
    """What the simulated board says in so long, its character sent a moment after it was asked for."""
    settings = SimulatorSettings.from_options(
        {"preset": "ideal", "board": {"sketch": driver, "fault": fault}}
    )
    now_s = 0.0
    device = board_of(driver)(settings.board, settings.imu, Bench(settings), lambda: now_s)

    def said():
        nonlocal now_s
        heard = ""
        while now_s < BOOT_S + duration_s:
            now_s += 0.002
            came = device.emit().decode()
            heard += came
            if "Send any character" in heard and heard.endswith("\r\n") and "Init" not in heard[-30:]:
                device.receive(b"s")
            yield now_s - BOOT_S, came

    return in_pieces(said())


@pytest.mark.parametrize(
    ("driver", "ranges"),
    [
        ("i2cdev-raw", (2, 250)),  # i2cdevlib, MPU6050::initialize: ACCEL_FS_2, GYRO_FS_250
        ("dmp-ypr", (2, 2000)),  # i2cdevlib, MPU6050_6Axis_MotionApps20, dmpInitialize: GYRO_FS_2000
        ("tkj-kalman", (2, 250)),  # MPU6050.ino, setup: GYRO_CONFIG and ACCEL_CONFIG 0x00
        ("mpu6050-light", (2, 500)),  # MPU6050::begin(1, 0): gyro 1, accelerometer 0
        ("tockn", (2, 500)),  # MPU6050::begin: GYRO_CONFIG 0x08, ACCEL_CONFIG 0x00
        ("adafruit-plotter", (16, 250)),  # plotter.ino, setup: RANGE_16_G, RANGE_250_DEG
        ("adafruit-basic", (8, 500)),  # basic_readings.ino, setup: RANGE_8_G, RANGE_500_DEG
    ],
)
def test_a_board_has_the_ranges_that_its_sketch_sets(driver, ranges):
    assert SKETCH[driver].ranges == ranges


def test_adafruits_basic_sketch_says_its_ranges():
    said = "".join(event.text for event in recording("sketch-adafruit-basic"))
    assert re.findall(r"range set to: \+- ?(\d+)", said)[:2] == ["8", "500"]
    assert SKETCH["adafruit-basic"].ranges == (8, 500)


def received(events):
    return [event for event in events if event.way == "from"]


@sketch
def test_the_simulated_sketch_says_the_same_lines_at_the_same_times(name):
    driver, fault, _ = SKETCHES[name]
    real = by_line(received(starts(recording(name))[0]))[:COMPARED_LINES]
    ours = by_line(simulated(driver, fault, real[-1][0] + 0.2))[: len(real)]
    assert [kind(text) for _, text in ours] == [kind(text) for _, text in real]
    for (real_s, text), (our_s, _) in zip(real, ours, strict=True):
        assert our_s == pytest.approx(real_s, rel=0.03, abs=0.05), text


class Played:
    """A device that says again what was recorded, at the end of a UART; what it waited for it waits for."""

    def __init__(self, name, baudrate):
        self.baudrate = baudrate
        self.now_s = 0.0
        self._events = recording(name)[1:]
        self._asked = [event.text for event in self._events if event.way == "to"]
        self._later_s = 0.0  # than in the recording
        self.device = self

    def receive(self, data: bytes) -> bytes:
        """Goes on behind what was sent like this, or behind the character that a sketch waits for."""
        sent = data.decode("latin-1")
        wanted = sent if sent in self._asked else "s"
        place = next((k for k, e in enumerate(self._events) if e.way == "to" and e.text == wanted), None)
        if place is not None:
            asked = self._events[place]
            self._later_s = self.now_s - asked.t_s
            self._events = [e for e in self._events[place + 1 :] if (e.way, e.text) != ("to", "s")]
        return b""

    def emit(self) -> bytes:
        said = b""
        while self._events and self._events[0].way == "from":
            if self._events[0].t_s + self._later_s > self.now_s:
                break
            said += self._events.pop(0).data
        return said


@pytest.mark.parametrize("name", [*SKETCHES, OWN])
def test_a_scan_recognises_it_by_what_was_received_in_the_time_that_it_listens(name):
    driver = SKETCHES.get(name, ("calrig",))[0]
    devices = known_devices()
    far = Played(name, BOARDS[driver].baudrate)
    found, baudrate, words = converse(Uart(far, probes(devices)[0].baudrate), devices)
    if name == "sketch-adafruit-plotter-no-sensor":  # it said one line, at a rate not listened to by then
        assert found is None
        assert "no text" in words
        return
    assert found is not None, words
    assert (found.device.driver, baudrate) == (driver, BOARDS[driver].baudrate)


@pytest.fixture
def wire():
    end = SimulatedEnd()
    yield end
    end.vanish()


@pytest.fixture
def opened(wire):
    """Opens a board's driver on the wire, closed at the test's end whatever becomes of it."""
    with ExitStack() as boards:
        yield lambda driver: boards.enter_context(closing(open_board(driver, wire.path)))


def play(wire, events):
    """Sends what was received, in time; waits for a first character where the recording's host sent one."""

    def timed():
        at_s = BOOT_LOADER_S - 0.5  # the boot loader's silence is not waited for in full
        for event in events:
            if event.way == "to":
                while not wire.heard:
                    yield 0.01, b""
            elif event.way == "from":
                yield max(0.0, event.t_s - at_s), event.data
            at_s = max(at_s, event.t_s)

    wire.play(timed())


def values(driver, events):
    """The value that is compared of each line that has the form of most lines."""
    lines = "".join(event.text for event in received(events)).splitlines(keepends=True)
    place = VALUE[driver][1]
    most = next(form for form, _ in Counter(map(kind, lines)).most_common() if "f" in form)
    return [float(list(NUMBER.finditer(line))[place][0]) for line in lines if kind(line) == most]


def until_it_fails(board):
    blocks = []
    with pytest.raises(BoardError) as failure:
        blocks.extend(board.take(0.1) for _ in range(5000))
    return blocks, str(failure.value)


@pytest.mark.parametrize("name", RESET)
def test_every_record_is_a_sample_and_the_reset_in_the_middle_is_seen(name, opened, wire):
    driver, _, rate_hz = SKETCHES[name]
    events = recording(name)
    play(wire, events)
    board = opened(driver)
    assert board.identify().rate_hz == pytest.approx(rate_hz, rel=0.03)
    board.start(200)
    blocks, why = until_it_fails(board)
    zeroes = driver in {"mpu6050-light", "tockn", "dmp-ypr"}
    ends_at_reset = zeroes or driver == "tkj-kalman"  # whose filter has not settled by the recording's end
    got = np.concatenate([VALUE[driver][0](block) for block in blocks])
    before, after = starts(events)
    came = values(driver, before) + ([] if ends_at_reset else values(driver, after))
    held_back = range(2 if zeroes else 1)  # a last one like the one before: frozen or not is not known
    assert any(np.allclose(got, came[len(came) - n - len(got) : len(came) - n]) for n in held_back)
    assert len(got) > 0.6 * len(came)
    half_lines = {"unparsed": 1} if driver == "tockn" else {}  # an empty line ends it, not the banner's words
    assert dict(board.faults) == {"board_reset": 1, **half_lines}
    assert ("takes its zero anew" if zeroes else "it is silent") in why


def test_the_records_of_a_clone_are_samples_and_its_failed_test_is_a_fault(opened, wire):
    play(wire, recording("sketch-i2cdev-raw-clone-0x72"))
    board = opened("i2cdev-raw")
    board.identify()
    board.start(200)
    blocks, _ = until_it_fails(board)
    assert sum(map(len, blocks)) > 50
    assert dict(board.faults) == {"board_error": 1}


def test_zeros_without_a_sensor_are_no_samples(opened, wire):
    play(wire, recording("sketch-i2cdev-raw-no-sensor"))
    board = opened("i2cdev-raw")
    board.identify()
    board.start(200)
    blocks, why = until_it_fails(board)
    assert "no sensor" in why
    assert not sum(map(len, blocks))


def test_a_sketch_that_gives_up_without_a_sensor_is_quoted(opened, wire):
    play(wire, recording("sketch-adafruit-plotter-no-sensor"))
    with pytest.raises(BoardError, match="'Failed to find MPU6050 chip'"):
        opened("adafruit-plotter").identify()


def packets(data):
    """The bodies of packets without their CRC, by the contract alone."""
    return [cobs_decode(frame)[:-2] for frame in data.split(b"\0") if frame]


def samples_of(bodies):
    return [struct.unpack("<HI7h", body[1:]) for body in bodies if body[0] == 2]


def told(bodies):
    """Each packet but samples, of which many are one."""
    return [body if body[0] != 2 else b"" for body in bodies if body[0] != 2 or body[1:3] == b"\0\0"]


def test_the_board_of_calrigs_own_answers_as_recorded():
    events = recording(OWN)
    options = {"firmware": "calrig_imu 1.0", "max_rate_hz": 400, "boot_s": BOOT_LOADER_S}
    settings = SimulatorSettings.from_options({"preset": "ideal", "board": options})
    now_s = 0.0
    board = Board(settings.board, settings.imu, Bench(settings), lambda: now_s)
    said = b""
    for event in events:
        now_s = event.t_s
        if event.text == "reset line":
            board.reset()
        said += board.receive(event.data) if event.way == "to" else board.emit()
    real = packets(b"".join(event.data for event in received(events)))
    ours = packets(said)
    assert told(ours) == told(real)
    assert abs(len(ours) - len(real)) <= 2
    for side in map(samples_of, (ours, real)):
        assert [row[0] for row in side] == list(range(len(side)))
        np.testing.assert_allclose(np.diff([row[1] for row in side]), 10_000, atol=1)


def answers(wire, events):
    """What the recording answers to each command as it comes, in its time, until the next one."""
    done, at_s, after = 0, 0.0, iter(())
    while True:
        lines = wire.heard.decode().split("\n")[:-1]
        if len(lines) > done:
            sent, done = f"{lines[done]}\n", done + 1
            place = next(k for k, event in enumerate(events) if event.way == "to" and event.text == sent)
            at_s, after = (
                events[place].t_s,
                itertools.takewhile(lambda e: e.way == "from", events[place + 1 :]),
            )
        event = next(after, None)
        if event is None:
            yield 0.01, b""
            continue
        yield event.t_s - at_s, event.data
        at_s = event.t_s


def test_every_packet_is_a_sample_of_the_driver_of_calrigs_own_board(opened, wire):
    events = recording(OWN)
    wire.play(answers(wire, events))
    board = opened("calrig")
    who = board.identify()
    assert (who.firmware, who.serial, who.max_rate_hz) == ("calrig_imu 1.0", "", 400)
    board.start(100)
    got = np.concatenate([board.take(0.1).accel_g for _ in range(75)])
    rows = samples_of(packets(b"".join(event.data for event in received(events))))
    np.testing.assert_allclose(got * 16384, [row[2:5] for row in rows][: len(got)])
    assert len(got) > 250
    assert not board.faults
