"""The sketch itself, executed: what it answers, and the samples it sends."""

from __future__ import annotations

import json

import numpy as np
import pytest
from firmware_board import JITTER_US, assert_on_time
from firmware_build import sizes

from calrig.estimation.angles import elevation_deg, wrap_deg
from calrig.estimation.kalman import KalmanFilter
from calrig.instruments.boards.calrig.packets import ACKNOWLEDGE, ERROR, FILTERED_SAMPLE, IDENTITY, SAMPLE


@pytest.mark.parametrize("baudrate", [115200, 500000])
def test_it_fits_the_chip_with_room_for_the_stack(built, baudrate):
    flash, ram = sizes(built.elf(baudrate))
    assert flash <= 32768 - 512, "the boot loader keeps 512 bytes"
    assert ram <= 2048 // 2


@pytest.mark.parametrize(("baudrate", "max_rate_hz"), [(115200, 400), (500000, 1000)])
def test_it_says_who_it_is_when_switched_on_and_when_asked(switch_on, baudrate, max_rate_hz):
    bench = switch_on(baudrate)
    assert json.loads(bench.identity) == {
        "firmware": "calrig_imu 1.0",
        "serial": "",
        "chip": "MPU-6050",
        "accel_range_g": 2,
        "gyro_range_dps": 250,
        "max_rate_hz": max_rate_hz,
    }
    assert bench.line.ask("ID") == (IDENTITY, bench.identity)


def test_every_line_is_answered(bench):
    good = ["STOP", "FILTER ON", "FILTER OFF", "SERIAL AS-0042", "START 1", "START 400", "STOP"]
    assert [bench.line.ask(line) for line in good] == [(ACKNOWLEDGE, line) for line in good]
    assert bench.line.ask("STOP\r") == (ACKNOWLEDGE, "STOP")

    rate = "the rate must be a whole number from 1 to 400"
    for command in ("START 0", "START 401", "START 65937", "START 1e2", "START -5", "START "):
        assert bench.line.ask(command) == (ERROR, f"{command}: {rate}")
    for command in ("HELLO", "id", "START", "FILTER", "SERIAL"):
        assert bench.line.ask(command) == (ERROR, f"{command}: unknown command")
    assert bench.line.ask(80 * "x") == (ERROR, f"{63 * 'x'}: the line is too long")
    assert bench.line.ask("ID")[0] == IDENTITY, "the next line is read as ever"


@pytest.mark.parametrize(
    ("baudrate", "rate_hz", "n"),
    [(115200, 7, 8), (115200, 300, 600), (115200, 400, 1600), (500000, 1000, 2000)],
)
def test_samples_come_whole_and_on_time_and_hold_the_sensors_registers(switch_on, baudrate, rate_hz, n):
    bench = switch_on(baudrate)
    bench.line.start(rate_hz)
    samples = bench.line.samples(n)
    assert bench.line.damage == {}
    assert samples["type"].tolist() == n * [SAMPLE]
    assert samples["seq"].tolist() == list(range(n))
    assert_on_time(samples, rate_hz)
    np.testing.assert_array_equal(samples["registers"], bench.served.counts[:n])
    late_us = 1e6 * np.array(bench.served.times_s[:n]) - samples["t_us"]
    assert np.ptp(late_us) < JITTER_US, "t_us is when the sensor was asked, on a clock that runs true"


def test_a_second_start_begins_anew_after_its_acknowledge(bench):
    bench.line.start(200)
    bench.line.samples(5)
    bench.line.send("START 400")
    *_, again = bench.line.packets(lambda taken: taken[-1][0] == ACKNOWLEDGE, "acknowledge")
    assert again[1:] == b"START 400"
    samples = bench.line.samples(20)
    assert samples["seq"].tolist() == list(range(20))
    assert_on_time(samples, 400)


def test_after_stop_no_sample_follows(bench):
    bench.line.start(400)
    bench.line.samples(5)
    bench.line.send("STOP")
    bench.line.next(ACKNOWLEDGE)
    bench.line.send("ID")
    assert [packet[0] for packet in bench.line.packets(lambda taken: taken, "identity")] == [IDENTITY]


@pytest.mark.parametrize("serial", ["AS-0042", 'a "quoted" \\ name', "Nr. 7 µ", 48 * "x", ""])
def test_the_units_serial_survives_a_reset(bench, serial):
    bench.line.ask("SERIAL before")
    assert bench.line.ask(f"SERIAL {serial}") == (ACKNOWLEDGE, f"SERIAL {serial}")
    bench.board.tell("reset")
    assert json.loads(bench.line.next(IDENTITY)[1])["serial"] == serial


def test_a_reset_in_the_midst_of_a_packet_does_not_swallow_the_identity(bench):
    for _ in range(6):
        bench.line.start(400)  # bytes flow for nine tenths of the time
        bench.line.samples(5)
        bench.board.tell("reset")
        assert bench.line.next(IDENTITY)[1] == bench.identity
    assert bench.line.damage, "none of the resets cut a packet"


@pytest.mark.parametrize(
    ("serial", "why"),
    [(49 * "x", "the serial is too long"), ("a\tb", "the serial has a control character")],
)
def test_a_serial_that_cannot_be_kept_is_refused_and_the_one_before_stays(bench, serial, why):
    bench.line.ask("SERIAL AS-1")
    assert bench.line.ask(f"SERIAL {serial}") == (ERROR, f"SERIAL {serial}: {why}")
    assert json.loads(bench.line.ask("ID")[1])["serial"] == "AS-1"


def test_a_line_that_is_full_loses_whole_samples_and_answers_all(bench):
    bench.line.ask("FILTER ON")
    bench.line.start(400)
    bench.line.samples(50)
    for _ in range(20):
        bench.line.send("ID")

    def all_answered(taken):
        return sum(packet[0] == IDENTITY for packet in taken) == 20

    bench.line.packets(all_answered, "20 identities")
    samples = bench.line.samples(400)
    assert bench.line.damage == {}
    assert (np.diff(samples["seq"].astype(int)) > 0).all()
    assert samples["seq"][-1] - samples["seq"][0] < 460, "samples flow again once all is said"
    assert_on_time(samples, 400)


@pytest.mark.parametrize(("baudrate", "rate_hz"), [(115200, 400), (115200, 50), (500000, 1000)])
def test_its_filter_agrees_with_the_hosts_on_the_same_samples(switch_on, baudrate, rate_hz):
    bench = switch_on(baudrate)
    bench.line.ask("FILTER ON")
    bench.line.start(rate_hz)
    samples = bench.line.samples(3 * rate_hz)  # through upside-down and back
    assert samples["type"].tolist() == len(samples) * [FILTERED_SAMPLE]
    assert samples["seq"].tolist() == list(range(len(samples)))

    accel_g, gyro_x_dps = samples["registers"][:, :3] / 16384, samples["registers"][:, 4] / (32768 / 250)
    host_deg = KalmanFilter().run(1e-6 * samples["t_us"], elevation_deg(accel_g), gyro_x_dps)
    assert host_deg.max() > 185
    assert np.abs(wrap_deg(samples["elevation_cdeg"] / 100 - host_deg)).max() <= 0.02


def test_the_filter_can_be_switched_on_and_off_while_samples_flow(bench):
    bench.line.start(400)
    for command, kind in (("FILTER ON", FILTERED_SAMPLE), ("FILTER OFF", SAMPLE)):
        bench.line.ask(command)
        assert set(bench.line.samples(30)["type"]) == {kind}
