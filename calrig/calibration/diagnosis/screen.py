"""The screen: the likelihood ratio of every candidate against one model, at once and for many bootstraps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import Candidate
from calrig.calibration.regression.noise_model import PRIOR_RHO_STD, NoiseModel, Real, orthonormal
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

SHARES = (0.0, 0.5, 1.0)
"""Of the correlation found under the null: an alternative may explain as much of it as it can."""
SMALLEST = 1e-6
BATCH, BLOCK = 100, 2**16
"""Bootstraps at a time, and numbers of candidates: what belongs to them stays in the processor's cache."""
Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Base:
    """The model at one share of the null's correlation: `columns` (J, n, q) orthonormal over all channels.

    Attributes:
        share: of the correlation.
        columns: whitened.
        unwhitened: (J, n, q) what columns that are not whitened are multiplied by for their products with it.
        products: (J, q, q) within each channel.
        cost: of the correlation, in −2 log likelihood.
    """

    share: float
    columns: FloatArray
    unwhitened: FloatArray
    products: FloatArray
    cost: float


@dataclass(frozen=True, slots=True)
class _Beside:
    """Candidates of one number of columns p, at one share of the null's correlation.

    `columns` (J, p, C, n), once whitened, are orthonormal over all channels beside the model when what of
    them lies in its base is taken off: `inside` (q, p·C) are the base's products with them over all channels.
    Of what is then left `products` (J, C, p, p) are those within each channel.
    """

    columns: Float32Array
    inside: Float32Array
    products: Float32Array


