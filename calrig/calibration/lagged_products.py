"""Sums of products of residuals, pose with itself and with the next: all that a noise model needs to know.

Innovations (e_t − ρ·e_{t−1})/√(1 − ρ²) of a rotated channel have the power A + (ρ²·Q − ρ·H)/(1 − ρ²), with A
the sum of e_t², H that of 2·e_t·e_{t−1} and Q that of e_t² + e_{t−1}² over the poses that follow on another.
So of n poses a J × J matrix of each is left, whatever the rotation and the correlations are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.channels import BoolArray
from calrig.estimation.angles import FloatArray

LARGEST_RHO = 0.95
SMALLEST_RHO = -0.5
ALIKE = 1e-12
"""Added to each channel's own variance, so that two channels of one noise stay distinguishable."""
PRIOR_RHO_STD = 0.2
"""Correlation that a model has to invoke counts against it by (ρ/0.2)²: noise is more often white."""


@dataclass(frozen=True, slots=True)
class LaggedProducts:
    """Of b sets of residuals e (b, n, J).

    Attributes:
        same: (b, J, J) sums of e_t·e_tᵀ.
        lagged: (b, J, J) sums of e_t·e_{t−1}ᵀ and its transpose, over the poses that follow on another.
        inner: (b, J, J) sums of e_t·e_tᵀ + e_{t−1}·e_{t−1}ᵀ over the same.
        n, pairs: how many poses, and how many that follow on another.
        floor: (J,) variance of rounding in each channel: no variance counts as smaller.
    """

    same: FloatArray
    lagged: FloatArray
    inner: FloatArray
    n: int
    pairs: int
    floor: FloatArray

    def noises(self, parameters: float) -> tuple[FloatArray, FloatArray]:
        """(b, J, J) rotations and (b, J) correlations of residuals of a fit that took so many per channel."""
        from scipy.linalg.lapack import dsygvd

        covariance = self.same / max(self.n - parameters, 1.0)
        diagonal = np.einsum("bjj->bj", covariance)
        diagonal += ALIKE * diagonal + self.floor
        if len(covariance) == 1:  # one call in place of three, whose own cost is all there is
            one, turned, failed = dsygvd(self.lagged[0], covariance[0])
            if failed:
                raise np.linalg.LinAlgError("residuals whose covariance is not positive definite")
            rho, rotation = one[None], turned[None]
        else:
            inverse = np.linalg.inv(np.linalg.cholesky(covariance))
            root = np.swapaxes(inverse, 1, 2)
            rho, turn = np.linalg.eigh(inverse @ self.lagged @ root)
            rotation = root @ turn
        rho = rho * (0.5 / max(self.pairs - parameters, 1.0))
        return rotation, np.minimum(np.maximum(rho, SMALLEST_RHO), LARGEST_RHO)

    def criterion(self, rotation: FloatArray, rho: FloatArray) -> FloatArray:
        """(b,) −2 log likelihood, variances profiled, plus what the correlation counts against a model."""
        white = 1.0 - rho**2
        same, lagged, inner = (
            ((products @ rotation) * rotation).sum(axis=1)
            for products in (self.same, self.lagged, self.inner)
        )
        variance = (same + (rho**2 * inner - rho * lagged) / white) / self.n + self.floor @ rotation**2
        return np.asarray(
            self.n * np.log(variance).sum(axis=1)
            + self.pairs * np.log(white).sum(axis=1)
            - 2.0 * self.n * np.linalg.slogdet(rotation)[1]
            + ((rho / PRIOR_RHO_STD) ** 2).sum(axis=1),
            dtype=np.float64,
        )


def lagged_products(residuals: FloatArray, starts: BoolArray, rounding: FloatArray) -> LaggedProducts:
    """Those of residuals (b, n, J), which begin anew at `starts` (n,), with errors of rounding (J,)."""
    n = len(starts)
    later, earlier, ends = residuals[:, 1:], residuals[:, :-1], residuals[:, :: max(n - 1, 1)]
    if starts[1:].any():
        follows, anew = np.flatnonzero(~starts[1:]), np.flatnonzero(starts[1:])
        later, earlier = residuals[:, follows + 1], residuals[:, follows]
        ends = residuals[:, np.concatenate([[0], anew + 1, anew, [n - 1]])]
    same = np.swapaxes(residuals, 1, 2) @ residuals
    lagged = np.swapaxes(later, 1, 2) @ earlier
    lagged = lagged + np.swapaxes(lagged, 1, 2)
    inner = 2.0 * same - np.swapaxes(ends, 1, 2) @ ends
    return LaggedProducts(same, lagged, inner, n, later.shape[1], rounding**2)
