"""What a look at a rig's board says of the unit on it, before anybody presses Enter."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.instruments.types import BoardIdentity, Samples
from calrig.runs.mounting import Mounting
from calrig.runs.presence import evaluate_board

BOARD = BoardIdentity("calrig", "1", "AS-0043", "MPU-6050", 2, 250, 1000)
AT_REST_G, IN_HAND_G = 0.003, 0.1


def standing(angle_deg, *, axis=(0, 1, 2), g=1.0, spread_g=AT_REST_G):
    """Twenty samples of a unit that stands so."""
    turn = np.radians(angle_deg)
    accel = g * np.array([0.0, np.sin(turn), np.cos(turn)])[list(axis)]
    noise = np.random.default_rng(1).normal(0.0, spread_g, (20, 3))
    nothing = np.zeros((20, 3))
    return Samples(np.arange(20) / 50, accel + noise, nothing, np.full(20, 25.0), np.full(20, np.nan))


@pytest.mark.parametrize(
    ("samples", "mount", "stage_deg", "state", "says"),
    [
        (standing(21), Mounting(0), 20, "there", "21.0° (by accelerometer)"),
        (standing(141), Mounting(120), 20, "there", "141.0°"),
        (standing(93), Mounting(0), None, "there", "93.0°"),
        (standing(0, spread_g=IN_HAND_G), Mounting(0), 0, "moving", "being moved"),
        (standing(93), Mounting(0), 20, "askew", "at 93.0°. Clamped as asked it would be at 20.0°"),
        (standing(0, axis=(2, 0, 1)), Mounting(0), None, "askew", "x does not lie along the stage's axis"),
        (standing(0, g=0.4), Mounting(0), 0, "askew", "0.40 g at rest"),
    ],
)
def test_gravity_tells_whether_the_unit_sits_as_asked(samples, mount, stage_deg, state, says):
    sight = evaluate_board(BOARD, samples, stage_deg).sighting(mount)
    assert (sight.state, sight.serial) == (state, "AS-0043") and says in sight.says


def test_the_boards_word_tells_which_unit_it_is():
    sight = evaluate_board(BOARD, standing(0), 0.0).sighting(Mounting(0))
    assert sight.of_unit("AS-0043").says.startswith("Board of AS-0043")
    assert sight.of_unit("AS-0044").state == "wrong"


def test_a_board_that_computes_its_angle_itself_is_taken_at_its_word():
    own = standing(0)
    none = np.full((20, 3), np.nan)
    look = evaluate_board(BOARD, Samples(own.time_s, none, none, own.temperature_c, np.full(20, -179.9)), 0)
    sight = look.sighting(Mounting(0))
    assert sight.state == "there" and "-179.9°" in sight.says
