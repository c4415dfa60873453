"""The sign that what a board sends is new; also over lines that lose answers or hold them up."""

from __future__ import annotations

import random

import pytest
from instrument_fakes import CLOCK, take_n

from calrig.instruments.boards.calrig import driver as calrig_mark
from calrig.instruments.boards.calrig.driver import ASK_AGAIN_S, LOST_S, Mark


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


class Line:
    """A line to a board, with the time on it; `answers` are due at an instant each."""

    def __init__(self, delay_s: float = 0.01, loses: float = 0.0):
        self.at_s, self.delay_s, self.loses = 0.0, delay_s, loses
        self.answers: list[float] = []
        self.chance = random.Random(1)
        self.mark = Mark(self.ask, lambda: self.at_s)

    def ask(self):
        if self.chance.random() >= self.loses:
            self.answers.append(self.at_s + self.delay_s)

    def until_it_came(self) -> float:
        """How long a sign took."""
        began_s = self.at_s
        self.mark.begin()
        while not self.mark.came():
            self.at_s += 0.01
            while self.answers and self.answers[0] <= self.at_s:
                self.answers.pop(0)
                assert self.mark.heard()
            assert self.at_s < began_s + 100.0, "the sign never came"
        return self.at_s - began_s


def test_answers_that_are_lost_do_not_add_up():
    """Three of four are lost, as where one byte in a hundred is: each sign takes seconds, none more."""
    line = Line(loses=0.75)
    took_s = []
    for _ in range(60):
        took_s.append(line.until_it_came())
        line.at_s += 0.15  # a dwell on a rig twenty times faster than life
    assert max(took_s) < LOST_S + 12.0
    assert sum(took_s[40:]) < 3.0 * sum(took_s[:20])


def test_an_answer_that_was_held_up_does_not_count_for_an_asking_after_it():
    line = Line()
    line.until_it_came()
    line.delay_s = 2.0
    assert line.until_it_came() >= 2.0
    asked_at_s = line.at_s
    line.mark.begin()
    while line.answers and line.answers[0] < asked_at_s + 2.0:  # of what was asked again meanwhile
        line.at_s = max(line.at_s, line.answers.pop(0))
        assert line.mark.heard()
        assert not line.mark.came()
    line.at_s = asked_at_s + 2.0
    assert line.mark.heard()
    assert line.mark.came()


def test_an_identity_that_nobody_asked_for_is_no_answer():
    line = Line()
    assert not line.mark.heard()
    line.until_it_came()
    line.at_s += ASK_AGAIN_S
    assert not line.mark.heard()
