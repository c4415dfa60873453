"""The board's dialect (CONTRACT 3.1), decoded with the public libraries, on a clock that the test turns."""

from __future__ import annotations

import json

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st
from simulated_packets import Packet, decode

from calrig.simulator.bench import Bench
from calrig.simulator.board import Board, sample_packets
from calrig.simulator.config import SimulatorSettings


class Sensor:
    """A board that has said its identity at power-up, and the hand on its clock."""

    def __init__(self, **options) -> None:
        settings = SimulatorSettings.from_options({"preset": "ideal"} | options)
        self.now_s = 1.0
        self.device = Board(settings.board, settings.imu, Bench(settings), lambda: self.now_s)
        self.power_up = self.device.emit()

    def tell(self, command: str) -> list[Packet]:
        return decode(self.device.receive(command.encode() + b"\n"))

    def wait(self, seconds: float) -> list[Packet]:
        self.now_s += seconds
        return decode(self.device.emit())


def test_the_example_of_the_contract():
    counts = np.array([[0, 0, 16384, -512, 0, 0, 0]], dtype=np.int16)
    expected = bytes.fromhex("03 02 01 03 88 13 01 01 01 01 01 01 02 40 02 fe 01 01 01 01 01 03 39 c2 00")
    assert sample_packets(1, np.array([0.005]), counts) == [expected]


@given(
    st.lists(st.lists(st.integers(-32768, 32767), min_size=7, max_size=7), min_size=1, max_size=5),
    st.integers(0, 200_000),
    st.integers(0, 2**33),
)
def test_samples_come_through_as_they_were_with_number_and_clock_wrapped(rows, first, t_us):
    times_s = np.full(len(rows), t_us / 1e6)
    decoded = decode(b"".join(sample_packets(first, times_s, np.array(rows, dtype=np.int16))))
    for k, (packet, row) in enumerate(zip(decoded, rows, strict=True)):
        assert packet.kind == 0x02
        assert packet.sample == ((first + k) % 2**16, t_us % 2**32, *row)


def test_it_says_who_it_is_at_power_up_and_whenever_asked():
    board = Sensor(board={"serial": "AS-0042", "max_rate_hz": 500}, imu={"accel_range_g": 4})
    who = {
        "firmware": "calrig simulated",
        "serial": "AS-0042",
        "chip": "MPU-6050",
        "accel_range_g": 4,
        "gyro_range_dps": 250,
        "max_rate_hz": 500,
    }
    for packet in [*decode(board.power_up), *board.tell("ID"), *board.tell("ID")]:
        assert packet.kind == 0x01
        assert json.loads(packet.text) == who


def test_start_is_acknowledged_before_its_first_sample_and_numbers_from_zero():
    board = Sensor()
    for _ in range(2):
        assert board.tell("START 200")[-1] == Packet(0x04, b"START 200")
        samples = [packet.sample for packet in board.wait(0.125)]
        assert [sample[0] for sample in samples] == list(range(26))
        np.testing.assert_allclose(np.diff([sample[1] for sample in samples]), 5000)


def test_stop_is_acknowledged_after_the_last_sample():
    board = Sensor()
    board.tell("START 100")
    board.now_s += 0.0625
    *samples, last = board.tell("STOP")
    assert [packet.kind for packet in samples] == [0x02] * 7
    assert last == Packet(0x04, b"STOP")
    assert board.wait(1.0) == []
    assert board.tell("STOP") == [Packet(0x04, b"STOP")]


def test_without_a_rate_it_takes_its_own():
    board = Sensor()
    assert board.tell("START") == [Packet(0x04, b"START")]
    assert len(board.wait(0.5)) == 101


@pytest.mark.parametrize(
    "command", ["START 1001", "START 0", "START -5", "START 12.5", "START x", "HELLO", "id", "FILTER ON"]
)
def test_what_it_does_not_know_or_cannot_do_is_answered_with_an_error(command):
    board = Sensor()
    (answer,) = board.tell(command)
    assert answer.kind == 0x03
    assert command in answer.text
    assert board.wait(1.0) == []


def test_a_line_without_end_is_answered_once_and_forgotten():
    board = Sensor()
    (answer,) = decode(board.device.receive(b"x" * 1000))
    assert answer.kind == 0x03
    assert board.tell("ID")[0].kind == 0x01


def test_a_serial_is_kept():
    board = Sensor()
    assert board.tell("SERIAL AS-7")[0] == Packet(0x04, b"SERIAL AS-7")
    assert json.loads(board.tell("ID")[0].text)["serial"] == "AS-7"


def test_commands_are_answered_in_order_between_samples():
    board = Sensor()
    answers = decode(board.device.receive(b"ID\nSTART 50\r\nSTART 50\n\n"))
    assert [packet.kind for packet in answers] == [0x01, 0x04, 0x02, 0x04]


def test_however_late_it_is_asked_no_sample_is_missing():
    board = Sensor()
    board.tell("START 1000")
    numbers = []
    for pause_s in (0.001, 0.0, 3.0, 0.0005, 7.0):
        numbers += [packet.sample[0] for packet in board.wait(pause_s)]
    while late := board.wait(0.0):
        numbers += [packet.sample[0] for packet in late]
    assert numbers == list(range(10_002))


def test_an_answer_comes_after_all_that_was_measured_before_it_however_much_that_is():
    board = Sensor()
    board.tell("START 1000")
    board.now_s += 5.0
    said = board.tell("ID")
    while not any(packet.kind == 0x01 for packet in said):
        said += board.wait(0.0)
    assert [packet.kind for packet in said].index(0x01) == 5001


def test_a_reset_board_says_who_it_is_and_streams_no_more():
    board = Sensor()
    board.tell("START 1000")
    board.wait(1.0)
    board.device.reset()
    assert [packet.kind for packet in board.wait(1.0)] == [0x01]
    assert board.device.interval_s is None  # it only listens
    board.tell("START 1000")
    assert board.wait(0.5)[-1].sample[1] == 500_000  # its clock began anew


def test_faults_on_purpose():
    board = Sensor(board={"fault": "silent"})
    assert board.power_up == b""
    assert board.tell("ID") == []

    board = Sensor(board={"fault": "gaps"})
    board.tell("START 100")
    assert [packet.sample[0] for packet in board.wait(0.25)] == [k for k in range(26) if k % 10 != 9]

    board = Sensor(board={"fault": "corrupt"})
    board.tell("START 100")
    board.now_s += 0.25
    frames = board.device.emit().split(b"\0")[:-1]
    with pytest.raises((AssertionError, cobs.DecodeError)):
        decode(frames[9] + b"\0")
    assert len(decode(frames[8] + b"\0")) == 1

    board = Sensor(imu={"accel_noise_ug_per_rthz": 400.0})
    board.tell("START 100")
    board.wait(0.1)
    board.device.fault = "frozen"
    assert len({packet.payload[6:] for packet in board.wait(0.1)}) == 1

    board.device.fault = "garbage"
    board.now_s += 0.1
    with pytest.raises((AssertionError, cobs.DecodeError)):
        decode(board.device.emit())


def test_a_resonator_that_runs_too_fast_counts_shorter_seconds_and_samples_as_often():
    sensor = Sensor(board={"clock_error_ppm": 5000})
    sensor.tell("START 200")
    told = [packet for _ in range(100) for packet in sensor.wait(0.1)]
    assert len(told) == 2010
    assert np.diff([packet.sample[1] for packet in told]) == pytest.approx(
        5000, abs=2
    )  # its own microseconds
