"""Find an angle of the dial where |a| is off in neighbouring poses, as by a vibration of the stage.

Vibration moves the mean of an accelerometer. The stage's map turns a vector and never changes its length, so
residuals along the vector show it whatever the map is. Windows over the dial are tested by the mean of each
mount's residuals there, with Bonferroni's bound over all windows.
"""

from __future__ import annotations

import numpy as np

from calrig.calibration.separation.least_squares import Fit
from calrig.estimation.angles import wrap_deg

WINDOW_DEG, STEP_DEG = 10.0, 2.5
LEVEL = 1e-3
"""Chance that noise alone has any window told of."""
FEWEST_POSES = 3
"""Of a mount in a window: fewer are outliers, if anything."""


def vibrating_at_deg(fit: Fit) -> float | None:
    """Return the middle of the window that is most improbable; None where noise explains all of them."""
    from scipy.special import chdtrc

    table = fit.problem.table
    if table.is_whole or not table.has_vector.all():
        return None
    upward = table.vector_g[:, 1:] / table.size_g[:, None]
    along = np.einsum("nk,nk->n", fit.normal.residuals, upward) / fit.noise
    rho = fit.problem.correlation
    wider = (1.0 + rho) / (1.0 - rho)
    low, high = table.dial_deg.min(), table.dial_deg.max()
    middles = np.arange(low, high + STEP_DEG, STEP_DEG)
    p_values = []
    for middle in middles:
        inside = fit.kept & (np.abs(wrap_deg(table.dial_deg - middle)) < 0.5 * WINDOW_DEG)
        poses = np.bincount(table.mount[inside], minlength=len(table.mounts))
        sums = np.bincount(table.mount[inside], along[inside], minlength=len(table.mounts))
        told = poses >= FEWEST_POSES
        squares = float((sums[told] ** 2 / poses[told]).sum()) / wider
        p_values.append(float(chdtrc(float(told.sum()), squares)) if told.any() else 1.0)
    best = int(np.argmin(p_values))
    return float(middles[best]) if len(middles) * p_values[best] < LEVEL else None
