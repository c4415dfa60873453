"""Noise that the responses share, its correlation from pose to pose, and a fit that allows for both.

Noise that is correlated from pose to pose breaks a gate that does not know of it, and noise that witnesses
share with the reading breaks one that treats each channel alone. Both are undone by one rotation: with Σ the
residuals' covariance and Γ their symmetrised lag-1 covariance, the generalised eigenvectors of Γv = ρΣv give
channels that are uncorrelated with each other, now and one pose later, each a first-order autoregression of
its own ρ (Tong, Liu, Soon & Huang, "Indeterminacy and identifiability of blind identification", IEEE Trans.
CAS 38, 1991; Switzer & Green's maximum autocorrelation factors, 1984). One factor common to all channels and
channels of one common ρ are both special cases.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from calrig.calibration.responses import BoolArray, Responses
from calrig.estimation.angles import FloatArray

ITERATIONS = 4
LARGEST_RHO = 0.95
SMALLEST_RHO = -0.5
ALIKE = 1e-12
"""Added to each channel's own variance, so that two channels of one noise stay distinguishable."""
PRIOR_RHO_STD = 0.2
"""Correlation that a model has to invoke counts against it by (ρ/0.2)²: noise is more often white."""

Real = TypeVar("Real", npt.NDArray[np.float64], npt.NDArray[np.float32])


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Residuals e (n, J): e·rotation is J independent autoregressions of unit variance, correlation rho."""

    rotation: FloatArray
    rho: FloatArray

    def whiten(self, x: FloatArray, starts: BoolArray, share: float = 1.0) -> FloatArray:
        """Innovations of x (…, n, J) in the rotated channels, with `share` of rho undone."""
        return np.moveaxis(self.innovations(self.rotated(x), starts, share), 0, -1)

    def floor(self, rounding: FloatArray) -> FloatArray:
        """(J,) variance in each rotated channel of errors of rounding (J,) in the responses.

        Residuals of exact readings are what rounding left of them, in an order that the processor's own
        kernels decide. A sum of n products is right to n·eps times their size (Higham, Accuracy and
        Stability of Numerical Algorithms, 2002, section 3.1); no variance counts as smaller, under the null
        or an alternative. Noise that was measured is ten orders of magnitude larger.
        """
        return np.asarray(rounding**2 @ self.rotation**2, dtype=np.float64)

    def rotated(self, x: FloatArray) -> FloatArray:
        """(J, …, n) independent channels of x (…, n, J), in memory one after the other."""
        flat = self.rotation.T @ x.reshape(-1, x.shape[-1]).T
        return np.asarray(flat.reshape(-1, *x.shape[:-1]), dtype=np.float64)

    def innovations(self, rotated: Real, starts: BoolArray, share: float = 1.0) -> Real:
        """Innovations (J, …, n) of rotated channels, with `share` of rho undone."""
        rho = (self.rho * share).astype(rotated.dtype).reshape(-1, *(1,) * (rotated.ndim - 1))
        gain = 1.0 / np.sqrt(1.0 - rho**2)
        white = rotated.copy()  # the first pose, and the first of each run, follow on nothing
        white[..., 1:] -= rho * rotated[..., :-1]
        white[..., 1:] *= gain
        white[..., starts] = rotated[..., starts]
        return white

    def colour(self, innovations: FloatArray, starts: BoolArray) -> FloatArray:
        """The residuals (…, n, J) whose innovations are given: the inverse of `whiten`."""
        rotated = innovations.copy()
        gain = np.sqrt(1.0 - self.rho**2)
        for k in range(1, rotated.shape[-2]):
            if not starts[k]:
                rotated[..., k, :] = self.rho * rotated[..., k - 1, :] + gain * innovations[..., k, :]
        coloured: FloatArray = rotated @ np.linalg.inv(self.rotation)
        return coloured


@dataclass(frozen=True, slots=True)
class Fit:
    """Generalised least squares of the responses on p columns.

    Attributes:
        beta, covariance: (p,), (p, p).
        residuals: (n, J).
        noise: the noise model it settled on.
        criterion: −2 log likelihood, plus what the correlation invoked counts against it.
    """

    beta: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    noise: NoiseModel
    criterion: float


def fit(r: Responses, columns: FloatArray) -> Fit:
    """Fits coefficients and noise in turn until they agree.

    Args:
        r: the responses.
        columns: (n, J, p).
    """
    _, _, p = columns.shape
    spread = np.hypot(r.values.std(axis=0), r.rounding)
    noise = NoiseModel(np.diag(1.0 / spread), np.zeros(len(spread)))
    taken = max(1.0, p / len(spread))
    for _ in range(ITERATIONS):
        design = stacked(noise, r.starts, columns)
        target = noise.whiten(r.values, r.starts).ravel()
        gram = design.T @ design
        size = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
        inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(
            size, size
        )
        beta = inverse @ (design.T @ target)
        residuals = (r.values - columns @ beta) * r.known
        noise = noise_of(residuals, r, taken)
    innovations = noise.whiten(residuals, r.starts)
    return Fit(beta, inverse, residuals, noise, _criterion(innovations, noise, r))


def stacked(noise: NoiseModel, starts: BoolArray, columns: FloatArray, share: float = 1.0) -> FloatArray:
    """Whitened columns (n, J, p) as one matrix (n·J, p)."""
    white = noise.whiten(np.moveaxis(columns, 2, 0), starts, share)
    return white.reshape(len(white), -1).T


def noise_of(residuals: FloatArray, r: Responses, parameters: float, *, unbiased: bool = False) -> NoiseModel:
    """The noise model of residuals.

    Args:
        residuals: (n, J) of a fit.
        r: the responses; where their runs start, and what rounding leaves of them.
        parameters: how many the fit took per channel.
        unbiased: add what fitting takes off the correlation, about (1 + p + 4ρ)/n (Kendall, 1954), as a
            bootstrap that is to behave like the noise needs it.
    """
    n = len(residuals)
    covariance = residuals.T @ residuals / max(n - parameters, 1.0)
    floor = ALIKE * np.diag(covariance) + r.rounding**2
    root = np.linalg.inv(np.linalg.cholesky(covariance + np.diag(floor))).T
    white = residuals @ root
    follows = ~r.starts[1:]
    lagged = white[1:][follows].T @ white[:-1][follows] / max(int(follows.sum()) - parameters, 1.0)
    rho, turn = np.linalg.eigh((lagged + lagged.T) / 2.0)
    if unbiased:
        rho = rho + 0.75 * (1.0 + parameters + 4.0 * np.maximum(rho, 0.0)) / n
    return NoiseModel(root @ turn, np.clip(rho, SMALLEST_RHO, LARGEST_RHO))


def _criterion(innovations: FloatArray, noise: NoiseModel, r: Responses) -> float:
    n = len(r)
    variance = (innovations**2).mean(axis=0) + noise.floor(r.rounding)
    following = int((~r.starts).sum())
    minus_2_log_likelihood = (
        n * np.log(variance).sum()
        + following * np.log(1.0 - noise.rho**2).sum()
        - 2.0 * n * np.linalg.slogdet(noise.rotation)[1]
    )
    return float(minus_2_log_likelihood + np.sum((noise.rho / PRIOR_RHO_STD) ** 2))
