"""What is covered by what runs state that end as soon as they are good enough: by the program's own rule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calrig.analysis.results import fitted
from calrig.calibration.plan_design.layout import layout
from calrig.calibration.poses import Filtering, Pose
from calrig.plan import Plan, Until
from calrig.runs.plan_estimates import REACHED, StoppingRule

PERFECT = {"rig": {"reference": {"std_deg": 1e-9, "kind": "setting", "distribution": "normal"}}}
"""Beside such a stage all of the uncertainty is of type A: what ending early could shrink."""
SCATTER_DEG = 0.02
FREEDOM_WITHIN = 20
"""Of a pose's own standard error."""
DELAY = 0.2
"""Of that scatter, by which the error of a pass's own delay shifts its stretches, one way or the other by the
sense of turning: 0.5 ms of a turn at 4°/s."""


def designed(n_poses: int) -> Plan:
    """Of two ways through ±60°."""
    order = layout((-60.0, 60.0), n_poses, 2, 0.3, np.random.default_rng(0))
    return Plan(elevations_deg=order, order="given", sweeps=1)


def turning(passes: int) -> Plan:
    """As many ways through ±60° without stopping, each of 15 stretches."""
    return Plan(kind="sweep", sweeps=passes, step_deg=8.0, velocity_dps=3.8, dwell_s=2.1)


@dataclass(frozen=True)
class Covered:
    """Over many runs: the share that ended early, poses taken, and shares inside of what was stated.

    Of one later reading inside of the expanded uncertainty, of bias and scale inside of two standard errors.
    `expanded_deg` is the mean of what they state.
    """

    early: float
    poses: float
    elevation: float
    bias: float
    scale: float
    expanded_deg: float


def covered(
    plan: Plan,
    times: float,
    share: float,
    runs: int,
    seed: int = 0,
    *,
    correlation: float = 0.0,
    of_bias: bool = False,
) -> Covered:
    """Runs of noise alone that end once their expanded uncertainty is small enough.

    Args:
        plan: its poses are the most.
        times: the uncertainty wanted, in scatters of a reading; below 2 it is reached by chance alone.
        share: of that scatter, what a dwell shows of itself: 1 with white noise and nothing else.
        runs: how many.
        seed: of the noise.
        correlation: of the noise from pose to pose, a first-order autoregression.
        of_bias: whether the run ends once the standard error of its bias is small enough instead.
    """
    rng = np.random.default_rng(seed)
    planned = plan.poses((-90.0, 90.0))
    wanted_deg = times * SCATTER_DEG
    until = Until(bias_std_deg=wanted_deg) if of_bias else Until(expanded_uncertainty_deg=wanted_deg)
    known = StoppingRule(until, planned, [], PERFECT)
    rows = []
    for _ in range(runs):
        poses = _until_stopped(known, share, rng, correlation)
        result = fitted(poses, [], PERFECT, ending=REACHED)
        assert result.over_range and result.bias_std_deg and result.scale and result.scale_std
        at_deg = rng.uniform(-60.0, 60.0)
        read_deg = at_deg + SCATTER_DEG * rng.standard_normal()
        expanded_deg = result.over_range.expanded_uncertainty_deg or 0.0
        off_deg = (read_deg - result.bias_deg) / result.scale - at_deg
        rows.append(
            (
                len(poses) < len(planned),
                len(poses),
                abs(off_deg) <= expanded_deg,
                abs(result.bias_deg) <= 2.0 * result.bias_std_deg,
                abs(result.scale - 1.0) <= 2.0 * result.scale_std,
                expanded_deg,
            )
        )
    return Covered(*np.mean(rows, axis=0).tolist())


def _until_stopped(
    known: StoppingRule, share: float, rng: np.random.Generator, correlation: float
) -> list[Pose]:
    """Poses until they are found good enough; of a sweep that is looked at after each pass."""
    turns = any(one.stretch_deg is not None for one in known.planned)
    poses: list[Pose] = []
    error = 0.0
    delays_deg: list[float] = []
    for one in known.planned:
        within = share * SCATTER_DEG * np.sqrt(rng.chisquare(FREEDOM_WITHIN) / FREEDOM_WITHIN)
        drawn = rng.standard_normal()
        error = correlation * error + (1.0 - correlation**2) ** 0.5 * drawn if poses else drawn
        read_deg = one.target_deg + SCATTER_DEG * error
        pose = Pose(target_deg=one.target_deg, reading_deg=float(read_deg), reading_stderr_deg=float(within))
        if one.stretch_deg is not None:
            sense = int(np.sign(one.stretch_deg[1] - one.stretch_deg[0]))
            if len(delays_deg) == one.sweep:
                delays_deg.append(DELAY * SCATTER_DEG * rng.standard_normal())
            off_deg = sense * float(
                np.mean(delays_deg)
            )  # the delay of all passes so far, each pass's own error
            filtering = Filtering(remembers=False)
            pose = replace(pose, reading_deg=pose.reading_deg + off_deg, approach=sense, filtering=filtering)
        poses.append(pose)
        if (one.stretch_deg is None or not turns) and known.reached(poses):
            break
    return poses
