"""What poses can tell at best: the Cramér-Rao bound of the joint model, for poses taken or only thought of.

The least squares solution reaches it where the noise is normal (Kay, Fundamentals of Statistical Signal
Processing: Estimation Theory, 1993, section 3.9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.joint.elevation import Worth, worth
from calrig.calibration.joint.least_squares import Fit, at_parameters
from calrig.calibration.joint.problem import Problem
from calrig.calibration.joint.table import Intp, Mount
from calrig.estimation.angles import FloatArray


def mounted_otherwise(
    fit: Fit, unit: int, rows: Intp, mounts_deg: Sequence[float], dial_deg: FloatArray | None = None
) -> Worth:
    """What one unit's elevation would be worth, clamped at other angles.

    Args:
        fit: says how large noise, map and the unit's errors are.
        unit: by index.
        rows: poses whose dial angles each mount is taken to.
        mounts_deg: angles of the clampings.
        dial_deg: of these poses, in place of their own.
    """
    problem, n = fit.problem, len(mounts_deg)
    poses = problem.table.rows(np.tile(rows, n))
    table = replace(
        poses,
        dial_deg=poses.dial_deg if dial_deg is None else np.tile(dial_deg, n),
        units=(problem.table.units[unit],),
        mounts=tuple(Mount(f"{angle:g}°", 0, angle) for angle in mounts_deg),
        mount=np.repeat(np.arange(n), len(rows)),
        warmer_c=np.zeros(n * len(rows)),
        reference_c=np.full(1, np.nan),
    )
    thought_of = Problem(table, problem.orders, problem.linear, problem.correlation)
    parameters = np.concatenate(
        [fit.parameters[problem.unit_at(unit)], np.radians(mounts_deg), fit.parameters[problem.map_at]]
    )
    return worth(at_parameters(thought_of, parameters, fit.noise), 0)
