"""Search and gate for what bias and scale lack against gravity, pose after pose left out.

The statistic is the best of all candidates, its distribution a bootstrap under the current model for these
very poses, as in the diagnosis of poses on a stage (`gate`). Poses laid down by hand in any order make the
columns of an effect rough, so that correlation from pose to pose does not look like one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.gravity_model import (
    EFFECTS,
    MISALIGNMENT,
    GravityEffect,
    GravityFit,
    Problem,
    fit_gravity,
    linearised,
    undetermined_pairs,
)
from calrig.calibration.ranking import MARGIN
from calrig.estimation.angles import FloatArray

FREEDOM = 3
"""Degrees of freedom that must be left beside a candidate."""
WIDTH = 3
"""Parameters of every candidate: one for each axis or pair of axes."""
LEVEL = 0.01
BOOTSTRAPS_HELD_OUT = 499
LEAST_FREEDOM_OF_A_POSE = 0.05
SMALLEST = 1e-12
LEAST_SHARE = 1e-7
"""Of a column's size, beyond which it is its own: the root of what a number is rounded to, and more."""


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect the gate let through, its family-wise p-value, and the names as likely as its own."""

    effect: GravityEffect
    p_value: float
    rivals: tuple[str, ...]


def poses_needed(fitted: GravityFit) -> int:
    """How many poses it takes to look for one more effect."""
    return len(fitted.beta) + WIDTH + FREEDOM


def search(
    problem: Problem, base: GravityFit, rng: np.random.Generator, bootstraps: int
) -> tuple[GravityFit, tuple[FoundEffect, ...]]:
    """Adds effects to a fit of bias and scale one by one, until the gate lets nothing more through."""
    found: list[FoundEffect] = []
    fitted = base
    blind = undetermined_pairs(problem, base)
    offered = [e for e in EFFECTS if e.name in problem.columns and (e.name != MISALIGNMENT or not blind)]
    while offered and len(problem) >= poses_needed(fitted):
        ratios, p_value = _gate(problem, fitted, offered, rng, bootstraps)
        if p_value > LEVEL:
            break
        best = offered[int(np.argmax(ratios))]
        rivals = [
            effect.name
            for effect, ratio in zip(offered, ratios, strict=True)
            if effect is not best and ratios.max() - ratio < MARGIN
        ]
        found.append(FoundEffect(best, p_value, tuple(rivals)))
        offered.remove(best)
        fitted = fit_gravity(problem, [f.effect for f in found])
    return fitted, tuple(found)


def _gate(
    problem: Problem,
    fitted: GravityFit,
    candidates: Sequence[GravityEffect],
    rng: np.random.Generator,
    bootstraps: int,
) -> tuple[FloatArray, float]:
    """(C,) reductions of −2 log likelihood, and the p-value of their maximum in noise alone.

    Linear about the fit: residuals of a few mg leave terms of second order near 1e-5. The noise is drawn from
    the residuals, each freed of what the fit took from it (Davison & Hinkley, Bootstrap Methods and their
    Application, 1997, section 6.3), with random signs.
    """
    n, taken = len(problem), len(fitted.beta)
    basis, _ = np.linalg.qr(fitted.jacobian)
    leverage = (basis**2).sum(axis=1)
    noise = fitted.residual_g / np.sqrt(np.maximum(1.0 - leverage, LEAST_FREEDOM_OF_A_POSE))
    rounding_g = n * np.finfo(np.float64).eps * float(np.linalg.norm(problem.raw_g, axis=1).max())
    if np.sqrt((noise**2).mean()) < rounding_g:  # a log without noise: what is left is rounding
        noise = np.full(n, rounding_g)
    drawn = noise[rng.integers(0, n, (bootstraps, n))] * rng.choice([-1.0, 1.0], (bootstraps, n))
    values = np.vstack([fitted.residual_g, drawn])
    values = values - (values @ basis) @ basis.T
    power = (values**2).sum(axis=1) + n * rounding_g**2
    columns = problem.design([*fitted.effects, *candidates])
    _, seen = linearised(problem.raw_g, columns, fitted.beta)
    ratios = np.zeros((bootstraps + 1, len(candidates)))
    for k in range(len(candidates)):
        own = seen[:, taken + WIDTH * k : taken + WIDTH * (k + 1)]
        more = _beside(basis, own)
        left = power - ((values @ more) ** 2).sum(axis=1)
        ratios[:, k] = (n - taken - WIDTH) * np.log(power / np.maximum(left, SMALLEST * power))
    best = ratios.max(axis=1)
    return ratios[0], float((1 + (best[1:] >= best[0]).sum()) / (bootstraps + 1))


def _beside(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Orthonormal columns for what an orthonormal basis has not; what it has, but for rounding, is none."""
    left = columns - basis @ (basis.T @ columns)
    left = left - basis @ (basis.T @ left)  # once more: what the first subtraction left by rounding
    turned, values, _ = np.linalg.svd(left, full_matrices=False)
    return np.asarray(turned[:, values > LEAST_SHARE * np.linalg.norm(columns, 2)], dtype=np.float64)


def leave_one_out(problem: Problem, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """(n,) errors in g before and after: search and fit are repeated without each pose in turn."""
    n = len(problem)
    before, after = np.zeros(n), np.zeros(n)
    for k in range(n):
        one = np.arange(n) == k
        others = problem.rows(~one)
        base = fit_gravity(others)
        final, _ = search(others, base, rng, BOOTSTRAPS_HELD_OUT)
        before[one], after[one] = (problem.rows(one).errors_g(fitted) for fitted in (base, final))
    return before, after
