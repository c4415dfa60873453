"""The sign that what follows is new: asked for over lines that lose answers or hold them up."""

from __future__ import annotations

import random

from calrig.instruments.boards.calrig.driver import ASK_AGAIN_S, LOST_S, Mark


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