class _Values(NamedTuple):
    """b sets of responses at one share, nothing of the base left in them.

    `unwhitened` (J, b, n) is what columns that are not whitened are multiplied by for their products with the
    whitened responses. With the base's products with these within each channel (J, b, q), their sums of
    squares (J, b) with what rounding may add, and −2 log likelihood (b,).
    """

    unwhitened: npt.NDArray[np.floating[Any]]
    of_base: npt.NDArray[np.floating[Any]]
    power: npt.NDArray[np.floating[Any]]
    null: FloatArray


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
        self._floor = (len(r) * noise.floor(r.rounding)[:, None]).astype(np.float32)
        rotated = noise.rotated(np.moveaxis(model, 2, 0))
        self._bases = [self._base(share, rotated) for share in SHARES]
        self._by_width: dict[int, list[int]] = {}
        for index, candidate in enumerate(candidates):
            self._by_width.setdefault(candidate.columns.shape[2], []).append(index)
        self._candidates = candidates
        self._as_given = np.argsort(np.concatenate(list(self._by_width.values())))
        self._made: list[list[_Beside]] = []

    def _base(self, share: float, model: FloatArray) -> _Base:
        """Of the rotated model (J, p, n)."""
        starts, noise = self._r.starts, self._noise
        white = noise.innovations(model, starts, share)
        design = white.transpose(0, 2, 1).reshape(-1, model.shape[1])
        base, _ = np.linalg.qr(design[:, design.any(axis=0)])  # of a fold, a first pose may not be in it
        rho = noise.rho * share
        following = int((~starts[1:]).sum())
        cost = following * np.log(1.0 - rho**2).sum() + ((rho / PRIOR_RHO_STD) ** 2).sum()
        columns = base.reshape(len(model), -1, base.shape[1])
        across = np.swapaxes(columns, 1, 2)
        unwhitened = np.swapaxes(noise.unwhitened(across, starts, share), 1, 2)
        return _Base(share, columns, unwhitened, across @ columns, float(cost))

    def _stacks(self, width: int) -> Iterator[FloatArray]:
        """Return the candidates of one width, some at a time: their rotated columns (J, C, p, n)."""
        indices, at_once = self._by_width[width], max(1, BLOCK // (width * self._r.values.size))
        for first in range(0, len(indices), at_once):
            columns = np.stack([self._candidates[i].columns for i in indices[first : first + at_once]])
            yield self._noise.rotated(np.moveaxis(columns, 3, 1))

    def _turned(self, stack: FloatArray) -> list[_Turned]:
        """Return what makes candidates of rotated columns (J, C, p, n) orthonormal at each share."""
        channels, count, width, n = stack.shape
        along = stack.reshape(channels, -1, n) @ np.concatenate([base.unwhitened for base in self._bases], 2)
        ends = np.cumsum([base.columns.shape[2] for base in self._bases])[:-1]
        every = self._noise.gram_of_innovations(stack, self._r.starts, SHARES)
        return [
            _turned(whole, inside.reshape(channels, count, width, -1), base.products)
            for whole, inside, base in zip(every, np.split(along, ends, axis=2), self._bases, strict=True)
        ]

    def _beside(self, width: int) -> Iterator[list[_Beside]]:
        """Return the candidates of one width at each share, some at a time."""
        for stack in self._stacks(width):
            yield [_beside(stack, turned) for turned in self._turned(stack)]

    def once(self, residuals: FloatArray) -> Float32Array:
        """Return (C,) reductions of −2 log likelihood for residuals (n, J) of the model."""
        values = self._values(self._noise.rotated(residuals[None]))
        parts = [self._ratios_once(values, some) for width in self._by_width for some in self._stacks(width)]
        return np.asarray(np.concatenate(parts)[self._as_given], dtype=np.float32)

    def ratios(self, residuals: FloatArray) -> Float32Array:
        """Return (b, C) the same of b sets of residuals (b, n, J); what it makes for that serves the next."""
        if not self._made:
            self._made = [some for width in self._by_width for some in self._beside(width)]
        parts = []
        for first in range(0, len(residuals), BATCH):
            rotated = self._noise.rotated(residuals[first : first + BATCH])
            values = self._values(rotated.astype(np.float32))
            parts.append(np.concatenate([self._ratios(values, some) for some in self._made], axis=1))
        return np.concatenate(parts)[:, self._as_given]

    def _ratios_once(self, values: Sequence[_Values], stack: FloatArray) -> Float32Array:
        """(C,) those of one set of residuals, for candidates whose rotated columns are (J, C, p, n)."""
        shares_left = [
            _share_left_once(own, stack, turned)
            for own, turned in zip(values, self._turned(stack), strict=True)
        ]
        (ratios,) = self._best_of_shares(values, [left[None] for left in shares_left])
        return np.asarray(ratios, dtype=np.float32)

    def _values(self, rotated: Real) -> list[_Values]:
        """Rotated residuals (J, b, n) at each share, and their likelihood without a candidate."""
        n, found = rotated.shape[2], []
        for base in self._bases:
            columns = base.columns.astype(rotated.dtype)
            white = self._noise.innovations(rotated, self._r.starts, base.share)
            white -= (white @ columns).sum(axis=0) @ np.swapaxes(columns, 1, 2)
            power = np.einsum("jbn,jbn->jb", white, white) + self._floor
            null = n * np.log(power.astype(np.float64)).sum(axis=0) + base.cost
            unwhitened = self._noise.unwhitened(white, self._r.starts, base.share)
            found.append(_Values(unwhitened, white @ columns, power, null))
        return found

    def _ratios(self, values: Sequence[_Values], candidates: Sequence[_Beside]) -> Float32Array:
        """Return (b, C) the best of all shares, against the best without the candidate."""
        shares_left = [_share_left(own, some) for own, some in zip(values, candidates, strict=True)]
        return self._best_of_shares(values, shares_left)

    def _best_of_shares(self, values: Sequence[_Values], shares_left: Sequence[Float32Array]) -> Float32Array:
        """Return (b, C) from what is left at each share (b, C)."""
        n, first = len(self._r), values[0].null
        least = np.minimum.reduce(
            [
                left * np.exp((own.null - first) / n).astype(np.float32)[:, None]
                for own, left in zip(values, shares_left, strict=True)
            ]
        )
        gain = (np.min([own.null for own in values], axis=0) - first).astype(np.float32)
        return np.asarray(gain[:, None] - np.float32(n) * np.log(least), dtype=np.float32)


class _Turned(NamedTuple):
    """What makes columns of candidates orthonormal beside a base.

    `across` (C, p, p) does, in rows; `inside` (q, p·C) and `products` (J, C, p, p) are as `_Beside` has them.
    """

    across: FloatArray
    inside: FloatArray
    products: FloatArray


def _turned(whole: FloatArray, inside: FloatArray, of_base: FloatArray) -> _Turned:
    """Of candidates beside a base, all whitened.

    Args:
        whole: (J, C, p, p) products of their columns within each channel.
        inside: (J, C, p, q) those with the base.
        of_base: (J, q, q) those of the base with itself.
    """
    every = inside.sum(axis=0)
    # (c − Q·s)ᵀ(c − Q·s) within a channel, with s the products of the base over all of them
    half = 0.5 * (every.reshape(-1, every.shape[2]) @ of_base).reshape(inside.shape) - inside
    taken = half @ np.swapaxes(every, 1, 2)
    left = whole + taken + np.swapaxes(taken, 2, 3)
    turn = orthonormal(left.sum(axis=0), np.sqrt(np.einsum("jckk->ck", whole)))
    across = np.swapaxes(turn, 1, 2)
    inward = np.swapaxes(across @ every, 0, 1).reshape(-1, every.shape[2]).T
    return _Turned(across, inward, across @ left @ turn)


def _beside(stack: FloatArray, turned: _Turned) -> _Beside:
    """Return candidates of rotated columns (J, C, p, n) as a base sees them."""
    across, inside, products = turned
    made = across * stack if stack.shape[2] == 1 else across @ stack
    columns = np.ascontiguousarray(np.swapaxes(made, 1, 2), dtype=np.float32)
    return _Beside(columns, inside.astype(np.float32), products.astype(np.float32))


def _share_left(values: _Values, candidates: _Beside) -> Float32Array:
    """Return (b, C) product over the channels of what a candidate leaves of the channel's sum of squares."""
    channels, width, count, n = candidates.columns.shape
    flat = candidates.columns.reshape(channels, -1, n)
    within = values.unwhitened @ np.swapaxes(flat, 1, 2)
    within -= values.of_base @ candidates.inside
    if channels == 1:  # the columns are orthonormal there, so that each takes its own square
        np.square(within, out=within)
        taken = within.reshape(-1, width, count).sum(axis=1)
        taken /= values.power[0][:, None]
        return np.asarray(np.maximum(1.0 - taken, SMALLEST), dtype=np.float32)
    total = within.sum(axis=0).reshape(-1, width, count)
    within *= 2.0
    within = within.reshape(channels, -1, width, count)
    left = np.ones_like(total[:, 0])
    for j in range(channels):
        change = np.float32(0.0)
        for k in range(width):
            own = candidates.products[j, :, k, k] * total[:, k]
            for m in range(k):
                own += 2.0 * candidates.products[j, :, k, m] * total[:, m]
            own -= within[j, :, k]
            own *= total[:, k]
            change = own if k == 0 else change + own
        change /= values.power[j][:, None]
        change += 1.0
        left *= np.maximum(change, np.float32(SMALLEST), out=change)
    return np.asarray(left, dtype=np.float32)


def _share_left_once(values: _Values, stack: FloatArray, turned: _Turned) -> Float32Array:
    """Return (C,) the same of one set of values, for candidates of rotated columns (J, C, p, n)."""
    channels, count, width, n = stack.shape
    across, inside, products = turned
    along = stack.reshape(channels, -1, n) @ values.unwhitened[:, 0, :, None]
    along = along.reshape(channels, count, width, 1)
    of_base = (values.of_base[:, 0] @ inside).reshape(channels, width, count)
    within = (across @ along)[..., 0] - np.swapaxes(of_base, 1, 2)
    total = within.sum(axis=0)
    change = (products @ total[:, :, None])[..., 0] - 2.0 * within
    change = (change * total).sum(axis=2) / values.power[:, :1]
    return np.asarray(np.maximum(1.0 + change, SMALLEST).prod(axis=0), dtype=np.float32)
