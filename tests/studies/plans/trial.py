"""Designed plans carried out on the simulator's physics, and what becomes of what was promised for them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calrig.calibration.diagnosis.tracing import diagnose
from calrig.calibration.plan_design.design_problem import (
    DesignProblem,
    Sweeping,
    TypeB,
    stated_for_scatter_1,
)
from calrig.calibration.plan_design.layout import DATA_SHEET_WHITE, Pace, Precision, Turning, leverage
from calrig.calibration.results.result import build_result
from calrig.calibration.uncertainty.budget import Reference, uncertainty
from calrig.instruments.axis import travel_time_s
from calrig.plan import Plan
from calrig.runs.plan_estimates import HOMING_S, QUESTIONS_S, START_S
from tests.studies.blind.causes import Draw
from tests.studies.blind.layout import ACCELERATION_DPS2, Layout, timeline
from tests.studies.blind.physics import Noise, measure

VELOCITY_DPS, SETTLE_S = 20.0, 0.2
"""A table that is at rest when it arrives, as the gyro shows it: a designed plan waits no longer."""
AROUND = {"mount": {"offset_deg": 0.8}, "mechanics": {"scale_error_pct": 0.2}}
PRECISION = Precision(DATA_SHEET_WHITE, 0.0, "a data sheet's noise")


def travel_s(distance_deg: float) -> float:
    return travel_time_s(distance_deg, VELOCITY_DPS, ACCELERATION_DPS2)


PACE = Pace(travel_s, SETTLE_S, QUESTIONS_S, HOMING_S + START_S, pass_s=QUESTIONS_S)


def task(reference: Reference, *, trace: bool, sweeping: bool = False) -> DesignProblem:
    """Of ±60° on an ordinary stage, which may turn without stopping."""
    turns = Sweeping(Turning(VELOCITY_DPS, ACCELERATION_DPS2), PRECISION) if sweeping else None
    type_b = TypeB(reference.std_deg, reference)
    return DesignProblem((-60.0, 60.0), PRECISION, PACE, type_b, trace, sweeping=turns)


def fixed() -> Layout:
    """The default plan: 52 poses of 2 s."""
    return Layout.of(Plan())


def stage_time_s(plan: Layout) -> float:
    """Of a plan on that stage: begin, moves, settling, questions and dwells."""
    places = [0.0, *plan.target_deg.tolist()]
    moves_s = sum(travel_s(abs(after - before)) for before, after in pairwise(places))
    return HOMING_S + START_S + moves_s + (len(places) - 1) * (plan.settle_s + plan.dwell_s + QUESTIONS_S)


def expected_deg(plan: Layout, reference: Reference) -> float:
    """Expanded uncertainty that a plan is expected to state, as of a design."""
    scatter_deg = PRECISION.scatter_deg(plan.dwell_s)
    of = task(reference, trace=False).stated(plan.target_deg.tolist(), plan.dwell_s, math.nan, scatter_deg)
    assert of.expanded_deg is not None
    return of.expanded_deg


def standard_errors(plan: Layout) -> tuple[float, float]:
    """Of bias, degrees, and scale, as a plan's result is expected to state them."""
    _, bias, scale = stated_for_scatter_1(len(plan.target_deg), leverage(plan.target_deg.tolist()))
    scatter_deg = PRECISION.scatter_deg(plan.dwell_s)
    return scatter_deg * bias, scatter_deg * scale


def laid_out(elevations_deg: Sequence[float], dwell_s: float) -> Layout:
    """Dwells, as the simulator's physics takes them."""
    return Layout(np.array(elevations_deg), np.zeros(len(elevations_deg), dtype=int), SETTLE_S, dwell_s)


@dataclass(frozen=True)
class Kept:
    """Over many runs: mean of the expanded uncertainty stated, and how often a later reading kept to it."""

    stated_deg: float
    covered: float


def kept(layout: Layout, reference: Reference, runs: int, seed: int = 0) -> Kept:
    """Runs of noise alone, each judged by one later reading of a known elevation.

    The reference is a perfect one beside its statement: of type A this is the coverage.
    """
    stated, within = [], 0
    scatter_deg = PRECISION.scatter_deg(layout.dwell_s)
    clean = measure(layout, [], Noise(reading_deg=0.0, norm_mg=0.3), np.random.default_rng(0), AROUND).poses
    theta = np.array([pose.theta_deg for pose in clean])
    true = np.array([pose.reading_deg for pose in clean])
    scale, bias = np.polyfit(theta, true, 1)
    rng = np.random.default_rng(seed)
    for _ in range(runs):
        readings = bias + scale * theta + scatter_deg * rng.standard_normal(len(theta))
        poses = [
            type(clean[0])(target_deg=float(t), reading_deg=float(r))
            for t, r in zip(theta, readings, strict=True)
        ]
        line = build_result(poses).line
        worth = uncertainty(line, theta, reference)
        assert worth.expanded_deg is not None
        assert line.scale is not None
        stated.append(worth.expanded_deg)
        alone = uncertainty(line, theta, Reference(1e-12, "setting", "normal"))
        at = rng.uniform(theta.min(), theta.max())
        read = bias + scale * at + scatter_deg * rng.standard_normal()
        assert alone.expanded_deg is not None
        within += abs((read - line.bias_deg) / line.scale - at) <= alone.expanded_deg
    return Kept(float(np.mean(stated)), within / runs)


def found(layout: Layout, cause: Draw, name: str, runs: int, seed: int = 0) -> int:
    """In how many runs with a cause the diagnosis lists its effect, by itself or among its suspects."""
    when = timeline(layout)
    scatter_deg = PRECISION.scatter_deg(layout.dwell_s)
    noise = Noise(reading_deg=scatter_deg, norm_mg=1e3 * math.radians(scatter_deg))
    times = 0
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        run = measure(layout, [cause(rng, when)], noise, rng, AROUND)
        effects = diagnose([run.poses], cross_fit=False).findings.found
        times += any(name in {c.name for c in (one.candidate, *one.rivals)} for one in effects)
    return times
