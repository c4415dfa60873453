"""Whole units against their bound: what `python -m tests.studies.joint --three-axes` tries and prints."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from calrig.calibration.separation.gyro import dwells_of, turns_of, whole_gyro
from calrig.calibration.separation.least_squares import Fit
from calrig.calibration.separation.map_report import mapped
from calrig.calibration.separation.solution import Solution, solve
from calrig.calibration.separation.unit_results import accelerometer

from .cube import CubeBench, drawn_cube_bench
from .cube_oracle import DIAL_DEG, bound, figures_of, map_error_deg, sensor_figures

FIGURES = ("offset, mg", "scale, ppm", "angles between axes, mrad", "stage map, °")
ISSUE = (0.09, 480.0, 0.25, 0.015)
CASES = {"stated linear": False, "square and cube of each axis": True}


@dataclass(frozen=True)
class Judged:
    """One bench: squared errors of the figures, their bounds, and how many lay within two of their std."""

    squares: np.ndarray
    bounds: np.ndarray
    within: np.ndarray


def whole_solution(bench: CubeBench, seed: int, *, cubic: bool) -> Solution:
    """The solution of one draw of noise."""
    return solve(bench.measured(np.random.default_rng([seed, 1550])), linear=not cubic)


def judge(seed: int, *, cubic: bool) -> Judged:
    """One bench measured, solved, and held against its truth and its bound."""
    bench = drawn_cube_bench(seed, cubic=cubic)
    solution = whole_solution(bench, seed, cubic=cubic)
    error, std = _of_unit(bench, solution)
    on_map, map_std = _of_map(bench, solution)
    least = bound(bench, linear=not cubic)
    parts = (error[:3], error[3:6], error[6:9], on_map)
    within = np.concatenate([np.abs(error) < 2.0 * std, [np.mean(np.abs(on_map) < 2.0 * map_std)]])
    return Judged(
        np.array([np.mean(part**2) for part in parts]),
        np.array([least.bias_mg, least.scale_ppm, least.skew_mrad, least.map_deg]),
        np.array([within[:3].mean(), within[3:6].mean(), within[6:9].mean(), within[9]]),
    )


def table(judged_by: Callable[[bool], Iterable[Judged]]) -> str:
    """Bound against achieved, and how often two standard errors hold."""
    lines = [
        "| mounts x, y, z of 24 poses | seeds | aim | bound | achieved | ratio | coverage, k = 2 |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, cubic in CASES.items():
        judged = list(judged_by(cubic))
        achieved = np.sqrt(np.mean([one.squares for one in judged], axis=0))
        least = np.sqrt(np.mean([one.bounds**2 for one in judged], axis=0))
        within = np.mean([one.within for one in judged], axis=0)
        lines += [
            f"| {name}: {figure} | {len(judged)} | {stated:g} | {low:.3g} | {got:.3g} | {got / low:.2f} "
            f"| {share:.1%} |"
            for figure, stated, low, got, share in zip(FIGURES, ISSUE, least, achieved, within, strict=True)
        ]
    return "\n".join(lines) + "\n"


def _of_unit(bench: CubeBench, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """(9,) errors of offsets, scales and angles, and what is stated for them."""
    found = accelerometer(solution.fit, 0)
    assert found is not None
    values = np.concatenate([1e3 * found.bias_g, figures_of(found.matrix)])
    stds = np.concatenate([1e3 * found.stds[:3], figures_of(found.stds[3:].reshape(3, 3))])
    return values - sensor_figures(bench.unit), stds


def _of_map(bench: CubeBench, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the map (up to 72) over the dial where it is determined, and what is stated for them."""
    on_stage = mapped(solution)
    turn = on_stage.stage_deg
    error = np.interp(DIAL_DEG, turn, on_stage.error_deg)
    std = np.interp(DIAL_DEG, turn, on_stage.std_deg)
    off, known = error - map_error_deg(bench), np.isfinite(std)
    return (off - off[known].mean())[known], std[known]


FIVE_TURNS = (1, 1, 1, -1, -1)
"""At 60 °/s about each axis, after the poses of its mount. Play is in a turn that reverses the sense: one."""


def felt_turns(bench: CubeBench) -> np.ndarray:
    """(3,) as how much of a turn the gyro feels one about each mount's axis."""
    axes = [seat.rotation().apply([1.0, 0.0, 0.0]) for seat in bench.seats]
    return np.linalg.norm(bench.unit.gyro_response @ np.transpose(axes), axis=0)


def felt_turns_found(fit: Fit) -> np.ndarray:
    """(3,) the same by a solution of one unit."""
    turns = turns_of(fit, 0, dwells_of(fit, 0))
    assert turns is not None
    axes = [
        fit.problem.clamped(fit.parameters, mount)[:, 0] for mount in range(len(fit.problem.table.mounts))
    ]
    return np.linalg.norm(turns.response @ np.transpose(axes), axis=0)


@dataclass(frozen=True)
class JudgedGyro:
    """Squared errors, variances as stated, and how many lay within two standard errors."""

    squares: np.ndarray
    variances: np.ndarray
    within: np.ndarray


def judge_gyro(seed: int) -> JudgedGyro:
    """A gyro turned five times about each axis; the vertical part of Earth's rate is in the truth."""
    bench = drawn_cube_bench(seed, turns=FIVE_TURNS)
    fit = whole_solution(bench, seed, cubic=True).fit
    found = whole_gyro(fit, 0, accelerometer(fit, 0))
    assert found is not None and found.matrix is not None and found.dps_per_g is not None
    turn, response = bench.unit.to_sensor_frame(), bench.unit.gyro_response
    error = found.matrix - turn @ np.linalg.inv(response)
    per_g = bench.unit.gyro_dps_per_g + bench.earth_dps[2] * response
    of_g = found.dps_per_g - per_g @ turn.T
    along = felt_turns_found(fit) - felt_turns(bench)
    off = ~np.eye(3, dtype=bool)
    parts = [
        (along, np.full(3, np.nan)),
        (np.diag(error), np.diag(found.matrix_std)),
        (error[off], found.matrix_std[off]),
        (of_g.ravel(), found.dps_per_g_std.ravel()),
        (found.dwells.bias_dps - bench.unit.gyro_bias_dps, found.dwells.bias_std_dps),
    ]
    return JudgedGyro(
        np.array([np.mean(e**2) for e, _ in parts]),
        np.array([np.mean(s**2) for _, s in parts]),
        np.array([np.mean(np.abs(e) < 2.0 * s) for e, s in parts]),
    )


def gyro_table(judged: Iterable[JudgedGyro]) -> str:
    """What is achieved against what is stated."""
    judged = list(judged)
    names = (
        "a turn about a mount's axis, ppm",
        "matrix, its diagonal, ppm",
        "matrix, beside it, µrad",
        "per g, mdps/g",
        "bias, mdps",
    )
    units = np.array([1e6, 1e6, 1e6, 1e3, 1e3])
    got = units * np.sqrt(np.mean([one.squares for one in judged], axis=0))
    said = units * np.sqrt(np.mean([one.variances for one in judged], axis=0))
    within = np.mean([one.within for one in judged], axis=0)
    lines = [
        "| gyro, five turns at 60 °/s about each axis | seeds | achieved | stated | coverage, k = 2 |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {name} | {len(judged)} | {a:.3g} | " + ("| |" if np.isnan(b) else f"{b:.3g} | {w:.1%} |")
        for name, a, b, w in zip(names, got, said, within, strict=True)
    ]
    return "\n".join(lines) + "\n"
