"""Count how well effects accepted from runs at two temperatures give a unit's bias and predict a third run.

The poses are made by numpy from a known truth and share nothing with calrig. The module prints the counts
over 50 seeds (`python -m tests.studies.accepting`); a few seeds run among the tests.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from calrig.calibration.diagnosis import JointEffects, RunOfEffects, fit_together, held_out_growth
from calrig.calibration.poses import Pose
from calrig.calibration.results import EffectDoubt, build_result, corrected_residuals_deg
from calrig.store import Run, Store

BIAS_DEG, SCALE, DEG_PER_C, AT_C = 0.42, 1.002, 0.012, 25.0
OFFSET_G = (14e-3, -18e-3)
NOISE_DEG, NOISE_G = 0.01, 2e-4
ELEVATIONS_DEG = np.linspace(-60.0, 60.0, 13)
FIRST_C, SECOND_C, THIRD_C = (24.0, 29.0), (36.0, 41.0), (30.0, 35.0)
EFFECTS = [
    ("accelerometer_offset", {"y_mg": 0.0, "z_mg": 0.0}),
    ("temperature_bias", {"deg_per_c": 0.0, "reference_c": 26.0}),
]
"""As a diagnosis names them; the values are fitted."""
TRUE_BIAS_DEG = BIAS_DEG + DEG_PER_C * (26.0 - AT_C)


def measured(
    rng: np.random.Generator,
    ends_c: tuple[float, float],
    clamped_deg: float = 0.0,
    *,
    noise_deg: float = NOISE_DEG,
    sweeps: int = 4,
) -> list[Pose]:
    """Return 13 poses a sweep of a unit that warms up between two temperatures, clamped askew by an angle."""
    theta = np.concatenate([ELEVATIONS_DEG[:: (-1) ** k] for k in range(sweeps)])
    n = np.arange(len(theta))
    celsius = ends_c[0] + (ends_c[1] - ends_c[0]) * (1.0 - np.exp(-n / 20.0)) + 0.8 * np.sin(n / 5.0)
    at = np.radians(BIAS_DEG + clamped_deg + SCALE * theta + DEG_PER_C * (celsius - AT_C))
    y, z = np.sin(at) + OFFSET_G[0], np.cos(at) + OFFSET_G[1]
    reading = np.degrees(np.arctan2(y, z)) + noise_deg * rng.standard_normal(len(theta))
    y, z = (one + NOISE_G * rng.standard_normal(len(theta)) for one in (y, z))
    return [
        Pose(
            float(theta[k]),
            float(reading[k]),
            sweep=int(k) // len(ELEVATIONS_DEG),
            time_s=5.0 * float(k),
            temperature_c=float(celsius[k]),
            accel_y_g=float(y[k]),
            accel_z_g=float(z[k]),
        )
        for k in n
    ]


UNIT = "AS-1"
PARAMETERS = {
    "accelerometer_offset": {"y_mg": {"value": 13.9, "std": 0.1}, "z_mg": {"value": -17.8, "std": 0.2}},
    "temperature_bias": {
        "deg_per_c": {"value": 0.0115, "std": 0.001},
        "reference_c": {"value": 26.0, "std": None},
    },
}
"""As diagnoses state them."""


def diagnosed_run(store: Store, poses: list[Pose], *names: str) -> Run:
    """Store a completed calibration of `UNIT`, whose diagnosis names these effects."""
    run = store.runs.create(
        unit=UNIT,
        rig="bench-1",
        plan=None,
        status="completed",
        provenance={},
        poses=poses,
        result=build_result(poses).to_dict(),
    )
    effects = [
        {
            "name": name,
            "verdict": "named",
            "origin": "sensor",
            "covariate": "target_deg" if name == "accelerometer_offset" else "temperature_c",
            "parameters": PARAMETERS[name],
            "changed": None,
            "confusable_with": [],
            "remedy": "",
        }
        for name in names
    ]
    return store.runs.update(run.id, diagnosis={"runs": [run.id], "effects": effects})


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a unit's documents say after run 1, and after run 2 was accepted as well.

    Attributes:
        in_stds: error of the bias after both, in standard errors.
        after_one_deg, after_both_deg: RMS error of a third run without noise, its mean taken off if the unit
            was remounted.
        refused: whether a run's error on held-out poses grows by too much.
    """

    in_stds: float
    after_one_deg: float
    after_both_deg: float
    refused: bool


def outcome(seed: int, clamping_std_deg: float = 0.0, sweeps: int = 4) -> Outcome:
    """Return what one seed gives."""
    rng = np.random.default_rng(seed)
    clamped_deg = clamping_std_deg * rng.standard_normal(3)
    first, second = (
        measured(rng, ends_c, float(at), sweeps=sweeps)
        for ends_c, at in zip((FIRST_C, SECOND_C), clamped_deg[:2], strict=True)
    )
    third = measured(rng, THIRD_C, float(clamped_deg[2]), noise_deg=0.0)
    runs = [RunOfEffects("1", first), RunOfEffects("2", second)]
    errors_deg, in_stds = [], 0.0
    for n in (1, 2):
        found = fit_together(runs[:n], EFFECTS)
        poses = runs[n - 1].poses
        result = build_result(poses, effects=found.applied, doubt=doubt_of(found))
        assert result.line_with_effects is not None
        left_deg = corrected_residuals_deg(third, result.line_with_effects, found.applied)
        if clamping_std_deg:
            left_deg = left_deg - left_deg.mean()
        errors_deg.append(float(np.sqrt((left_deg**2).mean())))
        line = result.line_with_effects
        assert line.bias_std_deg is not None
        in_stds = (line.bias_deg - TRUE_BIAS_DEG - float(clamped_deg[n - 1])) / line.bias_std_deg
    growths = held_out_growth(runs, EFFECTS, 1, EFFECTS)
    return Outcome(in_stds, *errors_deg, refused=any(one.is_too_large for one in growths))


def doubt_of(found: JointEffects) -> EffectDoubt:
    """How well fitted effects are known, as an acceptance stores it."""
    stds = [
        {name: one["std"] for name, one in parameters.items() if one is not None and one["std"] is not None}
        for _, parameters in found.effects
    ]
    return EffectDoubt(stds, found.run_offset_std_deg or 0.0, factors=found.factors)


def main() -> None:
    """Print the counts."""
    for clamping_std_deg, sweeps in ((0.0, 4), (0.03, 4), (0.0, 2)):
        found = [outcome(seed, clamping_std_deg, sweeps) for seed in range(50)]
        within = sum(abs(one.in_stds) <= 2.0 for one in found)
        after_one, after_both = (
            np.sqrt(np.mean(np.square(errors)))
            for errors in ([f.after_one_deg for f in found], [f.after_both_deg for f in found])
        )
        sys.stdout.write(
            f"clamping {clamping_std_deg:g}°, {13 * sweeps} poses: bias within two standard errors {within} "
            f"of 50; RMS error of a third run {after_one:.4f}° after one run, {after_both:.4f}° after both; "
            f"refused {sum(one.refused for one in found)}\n"
        )


if __name__ == "__main__":
    main()
