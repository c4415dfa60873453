"""The simulated board prints what the public sketches print, when they print it: facts of ../shared/wire."""

from __future__ import annotations

import math
import re

import pytest
from wire_recordings import in_pieces

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import board_of
from calrig.simulator.rig import SimulatedRig
from calrig.simulator.sketch_board import BOOT_S, SketchBoard
from calrig.simulator.sketches import Motion, si, tilt

NUMBER = r"-?\d+\.\d\d"
LINES = {
    "i2cdev-raw": r"a/g:(\t-?\d+){6}\r\n",
    "i2cdev-raw-fast": r"a/g:(\t-?\d+){6}\r\n",
    "tkj-kalman": rf"({NUMBER}\t){{4}}\t({NUMBER}\t){{4}}\r\n",
    "adafruit-plotter": rf"AccelX:{NUMBER},AccelY:{NUMBER},AccelZ:{NUMBER}, "
    rf"GyroX:{NUMBER},GyroY:{NUMBER},GyroZ:{NUMBER}\r\n",
    "adafruit-basic": rf"Acceleration X: {NUMBER}, Y: {NUMBER}, Z: {NUMBER} m/s\^2\r\n"
    rf"Rotation X: {NUMBER}, Y: {NUMBER}, Z: {NUMBER} rad/s\r\nTemperature: {NUMBER} degC\r\n\r\n",
    "mpu6050-light": rf"X : {NUMBER}\tY : {NUMBER}\tZ : {NUMBER}\r\n",
    "tockn": rf"angleX : {NUMBER}\tangleY : {NUMBER}\tangleZ : {NUMBER}\r\n",
    "dmp-ypr": rf"ypr\t{NUMBER}\t{NUMBER}\t{NUMBER}\r\n",
}
A_SECOND = {  # lines or records, as recorded; the fast sketch's as sketches.md says
    "i2cdev-raw": 9.9,
    "i2cdev-raw-fast": 110,
    "tkj-kalman": 150,
    "adafruit-plotter": 74,
    "adafruit-basic": 1.98,
    "mpu6050-light": 33.3,
    "tockn": 21.7,
    "dmp-ypr": 100,
}
FIRST_S = {  # from the boot loader's end to the end of the first record
    "i2cdev-raw": 0.033,
    "tkj-kalman": 0.108,
    "adafruit-plotter": 0.412,
    "adafruit-basic": 0.422,
    "mpu6050-light": 1.886,
    "tockn": 5.102,
    "dmp-ypr": 2.174,  # from its character
}


class Board:
    """A simulated board without a wire, whose time the test sets."""

    def __init__(self, sketch, **board):
        settings = SimulatorSettings.from_options({"board": {"sketch": sketch, **board}})
        self.now_s = 0.0
        self.device = board_of(sketch)(settings.board, settings.imu, Bench(settings), lambda: self.now_s)

    def said(self, until_s):
        """All it prints until then."""
        text = ""
        while self.now_s < until_s:
            self.now_s += 0.25
            text += self.device.emit().decode()
        return text


def running(sketch, **board):
    """One that has begun, at the end of a line."""
    it = Board(sketch, **board)
    it.said(2)
    it.device.receive(b"s")
    it.said(8)
    to_the_end_of_a_record(it, sketch)
    return it


def to_the_end_of_a_record(it, sketch, step_s=0.0005):
    """What it prints until a record is whole."""
    text = ""
    while not (text.endswith("\n") and re.search(f"{LINES[sketch]}$", text)):
        it.now_s += step_s
        text += it.device.emit().decode()
    return text


def pieces(it, until_s):
    """What it prints until then as a recording has it."""

    def said():
        while it.now_s < until_s:
            it.now_s += 0.002
            yield it.now_s - BOOT_S, it.device.emit().decode()

    return in_pieces(said())


@pytest.mark.parametrize("sketch", sorted(LINES))
def test_it_prints_its_lines_at_its_pace_and_nothing_else(sketch):
    it = running(sketch)
    from_s = it.now_s
    text = it.said(from_s + 10) + to_the_end_of_a_record(it, sketch)
    assert re.fullmatch(f"({LINES[sketch]})+", text)
    assert len(re.findall(LINES[sketch], text)) / (it.now_s - from_s) == pytest.approx(
        A_SECOND[sketch], rel=0.05
    )


