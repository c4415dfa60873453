"""Count false alarms of verifications, and faults found.

`python -m tests.studies.verifications [--runs N] [--seed S]` prints the table of
`calrig/docs/validation/verifications.md`. Runs are drawn by numpy alone: a line, a temperature coefficient,
and noise that is a first-order autoregression from pose to pose. `before` is the test of earlier versions, by
scipy: the sum of squares over the noise's variance against χ², without the calibration's uncertainty and as
if noise were white.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calrig.calibration.line import Line
from calrig.calibration.poses import Pose
from calrig.calibration.results import Promise, basis_of_poses, verify
from calrig.calibration.uncertainty import make_verdict

Floats = NDArray[np.float64]

NOISE_DEG, BIAS_DEG, SCALE, DEG_PER_C = 0.03, 0.42, 0.997, 0.012
UP_DEG = np.arange(-60.0, 61.0, 10.0)
FEW_DEG = np.linspace(-60.0, 60.0, 9)
COLDEST_C, WARMEST_C, WARM_C = 22.0, 34.0, 33.0
"""A calibration warms up within the first two; a verification at another temperature is at the last."""
COUNTS = ((52, 52), (18, 52), (52, 26), (26, 52))
"""Poses of the calibration and of the verification."""
WITH_FAULT = 50
"""Runs of each cell that are verified with a fault too: nearly all find it."""
CORRELATIONS = (0.0, 0.3, 0.6)


def elevations_deg(n: int) -> Floats:
    """(n,) sweeps up and down."""
    up = FEW_DEG if n == 18 else UP_DEG
    return np.resize(np.concatenate([up, up[::-1]]), n)


def noise_deg(rng: np.random.Generator, n: int, rho: float) -> Floats:
    """(n,) of one standard deviation throughout."""
    drawn = rng.standard_normal(n)
    for k in range(1, n):
        drawn[k] = rho * drawn[k - 1] + np.sqrt(1.0 - rho**2) * drawn[k]
    return NOISE_DEG * drawn


@dataclass(frozen=True)
class Counted:
    """Runs called more than noise: by noise alone, by the test of before, with a fault."""

    alarms: int
    alarms_before: int
    found: int


def counted(
    calibrated: int, n: int, rho: float, *, warm: bool, runs: int, fault_sd: float = 3.0, seed: int = 0
) -> Counted:
    """Count verdicts.

    Args:
        calibrated: poses that bias, scale and, with `warm`, a temperature coefficient are fitted to.
        n: poses of the verification.
        rho: correlation of the noise from pose to pose.
        warm: whether the calibration warms up and the verification is at its warm end.
        runs: how many; the first `WITH_FAULT` are verified with the fault as well.
        fault_sd: amplitude of one sine over the range, added to the verification's readings, in standard
            deviations of the noise.
        seed: of the draws.
    """
    rng = np.random.default_rng([seed, calibrated, n, round(10 * rho), warm])
    theta, at = elevations_deg(calibrated), elevations_deg(n)
    before_c = COLDEST_C + (WARMEST_C - COLDEST_C) * np.linspace(0.0, 1.0, calibrated) ** 0.5
    now_c = np.full(n, WARM_C)
    columns = [np.ones(calibrated), theta, *([before_c - 28.0] if warm else [])]
    design = np.column_stack(columns)
    fresh_design = np.column_stack([np.ones(n), at, *([now_c - 28.0] if warm else [])])
    truth = np.array([BIAS_DEG, SCALE, *([DEG_PER_C] if warm else [])])
    fault_deg = fault_sd * NOISE_DEG * np.sin(np.pi * at / 60.0)
    counts = np.zeros(3, dtype=int)
    for k in range(runs):
        reading = design @ truth + noise_deg(rng, calibrated, rho)
        found = np.linalg.lstsq(design, reading, rcond=None)[0]
        line = Line(found[0], found[1], None, None, None, None)
        effects = [("temperature_bias", {"deg_per_c": found[2], "reference_c": 28.0})] if warm else []
        given = _poses(theta, reading, before_c)
        promise = Promise(
            (-60.0, 60.0), (COLDEST_C, WARMEST_C), basis_of_poses([given], line, effects, NOISE_DEG)
        )
        clean = fresh_design @ truth + noise_deg(rng, n, rho)
        left = clean - fresh_design @ found
        is_fault = [
            make_verdict(
                verify(_poses(at, one, now_c), None, line, effects, None, promise), verification=True
            ).left
            == "more_than_noise"
            for one in ((clean, clean + fault_deg) if k < WITH_FAULT else (clean,))
        ]
        was = float(left @ left) / NOISE_DEG**2 > stats.chi2.isf(0.01, n)
        counts += [is_fault[0], was, is_fault[-1] and k < WITH_FAULT]
    return Counted(*counts.tolist())


def _poses(theta: Floats, reading: Floats, temperature_c: Floats) -> list[Pose]:
    return [
        Pose(target_deg=a, reading_deg=b, temperature_c=c, reading_stderr_deg=NOISE_DEG)
        for a, b, c in zip(theta.tolist(), reading.tolist(), temperature_c.tolist(), strict=True)
    ]


def main() -> None:
    """Print the table of `calrig/docs/validation/verifications.md`."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.verifications", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    runs = asked.runs
    say = sys.stdout.write
    say("| calibrated → verified | temperature | noise | before | now | 95 % interval | fault found |\n")
    say("| --- | --- | --- | --- | --- | --- | --- |\n")
    for calibrated, n in COUNTS:
        for warm in (False, True):
            for rho in CORRELATIONS:
                one = counted(calibrated, n, rho, warm=warm, runs=runs, seed=asked.seed)
                where = "another" if warm else "the same"
                alarms = (
                    f"{one.alarms_before} of {runs} | {one.alarms} of {runs} | {interval(one.alarms, runs)}"
                )
                found = f"{one.found} of {min(runs, WITH_FAULT)}"
                say(f"| {calibrated} → {n} | {where} | AR {rho:g} | {alarms} | {found} |\n")
                sys.stdout.flush()


def interval(count: int, runs: int) -> str:
    """The exact 95 % interval of a share (Clopper & Pearson, Biometrika 26, 1934)."""
    low, high = stats.binomtest(count, runs).proportion_ci(method="exact")
    return f"{100 * low:.1f} to {100 * high:.1f} %"


if __name__ == "__main__":
    main()
