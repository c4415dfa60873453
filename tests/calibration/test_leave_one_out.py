"""A name must stand without any one pose: at a turning point one may be all that tells two effects apart."""

from __future__ import annotations

import numpy as np
from posed import posed

from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.held_out import standing_without_one
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.regression.responses import Responses, responses_of

NOISE_DEG = 0.01
STEP_DEG = 5.0
FRACTION = 0.03


def run_of(theta_deg: np.ndarray, fraction: float = FRACTION) -> Responses:
    """A run whose readings lack a share of the last move, which is up or down alike."""
    move_deg = np.diff(theta_deg, prepend=theta_deg[0] - STEP_DEG)
    noise_deg = np.random.default_rng(2).normal(0.0, NOISE_DEG, len(theta_deg))
    readings_deg = theta_deg - fraction * move_deg + noise_deg
    approach = np.sign(move_deg)
    return responses_of([posed(target_deg=theta_deg, reading_deg=readings_deg, approach=approach)])


def judged(r: Responses) -> SelectedEffect:
    """Settling, named against backlash by these poses, once each pose has been left out."""
    of = {c.name: c for c in candidates_of(r) if c.named}
    claimed = SelectedEffect(of["settling"], (), 0.001, 50.0, runners_up=(of["backlash"],))
    (found,) = standing_without_one(r, [claimed])
    return found


def even_steps() -> np.ndarray:
    up = np.arange(-60.0, 61.0, STEP_DEG)
    return np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]])


def test_what_one_long_move_alone_decides_is_not_named() -> None:
    """All moves are of 5° but one of 20°: backlash and settling are the same thing everywhere else."""
    theta_deg = np.delete(even_steps(), [30, 31, 32])
    found = judged(run_of(theta_deg))
    assert found.verdict == "ambiguous"
    assert [rival.name for rival in found.rivals] == ["backlash"]
    (doubt,) = found.doubts
    assert f"only the pose at {theta_deg[30]:.4g}° tells it from backlash of the stage" in doubt


def test_what_moves_of_many_lengths_decide_stays_named() -> None:
    theta_deg = np.random.default_rng(4).permutation(even_steps())
    found = judged(run_of(theta_deg))
    assert (found.verdict, found.doubts) == ("named", ())


def test_a_name_that_had_rivals_before_keeps_them_and_gets_no_others() -> None:
    r = run_of(even_steps())
    of = {c.name: c for c in candidates_of(r) if c.named}
    before = SelectedEffect(of["settling"], (of["backlash"],), 0.001, 1.0, runners_up=(of["backlash"],))
    assert standing_without_one(r, [before]) == (before,)


def test_in_some_of_the_poses_all_that_an_effect_may_be_has_those_alone() -> None:
    r = run_of(even_steps())
    of = {c.name: c for c in candidates_of(r) if c.named}
    others = dict.fromkeys(("rivals", "runners_up", "alike"), (of["backlash"],))
    fewer = SelectedEffect(of["settling"], p_value=0.001, lead=1.0, **others).rows(np.arange(20))
    those = [fewer.candidate, *fewer.rivals, *fewer.runners_up, *fewer.alike]
    assert [len(c.columns) for c in those] == [20] * 4