@pytest.mark.parametrize("sketch", sorted(FIRST_S))
def test_its_first_record_comes_when_the_real_one_s_does(sketch):
    it = Board(sketch)
    if sketch == "dmp-ypr":
        it.said(2)
        it.device.receive(b"s")
    begun_s = it.now_s or BOOT_S
    to_the_end_of_a_record(it, sketch, 0.001)
    assert it.now_s - begun_s == pytest.approx(FIRST_S[sketch], rel=0.05, abs=0.005)


def test_a_banner_comes_over_seconds():
    said = [(piece.text[:12], piece.t_s) for piece in pieces(Board("tockn"), BOOT_S + 3)]
    seconds = {
        "\r\n": 1.0,
        "============": 1.05,
        "DO NOT MOVE ": 1.1,
        ".": 1.36,
        "Done!\r\n": 2.01,
        "Program will": 2.08,
    }
    for text, at_s in seconds.items():
        assert dict(reversed(said))[text] == pytest.approx(at_s, abs=0.02)


def test_the_dmp_calibrates_for_two_seconds_and_says_its_offsets():
    it = Board("dmp-ypr")
    it.said(2)
    it.device.receive(b"s")
    text = it.said(5)
    marks = r">\*\.{6}>\.{6}" if ">*" in text else r">\.{6}>\.{6}"
    assert re.search(rf"DMP\.\.\.\r\n{marks}(-?\d+\.0{{5}}(,\t|\n)){{6}}\nEnabling DMP\.\.\.\r\n", text)


def test_raw_registers_are_those_of_the_chip():
    it = running("i2cdev-raw")
    ax, ay, az, *gyro = map(int, it.said(it.now_s + 1).splitlines()[0].split("\t")[1:])
    assert math.degrees(math.atan2(ay, az)) == pytest.approx(4, abs=0.5)  # where a stage powers up
    assert math.hypot(ax, ay, az) == pytest.approx(16384, rel=0.02)
    assert max(map(abs, gyro)) < 100


@pytest.mark.parametrize(("sketch", "place"), [("tkj-kalman", 3), ("tockn", 0)])
def test_an_angle_sketch_sends_the_elevation_about_x(sketch, place):
    it = running(sketch)
    numbers = re.findall(NUMBER, it.said(it.now_s + 1).splitlines()[0])
    assert float(numbers[place]) == pytest.approx(4, abs=0.5)


@pytest.mark.parametrize(("sketch", "place"), [("mpu6050-light", 0), ("dmp-ypr", 2)])
def test_one_that_takes_where_it_starts_for_level_says_0_there(sketch, place):
    it = running(sketch)
    numbers = re.findall(NUMBER, it.said(it.now_s + 1).splitlines()[0])
    assert abs(float(numbers[place])) < 0.5


def test_the_light_sketch_begins_where_it_stands_and_falls_to_0_within_a_second():
    records = [
        float(re.match(r"X : (\S+)\t", p.text)[1])
        for p in pieces(Board("mpu6050-light"), 4)
        if "\t" in p.text
    ]
    assert records[0] == pytest.approx(4 * 0.98**8, abs=0.3)
    assert records[1] / records[0] == pytest.approx(0.98**8, abs=0.05)
    assert abs(records[33]) < 0.2


@pytest.mark.parametrize(
    ("sketch", "first"),
    [
        (
            "i2cdev-raw",
            "Initializing I2C devices...\r\nTesting device connections...\r\nMPU6050 conn",
        ),
        (
            "i2cdev-raw-fast",
            "Initializing MPU...\r\nTesting MPU6050 connection...\r\nMPU6050 conn",
        ),
        ("tkj-kalman", ""),
        ("adafruit-plotter", "\r\n"),
        ("adafruit-basic", "Adafruit MPU6050 test!\r\nMPU6050 Found!\r\n"),
        ("mpu6050-light", "MPU6050 status: 0\r\nCalculating offsets, do not move MPU6050\r\n"),
        ("tockn", f"\r\n{'=' * 40}\r\nCalculating gyro offsets\r\nDO NOT MOVE MPU6050...\r\n"),
        (
            "dmp-ypr",
            "Initializing I2C devices...\r\nTesting device connections...\r\nMPU6050 conn",
        ),
    ],
)
def test_a_banner_comes_after_the_boot_loaders_silence(sketch, first):
    it = Board(sketch)
    assert it.said(0.75) == ""
    assert it.said(6).startswith(first)


def test_the_first_line_of_tockn_is_glued_to_its_banner():
    assert re.search(r"seconds\r\n={40}angleX : ", Board("tockn").said(7))


