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
STRONG_RHO = 0.75
"""Correlation beyond which coefficients and noise agree slowly; below it one step from the noise that the
responses were drawn from leaves the criterion where four would (quantiles of its gain alike to 0.5).
"""
RIDGE = 1e-9
"""Added to products of columns of unit size, so that two that say the same need no eigenvectors."""
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
    fitted = fits(r, r.values[None], columns[None])
    noise = NoiseModel(fitted.rotation[0], fitted.rho[0])
    return Fit(fitted.beta[0], fitted.covariance[0], fitted.residuals[0], noise, float(fitted.criterion[0]))


@dataclass(frozen=True, slots=True)
class Fits:
    """The same of b sets of responses, each with its own columns: (b, …) of what `Fit` and its noise have."""

    beta: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    rotation: FloatArray
    rho: FloatArray
    criterion: FloatArray


def fits(r: Responses, values: FloatArray, columns: FloatArray, start: NoiseModel | None = None) -> Fits:
    """Fits b sets of responses at once: a bootstrap judges its best candidates by their full likelihood.

    Args:
        r: the responses, for what their poses have in common.
        values: (b, n, J).
        columns: (b, n, J, p), or (1, n, J, p) where all have the same.
        start: noise that they were drawn from, to begin with; without it from white noise.
    """
    b, n, channels = values.shape
    columns = np.broadcast_to(columns, (b, *columns.shape[1:]))
    p = columns.shape[3]
    if start is None:
        spread = np.hypot(values.std(axis=1), r.rounding)
        rotation, rho = np.eye(channels) / spread[:, None, :], np.zeros((b, channels))
    else:
        rotation = np.broadcast_to(start.rotation, (b, channels, channels))
        rho = np.broadcast_to(start.rho, (b, channels))
    by_channel = np.ascontiguousarray(np.moveaxis(columns, 2, 1)).reshape(b, channels, n * p)
    taken = max(1.0, p / channels)
    for _ in range(1 if start is not None and start.rho.max() < STRONG_RHO else ITERATIONS):
        turned = (np.swapaxes(rotation, 1, 2) @ by_channel).reshape(b, channels, n, p)
        design = _innovations(turned, rho, r.starts).reshape(b, channels * n, p)
        target = _innovations(np.swapaxes(values @ rotation, 1, 2)[..., None], rho, r.starts)
        across = np.swapaxes(design, 1, 2)
        gram = across @ design
        power = np.einsum("bpp->bp", gram)
        size = np.sqrt(np.where(power > 0.0, power, 1.0))
        sizes = size[:, :, None] * size[:, None, :]
        covariance = _inverse(gram / sizes, exact=start is None) / sizes
        beta = (covariance @ (across @ target.reshape(b, channels * n, 1)))[..., 0]
        residuals = (values - (columns @ beta[:, None, :, None])[..., 0]) * r.known
        rotation, rho = _noises(residuals, r, taken)
    innovations = _innovations(np.swapaxes(residuals @ rotation, 1, 2)[..., None], rho, r.starts)
    variance = (innovations[..., 0] ** 2).mean(axis=2) + r.rounding**2 @ rotation**2
    criterion = (
        n * np.log(variance).sum(axis=1)
        + int((~r.starts).sum()) * np.log(1.0 - rho**2).sum(axis=1)
        - 2.0 * n * np.linalg.slogdet(rotation)[1]
        + ((rho / PRIOR_RHO_STD) ** 2).sum(axis=1)
    )
    return Fits(beta, covariance, residuals, rotation, rho, criterion)


def _inverse(gram: FloatArray, *, exact: bool) -> FloatArray:
    """Of (b, p, p) products of columns of unit size, some of which may say the same or nothing at all."""
    if exact:
        return np.asarray(np.linalg.pinv(gram, rcond=1e-10, hermitian=True), dtype=np.float64)
    return np.asarray(np.linalg.inv(gram + RIDGE * np.eye(gram.shape[1])), dtype=np.float64)


def _innovations(rotated: FloatArray, rho: FloatArray, starts: BoolArray) -> FloatArray:
    """Innovations (b, J, n, p) of rotated channels with correlations (b, J)."""
    gain = 1.0 / np.sqrt(1.0 - rho**2)
    white: FloatArray = rotated * gain[:, :, None, None]
    white[:, :, 1:] -= rotated[:, :, :-1] * (rho * gain)[:, :, None, None]
    white[:, :, starts] = rotated[:, :, starts]
    white[:, :, 0] = rotated[:, :, 0]
    return white


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
    (rotation,), (rho,) = _noises(residuals[None], r, parameters)
    if unbiased:
        rho = rho + 0.75 * (1.0 + parameters + 4.0 * np.maximum(rho, 0.0)) / len(residuals)
    return NoiseModel(rotation, np.clip(rho, SMALLEST_RHO, LARGEST_RHO))


def _noises(residuals: FloatArray, r: Responses, parameters: float) -> tuple[FloatArray, FloatArray]:
    """(b, J, J) rotations and (b, J) correlations of residuals (b, n, J)."""
    _, n, channels = residuals.shape
    across = np.swapaxes(residuals, 1, 2)
    covariance = across @ residuals / max(n - parameters, 1.0)
    floor = ALIKE * np.einsum("bjj->bj", covariance) + r.rounding**2
    covariance = covariance + np.eye(channels) * floor[:, None, :]
    root = np.swapaxes(np.linalg.inv(np.linalg.cholesky(covariance)), 1, 2)
    white = residuals @ root
    follows = np.flatnonzero(~r.starts[1:])
    lagged = np.swapaxes(white[:, follows + 1], 1, 2) @ white[:, follows]
    lagged /= max(len(follows) - parameters, 1.0)
    rho, turn = np.linalg.eigh((lagged + np.swapaxes(lagged, 1, 2)) / 2.0)
    return root @ turn, np.clip(rho, SMALLEST_RHO, LARGEST_RHO)
