"""The screen: the likelihood ratio of every candidate against one model, at once and for many bootstraps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import Candidate
from calrig.calibration.regression.noise_model import PRIOR_RHO_STD, NoiseModel, orthonormal
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
    """The model at one share of the null's correlation: `columns` (J, n, q) orthonormal over all channels."""

    share: float
    columns: FloatArray
    cost: float


@dataclass(frozen=True, slots=True)
class _Beside:
    """Candidates of one number of columns p, at one share of the null's correlation.

    `columns` (J, p, C, n) are orthonormal over all channels beside the model once what of them lies in its
    base is taken off: `inside` (q, p·C) are the base's products with them over all channels. Of what is then
    left `products` (J, C, p, p) are those within each channel.
    """

    columns: Float32Array
    inside: Float32Array
    products: Float32Array


class _Values(NamedTuple):
    """b sets of whitened responses (J, b, n) at one share, nothing of the base left in them.

    With the base's products with them within each channel (J, b, q), their sums of squares (J, b) with what
    rounding may add, and −2 log likelihood (b,).
    """

    white: Float32Array
    of_base: Float32Array
    power: Float32Array
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
        return _Base(share, base.reshape(len(model), -1, base.shape[1]), float(cost))

    def _stacks(self, width: int) -> Iterator[FloatArray]:
        """Return the candidates of one width, some at a time: their rotated columns (J, C, p, n)."""
        indices, at_once = self._by_width[width], max(1, BLOCK // (width * self._r.values.size))
        for first in range(0, len(indices), at_once):
            columns = np.stack([self._candidates[i].columns for i in indices[first : first + at_once]])
            yield self._noise.rotated(np.moveaxis(columns, 3, 1))

    def _beside(self, width: int) -> Iterator[list[_Beside]]:
        """Return the candidates of one width at each share, some at a time."""
        for stack in self._stacks(width):
            yield [_beside(self._white(stack, base.share), base.columns) for base in self._bases]

    def _white(self, rotated: FloatArray, share: float) -> FloatArray:
        """Return innovations of rotated columns: themselves where none of the correlation is undone."""
        return rotated if share == 0.0 else self._noise.innovations(rotated, self._r.starts, share)

    def once(self, residuals: FloatArray) -> Float32Array:
        """Return (C,) reductions of −2 log likelihood for residuals (n, J) of the model."""
        values = self._values(residuals[None])
        parts = [self._ratios_once(values, some) for width in self._by_width for some in self._stacks(width)]
        return np.asarray(np.concatenate(parts)[self._as_given], dtype=np.float32)

    def ratios(self, residuals: FloatArray) -> Float32Array:
        """Return (b, C) the same of b sets of residuals (b, n, J); what it makes for that serves the next."""
        if not self._made:
            self._made = [
                [_joined(of_share) for of_share in zip(*self._beside(width), strict=True)]
                for width in self._by_width
            ]
        parts = []
        for first in range(0, len(residuals), BATCH):
            values = self._values(residuals[first : first + BATCH])
            parts.append(np.concatenate([self._ratios(values, some) for some in self._made], axis=1))
        return np.concatenate(parts)[:, self._as_given]

    def _ratios_once(self, values: Sequence[_Values], stack: FloatArray) -> Float32Array:
        """(C,) those of one set of residuals, for candidates whose rotated columns are (J, C, p, n)."""
        shares_left = [
            _share_left_once(own, self._white(stack, base.share), base.columns)
            for own, base in zip(values, self._bases, strict=True)
        ]
        (ratios,) = self._best_of_shares(values, [left[None] for left in shares_left])
        return np.asarray(ratios, dtype=np.float32)

    def _values(self, residuals: FloatArray) -> list[_Values]:
        """Residuals (b, n, J) at each share, and their likelihood without a candidate."""
        rotated, n = self._noise.rotated(residuals).astype(np.float32), residuals.shape[1]
        found = []
        for base in self._bases:
            columns = base.columns.astype(np.float32)
            white = self._noise.innovations(rotated, self._r.starts, base.share)
            white -= (white @ columns).sum(axis=0) @ np.swapaxes(columns, 1, 2)
            power = np.einsum("jbn,jbn->jb", white, white) + self._floor
            null = n * np.log(power.astype(np.float64)).sum(axis=0) + base.cost
            found.append(_Values(white, white @ columns, power, null))
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


def _turned(white: FloatArray, base: FloatArray) -> _Turned:
    """Of candidates (J, C, p, n) beside a base (J, n, q)."""
    channels, count, width, n = white.shape
    inside = (white.reshape(channels, -1, n) @ base).reshape(channels, count, width, -1)
    every = inside.sum(axis=0)
    whole = white @ np.swapaxes(white, 2, 3)
    # (c − Q·s)ᵀ(c − Q·s) within a channel, with s the products of the base over all of them
    crossed = inside @ np.swapaxes(every, 1, 2)
    of_base = every.reshape(-1, base.shape[2]) @ (np.swapaxes(base, 1, 2) @ base)
    left = whole - crossed - np.swapaxes(crossed, 2, 3)
    left += of_base.reshape(inside.shape) @ np.swapaxes(every, 1, 2)
    turn = orthonormal(left.sum(axis=0), np.sqrt(np.einsum("jckk->ck", whole)))
    across = np.swapaxes(turn, 1, 2)
    inward = np.swapaxes(across @ every, 0, 1).reshape(-1, base.shape[2]).T
    return _Turned(across, inward, across @ left @ turn)


def _beside(white: FloatArray, base: FloatArray) -> _Beside:
    """Return columns of candidates (J, C, p, n) beside a base (J, n, q)."""
    across, inside, products = _turned(white, base)
    turned = across * white if white.shape[2] == 1 else across @ white
    columns = np.ascontiguousarray(np.swapaxes(turned, 1, 2), dtype=np.float32)
    return _Beside(columns, inside.astype(np.float32), products.astype(np.float32))


def _joined(parts: Sequence[_Beside]) -> _Beside:
    """Candidates of one width, one after the other."""
    if len(parts) == 1:
        return parts[0]
    width = parts[0].columns.shape[1]
    by_column = [part.inside.reshape(len(part.inside), width, -1) for part in parts]
    return _Beside(
        np.concatenate([part.columns for part in parts], axis=2),
        np.concatenate(by_column, axis=2).reshape(len(parts[0].inside), -1),
        np.concatenate([part.products for part in parts], axis=1),
    )


def _share_left(values: _Values, candidates: _Beside) -> Float32Array:
    """Return (b, C) product over the channels of what a candidate leaves of the channel's sum of squares."""
    channels, width, count, n = candidates.columns.shape
    flat = candidates.columns.reshape(channels, -1, n)
    within = values.white @ np.swapaxes(flat, 1, 2)
    within -= values.of_base @ candidates.inside
    total = within.sum(axis=0).reshape(-1, width, count)
    within = within.reshape(channels, -1, width, count)
    left = np.ones_like(total[:, 0])
    for j in range(channels):
        change = np.zeros_like(left)
        for k in range(width):
            own = candidates.products[j, :, k, k] * total[:, k]
            for m in range(k):
                own += 2.0 * candidates.products[j, :, k, m] * total[:, m]
            own -= 2.0 * within[j, :, k]
            own *= total[:, k]
            change += own
        change /= values.power[j][:, None]
        change += 1.0
        left *= np.maximum(change, np.float32(SMALLEST), out=change)
    return np.asarray(left, dtype=np.float32)


def _share_left_once(values: _Values, white: FloatArray, base: FloatArray) -> Float32Array:
    """Return (C,) the same of one set of values, for candidates (J, C, p, n) beside a base (J, n, q)."""
    channels, count, width, n = white.shape
    across, inside, products = _turned(white, base)
    along = (white.reshape(channels, -1, n) @ values.white[:, 0, :, None]).reshape(channels, count, width, 1)
    of_base = (values.of_base[:, 0] @ inside).reshape(channels, width, count)
    within = (across @ along)[..., 0] - np.swapaxes(of_base, 1, 2)
    total = within.sum(axis=0)
    change = (products @ total[:, :, None])[..., 0] - 2.0 * within
    change = (change * total).sum(axis=2) / values.power[:, :1]
    return np.asarray(np.maximum(1.0 + change, SMALLEST).prod(axis=0), dtype=np.float32)
