"""Count what standard errors cover if dwells share noise: `python -m tests.studies.correlated_poses [TABLE]`.

`errors` and `k` are the tables of `calrig/docs/validation/standard-errors.md`; `widening` gives the constants
of `calrig.calibration.correlated_errors`. Runs are drawn by numpy alone: white noise, a first-order
autoregression by its recursion, and one of 0.8 with as much white noise. For comparison: what ordinary least
squares states, by scipy's `linregress`, and k by Welch and Satterthwaite.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calrig.calibration.correlated_errors import EXPECTED_WIDENING
from calrig.calibration.line import fit_line
from calrig.calibration.uncertainty.budget import uncertainty
from calrig.calibration.uncertainty.coverage import coverage_factor
from calrig.model.result import Reference

Floats = NDArray[np.float64]

BIAS_DEG, SCALE, SCATTER_DEG = 0.42, 0.997, 0.03
UP_DEG = np.arange(-60.0, 61.0, 10.0)
FINE_DEG = np.arange(-60.0, 61.0, 5.0)
PLANS = {
    26: np.concatenate([UP_DEG, UP_DEG[::-1]]),
    52: np.tile(np.concatenate([UP_DEG, UP_DEG[::-1]]), 2),
    100: np.tile(np.concatenate([FINE_DEG, FINE_DEG[::-1]]), 2),
}
"""Elevations by number of poses: the first half of the default plan, all of it, and four sweeps of 5°."""
NOISES = {"white": (0.0, 0.0), "AR 0.3": (0.3, 0.0), "AR 0.6": (0.6, 0.0), "AR 0.8 + white": (0.8, 0.5)}
"""Lag-1 correlation of an autoregression, and the share of white noise in the variance."""
NO_STAGE = Reference(1e-9, "common", "normal")


def noise_of(rng: np.random.Generator, runs: int, n_poses: int, rho: float, white: float) -> Floats:
    """(runs, n) noise of standard deviation 1."""
    drawn = rng.standard_normal((runs, n_poses))
    own = math.sqrt(1.0 - rho**2)
    for k in range(1, n_poses):
        drawn[:, k] = rho * drawn[:, k - 1] + own * drawn[:, k]
    return math.sqrt(1.0 - white) * drawn + math.sqrt(white) * rng.standard_normal((runs, n_poses))


@dataclass(frozen=True)
class Covered:
    """Shares of runs within two standard errors, of a later reading within U; widths over least squares'."""

    bias_before: float
    scale_before: float
    bias: float
    scale: float
    elevation: float
    bias_width: float
    scale_width: float


def covered(n_poses: int, noise: str, runs: int, seed: int = 0) -> Covered:
    """Count what is covered; widths are medians over the runs."""
    theta_deg = PLANS[n_poses]
    rng = np.random.default_rng([seed, n_poses, list(NOISES).index(noise)])
    errors_deg = SCATTER_DEG * noise_of(rng, runs, n_poses, *NOISES[noise])
    rows = []
    for error_deg in errors_deg:
        reading_deg = BIAS_DEG + SCALE * theta_deg + error_deg
        line, plain = fit_line(theta_deg, reading_deg), stats.linregress(theta_deg, reading_deg)
        at_deg = rng.uniform(-60.0, 60.0)
        later_deg = BIAS_DEG + SCALE * at_deg + SCATTER_DEG * rng.standard_normal()
        off_deg = (later_deg - line.bias_deg) / line.scale - at_deg
        off_bias, off_scale = abs(line.bias_deg - BIAS_DEG), abs(line.scale - SCALE)
        rows.append(
            (
                off_bias <= 2.0 * plain.intercept_stderr,
                off_scale <= 2.0 * plain.stderr,
                off_bias <= 2.0 * line.bias_std_deg,
                off_scale <= 2.0 * line.scale_std,
                abs(off_deg) <= uncertainty(line, theta_deg, NO_STAGE).expanded_deg,
                line.bias_std_deg / plain.intercept_stderr,
                line.scale_std / plain.stderr,
            )
        )
    table = np.array(rows, dtype=float)
    return Covered(*table[:, :5].mean(axis=0), *np.median(table[:, 5:], axis=0))


