"""The sketch on a board whose sensor fails, is a clone, or is not there."""

from __future__ import annotations

import json

import numpy as np
import pytest
from firmware_board import assert_on_time
from support import wait_for

from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.boards.calrig.packets import ERROR, IDENTITY

RATE_HZ = 400
LOST = "the sensor does not answer any more: check its wires; trying again"


def chip(line):
    return json.loads(line.ask("ID")[1])["chip"]


def streaming(bench):
    """Samples flow; the first twenty."""
    bench.line.start(RATE_HZ)
    return bench.line.samples(20)


def next_samples_after(bench, told_s, n=40):
    """Samples taken after what the harness was told took effect."""
    while True:
        samples = bench.line.samples(n)
        if samples["t_us"][0] > 1e6 * told_s:
            return samples


@pytest.mark.parametrize("break_it, mend_it", [("silent 1", "silent 0"), ("stick 100000", "stick 0")])
def test_a_sensor_that_falls_silent_is_told_once_and_its_samples_go_on_when_it_answers(
    bench, break_it, mend_it
):
    before = streaming(bench)
    bench.board.tell(break_it)
    assert bench.line.next(ERROR) == (ERROR, LOST)
    assert bench.line.ask("ID")[0] == IDENTITY, "it still answers"
    mended_s = bench.board.tell(mend_it)
    packets = bench.line.packets(lambda taken: len(taken) == 40, "samples again")
    assert all(packet[0] != ERROR for packet in packets)
    after = next_samples_after(bench, mended_s)
    assert_on_time(np.concatenate([before, after]), RATE_HZ)  # each lost sample has its seq
    assert (np.diff(after["seq"].astype(int)) == 1).all()
    assert bench.line.damage == {}


def test_a_bus_held_in_the_midst_of_a_byte_is_clocked_free_with_hardly_a_sample_lost(bench):
    before = streaming(bench)
    after = next_samples_after(bench, bench.board.tell("stick 7"))
    assert_on_time(np.concatenate([before, after]), RATE_HZ)
    assert np.diff(bench.served.times_s).max() < 0.02


def test_a_bus_held_when_start_comes_is_freed_first(bench):
    bench.board.tell("stick 7")
    assert_on_time(streaming(bench), RATE_HZ)


def test_a_sensor_that_lost_its_power_for_a_moment_is_set_up_again_and_no_zeros_are_sent(bench):
    taken = streaming(bench)
    told_s = bench.board.tell("brown_out")
    while taken["t_us"][-1] < 1e6 * (told_s + 0.5):
        taken = np.concatenate([taken, bench.line.samples(40)])
    assert np.diff(taken["seq"].astype(int)).max() > 1
    samples = bench.line.samples(40)
    assert (np.diff(samples["seq"].astype(int)) == 1).all()
    assert samples["registers"].any(axis=1).all()


def test_a_sensor_at_0x69_is_found(bench):
    bench.board.tell("address 0x69")
    assert bench.line.ask("ID")[1] == bench.identity
    assert streaming(bench)["registers"].any()


@pytest.mark.parametrize(
    ("who_am_i", "name"),
    [
        (0x70, "MPU-6500"),
        (0x71, "MPU-9250"),
        (0x72, "MPU-6050 clone, WHO_AM_I 0x72"),
        (0x98, "ICM-20689"),
    ],
)
def test_a_clone_is_named_and_used(bench, who_am_i, name):
    bench.board.tell(f"who_am_i {who_am_i}")
    assert chip(bench.line) == name
    samples = streaming(bench)
    np.testing.assert_array_equal(samples["registers"], bench.served.counts[: len(samples)])


def test_without_a_sensor_start_is_refused_in_words_until_one_is_connected(bench):
    bench.board.tell("silent 1")
    bench.board.tell("reset")
    assert json.loads(bench.line.next(IDENTITY)[1])["chip"] is None
    kind, words = bench.line.ask("START 200")
    assert kind == ERROR
    assert "no MPU-6050 answers at 0x68 or 0x69" in words
    bench.board.tell("silent 0")
    assert chip(bench.line) == "MPU-6050"
    assert len(streaming(bench)) == 20


def test_another_device_at_the_sensors_address_is_not_taken_for_one(bench):
    bench.board.tell("forgetful 1")
    assert bench.line.ask("START 200")[0] == ERROR


def test_the_host_starts_a_board_again_that_was_reset(bench):
    bench.line.close()
    board = CalrigBoard.open(bench.board.port)
    try:
        board.identify()
        board.start(200)
        assert len(board.take(5.0))
        bench.board.tell("reset")
        wait_for(lambda: board.take(1.0) and board.faults["board_reset"], "restart")
        assert len(board.take(5.0))
    finally:
        board.close()


def test_frozen_registers_reach_the_host_which_tells_them_from_a_reading(bench):
    bench.line.close()
    board = CalrigBoard.open(bench.board.port)
    try:
        board.identify()
        board.start(200)
        assert len(board.take(5.0))
        bench.board.tell("frozen 1")
        wait_for(lambda: [board.take(0.1)] and board.faults["frozen"] > 50, "frozen samples")
        bench.board.tell("frozen 0")
        wait_for(lambda: len(board.take(0.1)), "samples again")
    finally:
        board.close()
