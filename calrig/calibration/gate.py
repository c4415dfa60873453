"""The gate: is the best of everything searched better than noise alone would make it?

Searching a catalogue and keeping what lowers a criterion finds an effect in pure noise in 19–45 % of cases.
What holds its rate is the maximum over the whole search, bootstrapped under the current model for these very
poses, with the noise's correlation profiled under each alternative: frozen at its estimate under the null it
hides slow effects, for they look like correlation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.noise_model import PRIOR_RHO_STD, Fit, NoiseModel, noise_of, stacked
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

SHARES = (0.0, 0.4, 0.75, 1.0)
"""Of the correlation found under the null: an alternative may explain as much of it as it can."""
FAMILY_QUANTILES = {True: 0.98, False: 0.995}
"""Of a family's maximum under noise, where its bar lies: an effect that has a name is likelier beforehand
than a shape that has none, and four times as much of the error rate is spent on it.
"""
SMALLEST = 1e-6
Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Level:
    """The candidates at one share of the null's correlation, by their number of columns."""

    share: float
    base: FloatArray
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
        self._r, self._noise, self._count = r, noise, len(candidates)
        self._by_width: dict[int, list[int]] = {}
        for index, candidate in enumerate(candidates):
            self._by_width.setdefault(candidate.columns.shape[2], []).append(index)
        stacks = {
            width: np.stack([candidates[i].columns for i in indices])
            for width, indices in self._by_width.items()
        }
        self._levels = [self._level(share, model, stacks) for share in SHARES]

    def _level(self, share: float, model: FloatArray, stacks: dict[int, FloatArray]) -> _Level:
        r, noise = self._r, self._noise
        design = stacked(noise, r.starts, model, share)
        base, _ = np.linalg.qr(design[:, design.any(axis=0)])  # of a fold, a first pose may not be in it
        bases = {width: _orthonormal(r, noise, share, base, stack) for width, stack in stacks.items()}
        rho = noise.rho * share
        following = int((~r.starts).sum())
        cost = following * np.log(1.0 - rho**2).sum() + ((rho / PRIOR_RHO_STD) ** 2).sum()
        return _Level(share, base, bases, float(cost))

    def ratios(self, values: FloatArray) -> Float32Array:
        """(b, C) reductions of −2 log likelihood for b sets of responses (b, n, J)."""
        b, n, channels = values.shape
        alternatives = np.full((b, self._count), np.inf, dtype=np.float32)
        null = np.full(b, np.inf)
        for level in self._levels:
            flat = self._noise.whiten(values, self._r.starts, level.share).reshape(b, -1)
            white = (flat - (flat @ level.base) @ level.base.T).reshape(b, n, channels)
            power = (white**2).sum(axis=1)
            under_null = n * np.log(power).sum(axis=1) + level.cost
            null = np.minimum(null, under_null)
            by_channel = np.ascontiguousarray(white.transpose(2, 0, 1), dtype=np.float32)
            for width, indices in self._by_width.items():
                left = _share_left(by_channel, power.astype(np.float32), *level.bases[width])
                under = n * np.log(left) + under_null[:, None].astype(np.float32)
                alternatives[:, indices] = np.minimum(alternatives[:, indices], under)
        return np.asarray(null[:, None].astype(np.float32) - alternatives, dtype=np.float32)


def _orthonormal(
    r: Responses, noise: NoiseModel, share: float, base: FloatArray, stack: FloatArray
) -> tuple[Float32Array, Float32Array]:
    """Orthonormal columns of each candidate of a stack (C, n, J, p) beside the base, and their products.

    Both are split by channel: (J, p, C, n) and (J, C, p, p).
    """
    count, n, channels, width = stack.shape
    white = noise.whiten(np.moveaxis(stack, 3, 1), r.starts, share).reshape(count * width, -1)
    size_before = np.linalg.norm(white, axis=1)
    white = white - (white @ base) @ base.T
    size = np.linalg.norm(white, axis=1)
    size = np.where(size > 1e-7 * size_before, size, np.inf)  # what the base has already, counts for nothing
    units = (white / size[:, None]).reshape(count, width, -1)
    if width > 1:
        values, vectors = np.linalg.eigh(units @ units.transpose(0, 2, 1))
        inverse = np.where(values > SMALLEST, 1.0 / np.sqrt(np.maximum(values, SMALLEST)), 0.0)
        units = (vectors * inverse[:, None, :]).transpose(0, 2, 1) @ units
    columns = units.reshape(count, width, n, channels)
    products = np.einsum("cknj,clnj->jckl", columns, columns, optimize=True)
    by_channel = np.ascontiguousarray(columns.transpose(3, 1, 0, 2), dtype=np.float32)
    return by_channel, products.astype(np.float32)


def _share_left(
    values: Float32Array, power: Float32Array, columns: Float32Array, products: Float32Array
) -> Float32Array:
    """(b, C) product over the channels of what a candidate leaves of the channel's sum of squares.

    Takes (J, b, n) whitened responses, (b, J) their sums of squares, and what `_orthonormal` gives.
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
        left *= np.maximum(1.0 + change / power[:, j : j + 1], np.float32(SMALLEST))
    return np.asarray(left, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the gate says of one search: each candidate's ratio, and the p-value of the search as a whole."""

    ratios: Float32Array
    p_value: float


def gate(
    r: Responses,
    model: FloatArray,
    fitted: Fit,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    bootstraps: int,
) -> Verdict:
    """Judges the best of all candidates against its distribution under the current model.

    Args:
        r: the responses.
        model: (n, J, p) columns of the current model.
        fitted: its fit.
        candidates: everything the search looks at.
        rng: of the bootstrap.
        bootstraps: how many.
    """
    taken = max(1.0, model.shape[2] / len(r.channels))
    noise = noise_of(fitted.residuals, r.starts, taken, unbiased=True)
    screen = Screen(r, model, candidates, noise)
    observed = screen.ratios(r.values[None])
    null = screen.ratios(_resampled(r, fitted.residuals, noise, rng, bootstraps))
    best_null, best = np.full(bootstraps, -np.inf), -np.inf
    for indices in _families(candidates).values():
        of_family = null[:, indices].max(axis=1)
        named = candidates[indices[0]].effect is not None
        bar = float(np.quantile(of_family, FAMILY_QUANTILES[named]))
        best_null = np.maximum(best_null, of_family - bar)
        best = max(best, float(observed[0, indices].max()) - bar)
    p_value = (1 + int((best_null >= best).sum())) / (bootstraps + 1)
    return Verdict(observed[0], p_value)


def _families(candidates: Sequence[Candidate]) -> dict[str, list[int]]:
    families: dict[str, list[int]] = {}
    for index, candidate in enumerate(candidates):
        families.setdefault(candidate.family, []).append(index)
    return families


def _resampled(
    r: Responses, residuals: FloatArray, noise: NoiseModel, rng: np.random.Generator, count: int
) -> FloatArray:
    """(count, n, J) responses of noise alone: innovations drawn anew, signs too, and coloured again.

    All channels of a pose are drawn together, so that tails and what channels share stay as they are.
    """
    innovations = noise.whiten(residuals, r.starts)
    innovations = innovations - innovations.mean(axis=0)
    innovations /= np.sqrt((innovations**2).mean(axis=0))
    drawn = innovations[rng.integers(0, len(r), (count, len(r)))]
    drawn = drawn * rng.choice(np.array([-1.0, 1.0]), (count, len(r), 1))
    return np.asarray(noise.colour(drawn, r.starts) * r.known, dtype=np.float64)