def covered_by_k(n_poses: int, of_stage: float, runs: int, seed: int = 0) -> tuple[float, float]:
    """Return the share of errors within U by k, and by that of Welch and Satterthwaite.

    Args:
        n_poses: of a line: the scatter has two degrees of freedom less.
        of_stage: standard uncertainty of a normal reference over the standard deviation of type A.
        runs: how many.
        seed: of the draws.
    """
    rng, freedom = np.random.default_rng([seed, n_poses]), n_poses - 2.0
    error = rng.standard_normal(runs) + of_stage * rng.standard_normal(runs)
    type_a = np.sqrt(rng.chisquare(freedom, runs) / freedom)
    combined = np.hypot(type_a, of_stage)
    k = np.array([coverage_factor(float(a), freedom, of_stage, "normal") for a in type_a])
    by_welch = stats.t.ppf(0.975, freedom * (combined / type_a) ** 4)
    within = [float(np.mean(np.abs(error) <= factor * combined)) for factor in (k, by_welch)]
    return within[0], within[1]


def widening(n_poses: int, runs: int, seed: int = 0) -> tuple[float, float, float]:
    """Return medians of scatter, bias' and scale's errors over least squares', in white noise up and down."""
    up = n_poses // 2
    theta_deg = 60.0 * np.concatenate([np.linspace(-1.0, 1.0, up), np.linspace(1.0, -1.0, n_poses - up)])
    rng = np.random.default_rng([seed, n_poses])
    rows = []
    for error_deg in rng.standard_normal((runs, n_poses)):
        line, plain = fit_line(theta_deg, theta_deg + error_deg), stats.linregress(theta_deg, error_deg)
        left_deg = error_deg - plain.intercept - plain.slope * theta_deg
        scatter_deg = math.sqrt(float(left_deg @ left_deg) / (n_poses - 2))
        rows.append(
            (
                line.residual_std_deg / scatter_deg,
                line.bias_std_deg / plain.intercept_stderr,
                line.scale_std / plain.stderr,
            )
        )
    scatter, bias, scale = np.median(rows, axis=0).tolist()
    return scatter, bias, scale


def _errors(runs: int) -> None:
    _say("| poses | noise | bias, least squares | scale | bias | scale | U | bias wider by | scale |")
    _say("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for n_poses in PLANS:
        for noise in NOISES:
            c = covered(n_poses, noise, runs)
            shares = (c.bias_before, c.scale_before, c.bias, c.scale, c.elevation)
            widths = (c.bias_width - 1.0, c.scale_width - 1.0)
            cells = [f"{100 * one:.1f} %" for one in shares] + [f"{100 * one:.0f} %" for one in widths]
            _say(f"| {n_poses} | {noise} | {' | '.join(cells)} |")


def _k(runs: int) -> None:
    stages = (0.3, 1.0, 3.0)
    _say(f"| poses | {' | '.join(f'stage {one:g} s: k | Welch' for one in stages)} |")
    _say(f"| --- {'| --- ' * 2 * len(stages)}|")
    for n_poses in (3, 4, 5, 8, 14, 26, 52, 100):
        cells = [f"{100 * one:.1f} %" for stage in stages for one in covered_by_k(n_poses, stage, runs)]
        _say(f"| {n_poses} | {' | '.join(cells)} |")


def _widening(runs: int) -> None:
    for n_poses, *_ in EXPECTED_WIDENING:
        _say(f"({n_poses}, {', '.join(f'{one:.3f}' for one in widening(n_poses, runs))}),")


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Print the table asked for, or `errors` and `k`."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.correlated_poses", description=__doc__)
    parser.add_argument("table", nargs="?", choices=("errors", "k", "widening"))
    parser.add_argument("--runs", type=int)
    given = parser.parse_args()
    if given.table in (None, "errors"):
        _errors(given.runs or 2000)
    if given.table in (None, "k"):
        _k(given.runs or 4000)
    if given.table == "widening":
        _widening(given.runs or 10_000)


if __name__ == "__main__":
    main()
