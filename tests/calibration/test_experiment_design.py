"""The run that separates two suspects, beside the same distances worked out by plain least squares."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from support import one_now

from calrig.calibration.diagnosis.candidates import candidates_of, model_columns
from calrig.calibration.diagnosis.experiment_design import LEAST_SEPARATION, FollowUp, design
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.poses import Pose
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import responses_of

LIMITS_DEG = (-90.0, 90.0)
PLAY_DEG, NOISE_DEG = 0.06, 0.025


@pytest.fixture(scope="module")
def measured() -> list[Pose]:
    """Four sweeps over an even grid: backlash and moves that have not settled look alike there."""
    rng = np.random.default_rng(3)
    poses = []
    for sweep in range(4):
        approach = 1 if sweep % 2 == 0 else -1
        for elevation in range(-60 * approach, 61 * approach, 10 * approach):
            reading = elevation - approach * PLAY_DEG / 2 + rng.normal(0.0, NOISE_DEG)
            poses.append(Pose(float(elevation), reading, sweep=sweep, approach=approach))
    return poses


@pytest.fixture(scope="module")
def designed(measured: list[Pose]) -> FollowUp:
    r = responses_of([measured])
    (play, *_), (moves, *_) = (
        [c for c in candidates_of(r) if c.name == name] for name in ("backlash", "settling")
    )
    columns = model_columns(r, [play])
    found = SelectedEffect(play, (moves,), p_value=0.005, lead=1.0)
    kept = np.arange(len(r))
    findings = Findings(r, kept, (found,), fit(r, columns), columns, least_p_value=0.005)
    follow_up = design([measured], findings, LIMITS_DEG)
    assert isinstance(follow_up, FollowUp)
    return follow_up


def columns_of(*runs: list[float]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Base (bias of each run, one scale, each first pose free) and the suspects' shapes, of elevations."""
    theta = np.concatenate(runs)
    of_run = np.repeat(range(len(runs)), [len(run) for run in runs])
    first = np.flatnonzero(np.diff(of_run, prepend=-1))
    moves = np.diff(theta, prepend=theta[0])
    senses = np.sign(moves)
    for k in np.flatnonzero(senses == 0.0):  # a stage that stays keeps the side that it stands on
        senses[k] = senses[k - 1] if k else 1.0
    base = [*(of_run == run for run in range(len(runs))), theta, *(np.arange(len(theta)) == k for k in first)]
    return np.array(base, dtype=np.float64).T, {"backlash": senses, "settling": moves}


def left_of(y: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares: coefficients, and what they leave."""
    beta = np.linalg.lstsq(columns, y, rcond=None)[0]
    return beta, y - columns @ beta


def separation(measured: list[Pose], chosen: list[float]) -> float:
    """What either suspect, at its size and true, leaves when the other one is fitted in its place."""
    before, readings = [pose.target_deg for pose in measured], np.array([p.reading_deg for p in measured])
    base, shapes = columns_of(before)
    fits = {name: left_of(readings, np.column_stack([base, shape])) for name, shape in shapes.items()}
    sizes = {name: beta[-1] for name, (beta, _) in fits.items()}
    left = fits["backlash"][1]
    variance = left @ left / (len(left) - base.shape[1] - 1)
    base, shapes = columns_of(before, chosen)
    return min(
        float(np.sum(left_of(sizes[true] * shapes[true], np.column_stack([base, shapes[rival]]))[1] ** 2))
        / variance
        for true, rival in permutations(shapes)
    )


def test_the_separation_that_is_promised_is_what_the_rival_fitted_in_its_place_would_leave(
    measured: list[Pose], designed: FollowUp
) -> None:
    assert set(designed.separates) == {"backlash", "settling"}
    chosen = list(designed.elevations_deg[: designed.deciding])
    assert designed.separation == pytest.approx(separation(measured, chosen), rel=0.1)
    assert designed.separation > LEAST_SEPARATION


def test_as_many_poses_at_random_separate_less(measured: list[Pose], designed: FollowUp) -> None:
    chosen = list(designed.elevations_deg[: designed.deciding])
    rng = np.random.default_rng(4)
    at_random = [separation(measured, rng.uniform(*LIMITS_DEG, len(chosen)).tolist()) for _ in range(100)]
    assert separation(measured, chosen) > max(at_random)


@pytest.mark.parametrize("form", ["smooth 5", *one_now(["curved", "square"])])
def test_a_drift_that_was_one_with_the_elevation_is_predicted_where_it_is_not(form: str) -> None:
    rng = np.random.default_rng(5)
    theta = np.linspace(-60.0, 60.0, 60)
    bend = 0.5 * (theta / 60.0) ** 2 + 0.4 * (theta / 60.0) ** 3
    run = [
        Pose(float(t), float(t + off + rng.normal(0.0, NOISE_DEG)), time_s=10.0 * k)
        for k, (t, off) in enumerate(zip(theta, bend, strict=True))
    ]
    r = responses_of([run])
    offered = candidates_of(r)
    drift = next(c for c in offered if c.name == "time_drift" and c.shape.form == form)
    bent = next(c for c in offered if c.name == "nonlinearity" and c.shape.form == "both")
    columns = model_columns(r, [drift])
    found = SelectedEffect(drift, (bent,), p_value=0.005, lead=1.0)
    findings = Findings(r, np.arange(len(r)), (found,), fit(r, columns), columns, least_p_value=0.005)

    follow_up = design([run], findings, LIMITS_DEG)

    if form == "smooth 5":  # its knots are of the times that were measured
        assert isinstance(follow_up, str)
        assert "these poses do not determine how drift in time acts" in follow_up
    else:
        assert isinstance(follow_up, FollowUp)
        assert set(follow_up.separates) == {"time_drift", "nonlinearity"}
        assert follow_up.separation > LEAST_SEPARATION
