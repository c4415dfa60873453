"""The screen: the likelihood ratio of every candidate against one model, at once and for many bootstraps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.lagged_products import PRIOR_RHO_STD
from calrig.calibration.noise_model import NoiseModel, Real
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

SHARES = (0.0, 0.5, 1.0)
"""Of the correlation found under the null: an alternative may explain as much of it as it can."""
SMALLEST = 1e-6
BATCH = 250
"""Bootstraps at a time: what belongs to them then stays in the processor's cache."""
Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Level:
    """The candidates at one share of the null's correlation, by their number of columns.

    `base` (J, n, q) is orthonormal over all channels; the candidates' columns (J, p, C, n), orthonormal
    beside it, come with their products (J, C, p, p) within each channel.
    """

    share: float
    base: Float32Array
    bases: dict[int, tuple[Float32Array, Float32Array]]
    cost: float


class Screen:
    """The likelihood ratio of every candidate against one model, quick enough for a thousand bootstraps.

    At each share of the correlation and for each candidate the coefficients are those of generalised least
    squares, and the variance of each rotated channel is profiled: an effect that fills one channel is not
    diluted by the others.
    """

    def __init__(
        self, r: Responses, model: FloatArray, candidates: Sequence[Candidate], noise: NoiseModel
    ) -> None:
        self._r, self._noise = r, noise
        self._floor = len(r) * noise.floor(r.rounding)[:, None]
        by_width: dict[int, list[int]] = {}
        for index, candidate in enumerate(candidates):
            by_width.setdefault(candidate.columns.shape[2], []).append(index)
        stacks = {
            width: noise.rotated(np.moveaxis(np.stack([candidates[i].columns for i in indices]), 3, 0))
            for width, indices in by_width.items()
        }
        self._as_given = np.argsort(np.concatenate(list(by_width.values())))
        rotated = noise.rotated(np.moveaxis(model, 2, 0))
        self._levels = [self._level(share, rotated, stacks) for share in SHARES]

    def _level(self, share: float, model: FloatArray, stacks: dict[int, FloatArray]) -> _Level:
        """Takes the rotated model (J, p, n) and candidates (J, p, C, n)."""
        starts, noise = self._r.starts, self._noise
        white = noise.innovations(model, starts, share)
        design = white.transpose(0, 2, 1).reshape(-1, model.shape[1])
        base, _ = np.linalg.qr(design[:, design.any(axis=0)])  # of a fold, a first pose may not be in it
        base = base.reshape(len(model), -1, base.shape[1])
        bases = {
            width: _orthonormal(noise.innovations(stack, starts, share), base)
            for width, stack in stacks.items()
        }
        rho = noise.rho * share
        following = int((~starts).sum())
        cost = following * np.log(1.0 - rho**2).sum() + ((rho / PRIOR_RHO_STD) ** 2).sum()
        return _Level(share, base.astype(np.float32), bases, float(cost))

    def ratios(self, residuals: FloatArray) -> Float32Array:
        """(b, C) reductions of −2 log likelihood for b sets of residuals (b, n, J) of the model."""
        rotated = self._noise.rotated(residuals).astype(np.float32)
        parts = [self._ratios(rotated[:, k : k + BATCH]) for k in range(0, len(residuals), BATCH)]
        return np.concatenate(parts)[:, self._as_given]

    def _ratios(self, rotated: Float32Array) -> Float32Array:
        """The same of rotated channels (J, b, n), candidates ordered by width."""
        n = rotated.shape[2]
        least = np.full((rotated.shape[1], len(self._as_given)), np.inf, dtype=np.float32)
        null: list[FloatArray] = []
        for level in self._levels:
            white = _beside(level.base, self._noise.innovations(rotated, self._r.starts, level.share))
            power = np.einsum("jbn,jbn->jb", white, white) + self._floor.astype(np.float32)
            null.append(n * np.log(power.astype(np.float64)).sum(axis=0) + level.cost)
            against_first = np.exp((null[-1] - null[0]) / n).astype(np.float32)[:, None]
            lefts = [_share_left(white, power, *of_width) for of_width in level.bases.values()]
            np.minimum(least, np.concatenate(lefts, axis=1) * against_first, out=least)
        gain = (np.min(null, axis=0) - null[0]).astype(np.float32)
        return np.asarray(gain[:, None] - n * np.log(least), dtype=np.float32)


def _orthonormal(white: FloatArray, base: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Columns of candidates (J, p, C, n) made orthonormal beside a base (J, n, q), and their products."""
    width = white.shape[1]
    size_before = np.sqrt(np.einsum("jkcn,jkcn->kc", white, white)).max(axis=0)
    units = _beside(base, white.reshape(len(white), -1, white.shape[3])).reshape(white.shape)
    size = np.sqrt(np.einsum("jkcn,jkcn->kc", units, units))
    size = np.where(size > 1e-7 * size_before, size, np.inf)  # what the base has already, counts for nothing
    units /= size[:, :, None]
    if width > 1:
        values, vectors = np.linalg.eigh(_products(units).sum(axis=0))
        inverse = np.where(values > SMALLEST, 1.0 / np.sqrt(np.maximum(values, SMALLEST)), 0.0)
        turn = vectors * inverse[:, None, :]
        units = np.stack(
            [sum(units[:, m] * turn[:, m, k, None] for m in range(width)) for k in range(width)], axis=1
        )
    return units.astype(np.float32), _products(units).astype(np.float32)


def _beside(base: Real, columns: Real) -> Real:
    """Columns (J, c, n) less what lies in an orthonormal base (J, n, q) over all channels.

    A channel at a time: small products that the processor's cache holds.
    """
    inside = sum(of_channel @ base[j] for j, of_channel in enumerate(columns))
    left = columns.copy()
    for j in range(len(left)):
        left[j] -= inside @ base[j].T
    return left


def _products(units: FloatArray) -> FloatArray:
    """(J, C, p, p) inner products of columns (J, p, C, n) within each channel."""
    return np.stack([np.einsum("jkcn,jcn->jck", units, units[:, m]) for m in range(units.shape[1])], axis=3)


def _share_left(
    values: Float32Array, power: Float32Array, columns: Float32Array, products: Float32Array
) -> Float32Array:
    """(b, C) product over the channels of what a candidate leaves of the channel's sum of squares.

    Takes (J, b, n) whitened responses, (J, b) their sums of squares with what rounding may
    add, and what `_orthonormal` gives.
    """
    channels, width = columns.shape[:2]
    within = [[values[j] @ columns[j, k].T for k in range(width)] for j in range(channels)]
    total = [sum(within[j][k] for j in range(channels)) for k in range(width)]
    left = np.ones_like(within[0][0])
    for j in range(channels):
        change = np.zeros_like(left)
        for k in range(width):
            change += total[k] * (total[k] * products[j][:, k, k] - 2.0 * within[j][k])
            for m in range(k):
                change += 2.0 * total[k] * total[m] * products[j][:, k, m]
        left *= np.maximum(1.0 + change / power[j][:, None], np.float32(SMALLEST))
    return np.asarray(left, dtype=np.float32)
