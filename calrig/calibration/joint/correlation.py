"""Noise that is correlated from pose to pose: a first-order autoregression within each mount of each run.

At a correlation of 0.3 or 0.6 the mean of poses that follow one another is worth half or a quarter of as many
that do not, and two standard errors that deny it hold in 86 or 70 % of cases in place of 95. The correlation
is found by restricted likelihood: that of residuals alone is too small where a model has many parameters
(Patterson & Thompson, Biometrika 58, 1971).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from calrig.calibration.joint.least_squares import Fit

LARGEST = 0.95
CLOSE = 5e-3
LEAST_SQUARES = 1e-300
"""Whose logarithm is still a number."""


def correlation_of(fit: Fit) -> float:
    """Lag-1 correlation of the poses' noise, none where nothing tells in which order they were measured.

    Args:
        fit: of all parameters, to poses taken as uncorrelated.
    """
    if not fit.problem.table.in_order:
        return 0.0
    found = minimize_scalar(
        lambda rho: _criterion(fit, float(rho)), bounds=(0.0, LARGEST), options={"xatol": CLOSE}
    )
    return float(found.x)


def _criterion(fit: Fit, rho: float) -> float:
    """−2 log of the restricted likelihood, the noise profiled out; linear about the fit."""
    problem = replace(fit.problem, correlation=rho)
    normal = problem.normal(fit.parameters, fit.weights)
    inverse = problem.inverse(normal.matrix + np.diag(fit.noise**2 * problem.widths() ** -2.0))
    squares = max(normal.squares - float(normal.gradient @ inverse.solve(normal.gradient)), LEAST_SQUARES)
    return fit.freedom * float(np.log(squares)) + normal.log_variance + inverse.log_determinant
