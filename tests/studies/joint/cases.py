"""What is tried: the issue's designs for the bound, and rigs drawn at random for the coverage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calrig.calibration.regression.effect import Circumstances
from calrig.calibration.results.correction import calibrated_elevation_deg
from calrig.calibration.separation.solution import Solution, solve
from calrig.export.solution_documents import effects_of

from .oracle import angle_deg, bound_deg, calibrated_error_deg
from .rig import REFERENCE_C, Bench, Design, drawn_stage, drawn_unit

TURN = (-180.0, 180.0)
SEVENTHS = (0.0, 360.0 / 7.0, 3.0 * 360.0 / 7.0)


@dataclass(frozen=True)
class Case:
    """Benches to be solved, all alike but for their seed.

    `issue_deg` is the bound that the issue states; None where there is none, as where nothing can be told.
    """

    design: Design
    linear: bool = False
    highest: int = 6
    gap_deg: float = 0.0
    warm_c: float = 0.0
    correlation: float = 0.0
    issue_deg: float | None = None

    def bench(self, seed: int) -> Bench:
        """A bench of this case."""
        rng = np.random.default_rng([seed, 15])
        unit = drawn_unit(rng, cubic=not self.linear, drift=self.warm_c > 0.0)
        stage = drawn_stage(rng, self.highest, gap_deg=self.gap_deg)
        visits = self.design.visits(rng, warm_c=self.warm_c)
        return Bench((unit,), stage, visits, correlation=self.correlation)


BOUNDS = {
    "0/120/240, ±60°, cubic": Case(Design((0.0, 120.0, 240.0)), issue_deg=0.0043),
    "0/120/240, full turn, cubic": Case(Design((0.0, 120.0, 240.0), TURN), issue_deg=0.0035),
    "one mount, full turn, stated linear": Case(Design((0.0,), TURN), linear=True, issue_deg=0.0055),
    "0/90, ±60°, stated linear": Case(Design((0.0, 90.0)), linear=True, issue_deg=0.0063),
    "{0, 1, 3}·360/7, full turn, cubic": Case(Design(SEVENTHS, TURN)),
}
ROUGH = Case(Design((0.0, 120.0, 240.0)), highest=12, gap_deg=0.05, warm_c=4.0)
COVERAGE = {
    "0/120/240, ±60°": ROUGH,
    "the same, noise correlated by 0.3": replace(ROUGH, correlation=0.3),
    "the same, noise correlated by 0.6": replace(ROUGH, correlation=0.6),
    "0/120/240, full turn": replace(ROUGH, design=Design((0.0, 120.0, 240.0), TURN)),
    "{0, 1, 3}·360/7, full turn": replace(ROUGH, design=Design(SEVENTHS, TURN)),
    "0/90/225, ±90°": replace(ROUGH, design=Design((0.0, 90.0, 225.0), (-90.0, 90.0))),
}
"""Twelve harmonics, cubic units, play, offsets that drift as the bench warms by 4 °C from mount to mount."""
UNTOLD = {
    "one mount, ±60°": Case(Design((0.0,))),
    "one mount, full turn": Case(Design((0.0,), TURN)),
    "0/90, ±60°": Case(Design((0.0, 90.0))),
}
"""A unit that may have cubic terms: these poses cannot tell."""


@dataclass(frozen=True)
class Judged:
    """One bench: mean square error over ±60°, what the solution says of itself, and the bound."""

    square_deg2: float
    stated_deg2: float
    bound_deg: float
    within_two: float
    orders: int


def solved(bench: Bench, seed: int, *, linear: bool) -> Solution:
    """The solution of one draw of noise."""
    return solve(bench.measured(np.random.default_rng([seed, 150])), linear=linear)


def judge(case: Case, seed: int, *, with_bound: bool) -> Judged:
    """One bench measured, solved, and its calibration applied as flight software would."""
    bench = case.bench(seed)
    solution = solved(bench, seed, linear=case.linear)
    error = error_deg(bench, solution)
    worth = solution.uncertainties[0]
    bound = bound_deg(replace(bench, visits=_still(bench)), linear=case.linear) if with_bound else math.nan
    return Judged(
        square_deg2=float(np.mean(error**2)),
        stated_deg2=worth.rms_deg**2,
        bound_deg=bound,
        within_two=float(np.mean(np.abs(np.interp(worth.elevation_deg, GRID, error)) < 2.0 * worth.std_deg)),
        orders=len(solution.choice.orders),
    )


GRID = np.linspace(-60.0, 60.0, 121)


def error_deg(bench: Bench, solution: Solution, unit: int = 0) -> np.ndarray:
    """(121,) error of the calibration over ±60°, its mean removed."""
    reference = float(solution.table.reference_c[unit])
    die_c = REFERENCE_C if math.isnan(reference) else reference
    effects = [(effect["name"], effect["parameters"]) for effect in effects_of(solution, unit)]

    def apply(angle_deg: np.ndarray) -> np.ndarray:
        given = Circumstances(temperature_c=np.full(len(angle_deg), die_c))
        return calibrated_elevation_deg(angle_deg, 0.0, 1.0, effects, given)

    return calibrated_error_deg(bench, unit, die_c, apply)


def absolute_error_deg(bench: Bench, document: Mapping[str, Any]) -> np.ndarray:
    """(121,) error of a calibration of unit 0 over ±60°, against its case's elevation; nothing removed."""
    effects = [(effect["name"], effect["parameters"]) for effect in document["effects"]]
    angle = angle_deg(bench.units[0], GRID + bench.units[0].in_case_deg)
    return calibrated_elevation_deg(angle, document["bias_deg"], document["scale"], effects) - GRID


def _still(bench: Bench):
    return tuple(replace(v, die_c=np.full(len(v.dial_deg), REFERENCE_C)) for v in bench.visits)
