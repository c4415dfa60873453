"""The sign after which what a board sends was measured since it was asked for."""

from __future__ import annotations

import pytest
from instrument_fakes import CLOCK, take_n

from calrig.instruments.boards.calrig import driver as calrig_mark


def has_marked(board):
    CLOCK.until(lambda: board.marked, "sign")


@pytest.fixture
def held_up(device, streaming):
    """The board, after its samples were held up once."""
    for _ in range(2):
        device.stream(3)
        take_n(streaming, 3)
        CLOCK.sleep(0.3)
    return streaming


def test_a_board_whose_samples_come_at_once_is_not_asked_for_a_sign(device, streaming):
    asked = device.received.count("ID")
    device.stream(3)
    take_n(streaming, 3)
    streaming.mark()
    assert streaming.marked
    assert device.received.count("ID") == asked


def test_the_sign_is_asked_for_until_it_comes_and_is_no_reset(device, held_up):
    device.ids_to_ignore = 1
    held_up.mark()
    assert not held_up.marked
    has_marked(held_up)
    assert device.received.count("START 200") == 1
    device.stream(3)
    assert len(take_n(held_up, 3)) == 3
    assert held_up.faults == {}


def test_a_late_answer_is_not_taken_for_a_new_sign(device, held_up):
    """The first is asked for twice; its second answer comes after the second was asked for."""
    device.ids_to_ignore = 2
    held_up.mark()
    CLOCK.sleep(2 * calrig_mark.ASK_AGAIN_S)
    assert not held_up.marked  # asks again
    device.wait_for("ID", times=device.received.count("ID"))
    device.say_identity()
    has_marked(held_up)
    device.ids_to_ignore = 1_000
    held_up.mark()
    device.say_identity()
    device.stream(3)
    take_n(held_up, 3)
    assert not held_up.marked
    device.ids_to_ignore = 0
    has_marked(held_up)
    assert held_up.faults == {}


def test_a_board_that_gives_no_sign_is_not_waited_for(device, held_up):
    device.ids_to_ignore = 1_000
    before = device.received.count("ID")
    held_up.mark()
    has_marked(held_up)
    assert device.received.count("ID") == before + calrig_mark.ATTEMPTS
    held_up.mark()
    assert held_up.marked


def test_a_reset_that_looks_like_a_sign_is_found_out_by_the_silence_after_it(device, held_up):
    device.stream(3)
    take_n(held_up, 3)
    device.ids_to_ignore = 1
    held_up.mark()
    device.say_identity()
    held_up.take(0.6)
    device.wait_for("START 200", times=2)
    device.stream(3)
    assert len(take_n(held_up, 3)) == 3
    assert held_up.faults["board_reset"] == 1
