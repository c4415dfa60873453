"""What a pass of a sweep makes of the stage's reports."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.estimation.turning import ClockLine
from calrig.instruments.axis import Motion
from calrig.runs.procedures.continuous import Seen


def test_a_stage_that_accepted_the_move_and_has_not_set_off_does_not_spoil_its_reports() -> None:
    seen = Seen(-10.0, 10.0)
    seen.note(Motion(-10.0, moving=True))  # GRBL says ok, and is Idle for another instant
    for at_s in np.arange(0.0, 2.0, 0.05):
        seen.note(Motion(-10.0 + 10.0 * at_s, moving=True, asked_s=(at_s - 0.001, at_s + 0.001)))
    turn = seen.even_turn(0.5, ClockLine(1.0, 7.0))
    assert turn.velocity_dps == pytest.approx(10.0)


def test_of_a_slow_wire_only_answers_without_delay_count() -> None:
    rng = np.random.default_rng(5)
    seen = Seen(-40.0, 40.0)
    asked_s = np.arange(0.0, 8.0, 0.15)
    took_s = 0.13 + rng.choice([0.0, 0.05], len(asked_s), p=[0.6, 0.4]) * rng.uniform(0.2, 1.0, len(asked_s))
    for asked, took in zip(asked_s, took_s, strict=True):
        at_s = asked + 0.065  # a machine that is busy hears the answer late
        seen.note(Motion(-40.0 + 10.0 * at_s, moving=True, asked_s=(asked, asked + took)))
    turn = seen.even_turn(2.0, ClockLine(1.0, 0.0))
    assert turn.velocity_dps == pytest.approx(10.0, rel=2e-4)
    assert turn.scatter_deg < 0.01