def test_the_dmp_waits_for_a_character():
    it = Board("dmp-ypr")
    assert it.said(5).endswith("\nSend any character to begin DMP programming and demo: \r\n")
    assert it.said(10) == ""
    it.device.receive(b"s")
    assert "ypr\t" in it.said(13)


@pytest.mark.parametrize(
    ("sketch", "fault", "text"),
    [
        ("i2cdev-raw", "zeros", r"connection failed\r\n(a/g:(\t0){6}\r\n)+"),
        ("i2cdev-raw", "clone", rf"connection failed\r\n({LINES['i2cdev-raw']})+"),
        ("i2cdev-raw-fast", "clone", r"MPU6050 connection failed\r\n"),
        ("tkj-kalman", "clone", "Error reading sensor"),
        ("tkj-kalman", "zeros", r"(i2cWrite failed: 2\r\n)+"),
        ("adafruit-plotter", "clone", "Failed to find MPU6050 chip\r\n"),
        ("adafruit-basic", "zeros", "Failed to find MPU6050 chip\r\n"),
        ("mpu6050-light", "clone", rf"Done!\n\r\n({LINES['mpu6050-light']})+"),
        ("i2cdev-raw", "silent", ""),
    ],
)
def test_a_clone_or_no_sensor_is_what_each_sketch_makes_of_it(sketch, fault, text):
    said = Board(sketch, fault=fault).said(6)
    whole = said if said.endswith("sensor") else said[: said.rfind("\n") + 1]
    assert re.search(f"^{text}$" if not text else f"{text}$", whole)


def test_frozen_lines_go_on_with_the_same_values():
    it = running("i2cdev-raw")
    it.device.fault = "frozen"
    lines = it.said(12).splitlines()[:-1]
    assert len(lines) > 20
    assert len(set(lines)) == 1


def test_every_tenth_line_can_lose_its_second_half():
    it = running("i2cdev-raw-fast")
    it.device.fault = "half_lines"
    text = it.said(12)
    damaged = [ln for ln in text.splitlines(keepends=True) if not re.fullmatch(LINES["i2cdev-raw"], ln)]
    assert len(damaged) == pytest.approx(text.count("a/g:") / 10, abs=2)


def test_a_reset_prints_the_banner_again():
    it = running("i2cdev-raw")
    it.device.fault = "reset"
    assert it.said(12).count("Initializing I2C devices...\r\n") == 1
    assert it.said(18).count("Initializing I2C devices...\r\n") == 1


def test_a_reset_cuts_the_line_that_is_being_sent_and_a_sketch_without_banner_is_just_silent():
    it = running("tkj-kalman")
    it.now_s += 0.003
    half = it.device.emit().decode()
    it.device.fault = "reset"
    assert half and "\n" not in half
    reset_s = it.now_s
    glued, *_ = pieces(it, reset_s + BOOT_S + 0.13)
    assert re.fullmatch(LINES["tkj-kalman"], glued.text)
    assert glued.t_s + BOOT_S - reset_s == pytest.approx(BOOT_S + FIRST_S["tkj-kalman"], abs=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"time_scale": 20, "board": {"sketch": "tockn"}}, "runs in real time: time_scale must be 1"),
        ({"board": {"sketch": "tockn", "fault": "corrupt"}}, "'corrupt' is none of a board that runs tockn"),
        ({"board": {"fault": "clone"}}, "'clone' is none of a board that runs calrig"),
        ({"board": {"sketch": "nosuch"}}, "board.sketch"),
    ],
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(ValueError, match=words):
        SimulatorSettings.from_options(options)


def test_a_rig_makes_the_board_that_is_asked_for():
    rig = SimulatedRig(SimulatorSettings.from_options({"board": {"sketch": "tockn"}}))
    assert isinstance(rig.board, SketchBoard)
    rig.stop()


def test_a_sensor_whose_x_points_up_by_thirty_degrees_has_pitch_minus_thirty():
    """Freescale AN3461, equations 25 and 26: pitch = atan(−Gx/√(Gy² + Gz²)), gravity read as +1 g upward."""
    still = Motion((math.sin(math.radians(30)), 0.0, math.cos(math.radians(30))), (0.0, 0.0, 0.0), 25.0, 0.0)
    assert tilt(still) == pytest.approx((0.0, -30.0))


def test_adafruits_sketches_print_metres_per_second_squared_and_radians_per_second():
    accel, gyro = si(Motion((0.0, -1.0, 1.0), (180.0, -90.0, 0.0), 25.0, 0.0))
    assert (accel, gyro) == (["0.00", "-9.81", "9.81"], ["3.14", "-1.57", "0.00"])
