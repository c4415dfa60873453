"""The noise that responses share, its correlation from pose to pose, and a fit that allows for both.

Noise that is correlated from pose to pose, or that witnesses share with the reading, invalidates a test that
ignores it. One rotation undoes both: with Σ the residuals' covariance and Γ their symmetrised lag-1
covariance, the generalised eigenvectors of Γv = ρΣv give channels that are uncorrelated with each other, now
and one pose later, each a first-order autoregression of its own ρ (Tong, Liu, Soon & Huang, "Indeterminacy
and identifiability of blind identification", IEEE Trans. CAS 38, 1991; Switzer & Green's maximum
autocorrelation factors, 1984). One factor common to all channels and channels of one ρ are special cases.

Innovations (e_t − ρ·e_{t−1})/√(1 − ρ²) of a rotated channel have the power A + (ρ²·Q − ρ·H)/(1 − ρ²), with A
the sum of e_t², H that of 2·e_t·e_{t−1} and Q that of e_t² + e_{t−1}² over the poses that follow on another.
So a J × J matrix of each is all that a noise model needs (`LaggedProducts`). Where coefficients and strongly
correlated noise agree slowly, further steps weigh the lagged products of columns, which are made once for
many responses (`RepeatedSteps`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import BoolArray, FloatArray, Intp

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
        if covariance.shape[1] == 1:  # of one channel each is a number
            if not (covariance > 0.0).all():
                raise np.linalg.LinAlgError("residuals whose covariance is not positive")
            rho, rotation = (self.lagged / covariance)[:, :, 0], 1.0 / np.sqrt(covariance)
        elif len(covariance) == 1:  # one call in place of three, whose own cost is all there is
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
        power = np.maximum(same + (rho**2 * inner - rho * lagged) / white, 0.0)  # below by rounding alone
        variance = power / self.n + self.floor @ rotation**2
        return np.asarray(
            self.n * np.log(variance).sum(axis=1)
            + self.pairs * np.log(white).sum(axis=1)
            - 2.0 * self.n * np.linalg.slogdet(rotation)[1]
            + ((rho / PRIOR_RHO_STD) ** 2).sum(axis=1),
            dtype=np.float64,
        )


def lagged_products(residuals: FloatArray, starts: BoolArray, rounding: FloatArray) -> LaggedProducts:
    """Those of residuals (b, n, J), which begin again at `starts` (n,), with errors of rounding (J,)."""
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


ITERATIONS = 4
STRONG_RHO = 0.75
"""Correlation beyond which coefficients and noise agree slowly; below it one step from the noise that the
responses were drawn from leaves the criterion where four would (quantiles of its gain alike to 0.5).
"""
CACHE = 36_000
"""Numbers in an array that several of fit into the processor's cache; beyond it a fit takes twice as long."""
SINGULAR = 1e-10
"""Of products of columns of unit size, an eigenvalue that says that some of them say the same."""

Real = TypeVar("Real", npt.NDArray[np.float64], npt.NDArray[np.float32])


def _follows(starts: BoolArray) -> BoolArray:
    """Return (n,) whether a pose follows on another: the first does not, nor does the first of each run."""
    return np.append(False, ~starts[1:])


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Residuals e (n, J): e·rotation is J independent autoregressions of unit variance, correlation rho."""

    rotation: FloatArray
    rho: FloatArray

    def whiten(self, x: FloatArray, starts: BoolArray) -> FloatArray:
        """Return innovations of x (…, n, J) in the rotated channels."""
        return np.moveaxis(self.innovations(self.rotated(x), starts), 0, -1)

    def floor(self, rounding: FloatArray) -> FloatArray:
        """Return (J,) variance in each rotated channel of errors of rounding (J,) in the responses.

        Residuals of exact readings are what rounding left of them, in an order that the processor's own
        kernels decide. A sum of n products is right to n·eps times their size (Higham, Accuracy and
        Stability of Numerical Algorithms, 2002, section 3.1); no variance counts as smaller, under the null
        or an alternative. Noise that was measured is ten orders of magnitude larger.
        """
        return np.asarray(rounding**2 @ self.rotation**2, dtype=np.float64)

    def rotated(self, x: FloatArray) -> FloatArray:
        """Return (J, …, n) independent channels of x (…, n, J), in memory one after the other."""
        flat = self.rotation.T @ x.reshape(-1, x.shape[-1]).T
        return np.asarray(flat.reshape(-1, *x.shape[:-1]), dtype=np.float64)

    def innovations(self, rotated: Real, starts: BoolArray, share: float = 1.0) -> Real:
        """Return innovations (J, …, n) of rotated channels, with `share` of rho undone."""
        rho = (self.rho * share).astype(rotated.dtype).reshape(-1, *(1,) * (rotated.ndim - 1))
        gain = 1.0 / np.sqrt(1.0 - rho**2)
        white = rotated.copy()  # the first pose, and the first of each run, follow on nothing
        white[..., 1:] -= rho * rotated[..., :-1]
        white[..., 1:] *= gain
        white[..., starts] = rotated[..., starts]
        return white

    def unwhitened(self, white: Real, starts: BoolArray, share: float) -> Real:
        """Return (J, …, n) the transpose of `innovations`: x·unwhitened(y) is innovations(x)·y."""
        rho = (self.rho * share).astype(white.dtype).reshape(-1, *(1,) * (white.ndim - 1))
        gain = np.where(_follows(starts), 1.0 / np.sqrt(1.0 - rho**2), 0.0).astype(white.dtype)
        back = white * np.where(_follows(starts), gain, white.dtype.type(1.0))
        back[..., :-1] -= (rho * gain * white)[..., 1:]
        return back

    def gram_of_innovations(
        self, rotated: FloatArray, starts: BoolArray, shares: Sequence[float]
    ) -> list[FloatArray]:
        """Return (J, C, p, p) products of the innovations of rotated columns (J, C, p, n), at each share."""
        follows = _follows(starts)
        alone, last = np.flatnonzero(~follows), np.append(np.flatnonzero(~follows[1:]), len(starts) - 1)
        same = rotated @ np.swapaxes(rotated, 2, 3)
        lagged = rotated[..., 1:] @ np.swapaxes(rotated[..., :-1], 2, 3)
        anew, ends = rotated[..., alone], rotated[..., last]
        lagged -= anew[..., 1:] @ np.swapaxes(ends[..., :-1], 2, 3)
        anew = anew @ np.swapaxes(anew, 2, 3)
        later, earlier = same - anew, same - ends @ np.swapaxes(ends, 2, 3)
        lagged = lagged + np.swapaxes(lagged, 2, 3)

        def at(share: float) -> FloatArray:
            rho = (self.rho * share).reshape(-1, 1, 1, 1)
            return np.asarray(anew + (later - rho * lagged + rho**2 * earlier) / (1.0 - rho**2))

        return [same if share == 0.0 else at(share) for share in shares]

    def correlated(self, rotated: FloatArray, starts: BoolArray) -> FloatArray:
        """Return (J, p, n) columns of rotated channels times the covariance ρ^|i − j| of their noise."""
        ahead, back, rho = rotated.copy(), rotated.copy(), self.rho[:, None]
        for k in np.flatnonzero(_follows(starts)):
            ahead[..., k] += rho * ahead[..., k - 1]
        for k in np.flatnonzero(_follows(starts))[::-1]:
            back[..., k - 1] += rho * back[..., k]
        return ahead + back - rotated

    def colour(self, innovations: FloatArray, starts: BoolArray) -> FloatArray:
        """Return the residuals (…, n, J) whose innovations are given: the inverse of `whiten`."""
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
    """Fit coefficients of `columns` (n, J, p) and noise in turn until they agree."""
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


def fits(r: Responses, values: FloatArray, columns: FloatArray) -> Fits:
    """Fit b sets of responses at once.

    Args:
        r: the responses, for what their poses have in common.
        values: (b, n, J).
        columns: (b, n, J, p), or (1, n, J, p) where all have the same.
    """
    parts_needed = math.ceil(len(values) * (columns[0].size + values[0].size) / CACHE)
    at_once = math.ceil(len(values) / parts_needed)
    parts = [
        _fits(r, values[k : k + at_once], columns[k : k + at_once] if len(columns) > 1 else columns)
        for k in range(0, len(values), at_once)
    ]
    if len(parts) == 1:
        return parts[0]
    return Fits(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Fits)))


def _fits(r: Responses, values: FloatArray, columns: FloatArray) -> Fits:
    b, n, channels = values.shape
    p = columns.shape[3]
    rows = columns.reshape(len(columns), n * channels, p)
    spread = np.hypot(values.std(axis=1), r.rounding)
    rotation, rho = np.eye(channels) / spread[:, None, :], np.zeros((b, channels))  # white to begin with
    taken = max(1.0, p / channels)
    by_channel = _by_channel(columns, values)
    for step in range(ITERATIONS):
        white = _innovations(by_channel, rotation, rho, r.starts)
        products = np.swapaxes(white, 1, 2) @ white
        gram, along = products[:, :p, :p], products[:, :p, p:]
        if step == 0:  # from here on with columns that are orthonormal, or nothing
            some = gram[: len(columns)]
            turn = orthonormal(some, np.sqrt(np.einsum("bpp->bp", some)))
            back = np.swapaxes(turn, 1, 2)
            gram, along = back @ gram @ turn, back @ along
            void = np.eye(p) * (turn == 0.0).all(axis=1)[:, None, :]
            rows = rows @ turn
            by_channel = _by_channel(rows.reshape(-1, n, channels, p), values)
        covariance = _inverse(gram + void)
        inside = covariance @ along
        residuals = (values - (rows @ inside).reshape(values.shape)) * r.known
        left = lagged_products(residuals, r.starts, r.rounding)
        rotation, rho = left.noises(taken)
    beta = (turn @ inside)[:, :, 0]
    covariance = turn @ (covariance - void) @ back
    return Fits(beta, covariance, residuals, rotation, rho, left.criterion(rotation, rho))


def _inverse(gram: FloatArray) -> FloatArray:
    """Return (b, p, p) inverses; where noise has left columns that say the same, of what these say."""
    try:
        return np.asarray(np.linalg.inv(gram), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(gram, hermitian=True), dtype=np.float64)


def solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution of normal equations (…, p, p), the shortest where noise has left them singular."""
    try:
        return np.asarray(np.linalg.solve(gram, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(gram, hermitian=True) @ right, dtype=np.float64)


def _by_channel(columns: FloatArray, values: FloatArray) -> FloatArray:
    """(b, J, n, p + 1) columns (b or 1, n, J, p) and beside them values (b, n, J), channel by channel."""
    b, n, channels = values.shape
    both = np.empty((b, channels, n, columns.shape[3] + 1))
    both[..., :-1] = np.swapaxes(columns, 1, 2)
    both[..., -1] = np.swapaxes(values, 1, 2)
    return both


def orthonormal(gram: FloatArray, size: FloatArray) -> FloatArray:
    """Return (b, p, p) what turns columns into orthonormal ones, as many as they are worth, and 0 beyond.

    Args:
        gram: (b, p, p) products of the columns.
        size: (b, p) of the columns before others were taken off them: what is left of none, is nothing.
    """
    safe = np.where(size > 0.0, size, 1.0)
    unit = gram / (safe[:, :, None] * safe[:, None, :])
    if gram.shape[1] <= 2:
        return _one_after_the_other(unit) / safe[:, :, None]
    values, vectors = np.linalg.eigh(unit)
    there = values > SINGULAR * np.maximum(values[:, -1:], 1.0)
    scale = np.where(there, 1.0 / np.sqrt(np.where(there, values, 1.0)), 0.0)
    return np.asarray(vectors * scale[:, None, :] / safe[:, :, None], dtype=np.float64)


def _one_after_the_other(gram: FloatArray) -> FloatArray:
    """The same of one column or two, of unit size, as Gram and Schmidt: thousands without a call for each."""
    turn = np.zeros_like(gram)
    turn[:, 0, 0] = _unit(gram[:, 0, 0])
    if gram.shape[1] == 2:
        along = gram[:, 0, 1] * turn[:, 0, 0]
        turn[:, 1, 1] = _unit(gram[:, 1, 1] - along**2)
        turn[:, 0, 1] = -along * turn[:, 0, 0] * turn[:, 1, 1]
    return turn


def _unit(power: FloatArray) -> FloatArray:
    """Return (b,) what makes columns of sums of squares (b,) unit ones; 0 of what is nothing."""
    there = power > SINGULAR
    return np.where(there, 1.0 / np.sqrt(np.where(there, power, 1.0)), 0.0)


def _innovations(
    by_channel: FloatArray, rotation: FloatArray, rho: FloatArray, starts: BoolArray
) -> FloatArray:
    """(b, J·n, p) innovations of columns (b, J, n, p) in rotated channels of correlations rho (b, J)."""
    flat = by_channel.reshape(*by_channel.shape[:2], -1)
    rotated = (np.swapaxes(rotation, 1, 2) @ flat).reshape(len(rotation), *by_channel.shape[1:])
    if rho.any():
        gain = 1.0 / np.sqrt(1.0 - rho**2)
        before = rotated[:, :, :-1] * (rho * gain)[:, :, None, None]
        anew = np.flatnonzero(starts[1:]) + 1  # and the very first: they follow on nothing
        alone = rotated[:, :, anew]
        rotated[:, :, 1:] *= gain[:, :, None, None]
        rotated[:, :, 1:] -= before
        rotated[:, :, anew] = alone
    return rotated.reshape(len(rotated), -1, rotated.shape[3])


def stacked(noise: NoiseModel, starts: BoolArray, columns: FloatArray) -> FloatArray:
    """Return whitened columns (n, J, p) as one matrix (n·J, p)."""
    white = noise.whiten(np.moveaxis(columns, 2, 0), starts)
    return white.reshape(len(white), -1).T


def lag1_correlation(residual: FloatArray, rounding: float) -> float:
    """Return the correlation from pose to pose of a residual (n,), with errors of rounding in it."""
    power = float(residual @ residual) + len(residual) * rounding**2
    return float(residual[1:] @ residual[:-1]) / power


def distance_of(beta: FloatArray, covariance: FloatArray) -> float:
    """Return the squared distance of coefficients (p,) from 0, in whatever units each of them is."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std = np.where(std > 0.0, std, 1.0)
    scaled = beta / std
    return float(scaled @ np.linalg.pinv(covariance / np.outer(std, std), hermitian=True) @ scaled)


WEIGHTINGS_AGREE = 2.0
"""Standard errors up to which noise alone may move a coefficient from one weighting to the other."""


def moved_unweighted(r: Responses, columns: FloatArray, fitted: Fit) -> FloatArray:
    """Return (p,) how far a fit that weighs no correlation moves the coefficients; 0 where noise alone may.

    Of a true model both fits estimate the same, and their difference has the difference of their variances
    (Hausman, Econometrica 46, 1978). If an effect has another shape than the model's, or strongly correlated
    noise is of another kind, each fit has its own answer, and neither is as certain as it states.

    `columns` are (n, J, p) of the fit.
    """
    noise = fitted.noise
    if noise.rho.max() < STRONG_RHO:
        return np.zeros_like(fitted.beta)
    rows = noise.rotated(np.moveaxis(columns, 2, 0))
    gram = np.einsum("jpn,jqn->pq", rows, rows)
    (turn,) = orthonormal(gram[None], np.sqrt(np.diag(gram))[None])
    inverse = turn @ turn.T
    moved = inverse @ np.einsum("jpn,jn->p", rows, noise.rotated(fitted.residuals))
    scatter = inverse @ np.einsum("jpn,jqn->pq", rows, noise.correlated(rows, r.starts)) @ inverse
    variance = np.maximum(np.diag(scatter) - np.diag(fitted.covariance), 0.0)
    return np.where(moved**2 > WEIGHTINGS_AGREE**2 * variance, moved, 0.0)


PARTS = 4
"""Of the poses in the order measured, as near to equal as can be."""
PARTS_DISAGREE = 1e-3
"""Chance that noise alone moves a coefficient as far where each part is left out in turn."""
A_PART = 0.02
"""Of a variance, by which it must grow without a part that tells something of the coefficient."""


def varied_between_parts(r: Responses, columns: FloatArray, fitted: Fit) -> FloatArray:
    """Return (p,) how many times its variance a coefficient varies between parts of the time; 1 as noise may.

    Without one of the parts a true model estimates the same, and what the coefficient moves by has the
    difference of both variances (Hausman, as above). If it moves further, errors grow by the Birge ratio
    (R. T. Birge, Physical Review 40, 1932): a hysteresis that depends on the speed is another in each part.

    `columns` are (n, J, p) of the fit.
    """
    from scipy.special import chdtrc

    white = stacked(fitted.noise, r.starts, columns)
    left = stacked(fitted.noise, r.starts, fitted.residuals[:, :, None])[:, 0]
    gram = white.T @ white

    def inverse(gram_of_rest: FloatArray) -> FloatArray:
        (turn,) = orthonormal(gram_of_rest[None], np.sqrt(np.diag(gram))[None])
        return np.asarray(turn @ turn.T, dtype=np.float64)

    known = np.diag(inverse(gram))
    squares, informed = np.zeros((2, len(known)))
    for part in np.array_split(np.arange(len(white)), PARTS):
        rest = inverse(gram - white[part].T @ white[part])
        moved, grown = rest @ (white[part].T @ left[part]), np.diag(rest) - known
        tells = grown > A_PART * known
        squares += np.divide(moved**2, grown, out=np.zeros_like(moved), where=tells)
        informed += tells
    several = informed > 1
    ratio = np.divide(squares, informed, out=np.ones_like(squares), where=several)
    chance = chdtrc(np.maximum(informed - 1.0, 1.0), ratio * np.maximum(informed - 1.0, 1.0))
    return np.where(several & (chance < PARTS_DISAGREE), ratio, 1.0)


def noise_of(residuals: FloatArray, r: Responses, parameters: float) -> NoiseModel:
    """Return the noise model of residuals (n, J) of a fit that took so many parameters per channel.

    What fitting takes off the correlation, about (1 + p + 4ρ)/n (Kendall, 1954), is added: a bootstrap that
    is to behave like the noise needs it.
    """
    (rotation,), (rho,) = lagged_products(residuals[None], r.starts, r.rounding).noises(parameters)
    rho = rho + 0.75 * (1.0 + parameters + 4.0 * np.maximum(rho, 0.0)) / len(residuals)
    return NoiseModel(rotation, np.clip(rho, SMALLEST_RHO, LARGEST_RHO))


class Steps(NamedTuple):
    """What all steps leave of m responses: residuals (m, n·J), and their products.

    By how much coefficients changed since the first step: `inside` (m, q) those of the model, `more` (m, w)
    those beside it. Of all of them `gram` (m, q + w, q + w) has the last step's weighted products, the
    inverse of their covariance.
    """

    residuals: FloatArray
    products: LaggedProducts
    inside: FloatArray
    more: FloatArray
    gram: FloatArray


class RepeatedSteps:
    """Steps on from the first, for a model's columns (q, n·J), none of them nothing."""

    def __init__(self, r: Responses, model: FloatArray) -> None:
        self._r = r
        self._model = model
        self._lagged = _lagged(self._model[None], r)[0]
        self._own = _products(self._lagged[None], self._model[None], r)[0]

    def steps(self, left: FloatArray, beside: FloatArray, at: Intp, taken: float) -> Steps:
        """All steps.

        Args:
            left: (m, n·J) what the first step leaves.
            beside: (k, w, n·J) columns beside the model.
            at: (m,) which of them.
            taken: parameters that a fit takes per channel.
        """
        r, q, w = self._r, len(self._model), beside.shape[1]
        lagged = _lagged(beside, r)
        crossed = _products(np.broadcast_to(self._lagged, (len(beside), *self._lagged.shape)), beside, r)
        own = _products(lagged, beside, r)
        of_left = np.concatenate(
            [
                _products(np.broadcast_to(self._lagged, (len(left), *self._lagged.shape)), left[:, None], r),
                _products(lagged[at], left[:, None], r),
            ],
            axis=2,
        )
        residuals, inside = left, np.zeros((len(left), q + w))
        products = lagged_products(residuals.reshape(-1, *r.values.shape), r.starts, r.rounding)
        for _ in range(ITERATIONS - 1):
            weights = _weights(*products.noises(taken))
            gram = np.empty((len(left), q + w, q + w))
            gram[:, :q, :q] = (weights[:, 0] @ self._own).reshape(len(left), q, q)
            gram[:, :q, q:] = (weights @ crossed[at]).reshape(len(left), q, w)
            gram[:, q:, :q] = np.swapaxes(gram[:, :q, q:], 1, 2)
            gram[:, q:, q:] = (weights @ own[at]).reshape(len(left), w, w)
            power = np.einsum("mii->mi", gram)
            power += power == 0.0  # of nothing the coefficient is 0
            inside = solved(gram, np.swapaxes(weights @ of_left, 1, 2))[:, :, 0]
            residuals = left - inside[:, :q] @ self._model
            residuals -= (inside[:, None, q:] @ beside[at])[:, 0]
            products = lagged_products(residuals.reshape(-1, *r.values.shape), r.starts, r.rounding)
        return Steps(residuals, products, inside[:, :q], inside[:, q:], gram)


def _weights(rotation: FloatArray, rho: FloatArray) -> FloatArray:
    """(m, 1, 3·J·J) what a noise multiplies lagged products by, of innovations to make the products."""
    white = 1.0 - rho**2
    of_channel = np.stack([np.ones_like(rho), -rho / white, rho**2 / white], axis=1)
    weighed = (rotation[:, None] * of_channel[:, :, None, :]) @ np.swapaxes(rotation, 1, 2)[:, None]
    return np.asarray(weighed.reshape(len(rho), 1, -1), dtype=np.float64)


def _lagged(rows: FloatArray, r: Responses) -> FloatArray:
    """(k, 3·w·J, n) what columns (k, w, n·J) are multiplied by for their same, lagged and inner products."""
    follows = ~r.starts
    follows[0] = False
    k, w = rows.shape[:2]
    channels = np.swapaxes(rows.reshape(k, w, *r.values.shape), 2, 3)
    lagged, inner = np.zeros((2, *channels.shape))
    after, before = channels[..., 1:] * follows[1:], channels[..., :-1] * follows[1:]
    lagged[..., 1:] += before
    lagged[..., :-1] += after
    inner[..., 1:] += after
    inner[..., :-1] += before
    return np.stack([channels, lagged, inner], axis=1).reshape(k, 3 * w * len(r.channels), len(r))


def _products(lagged: FloatArray, rows: FloatArray, r: Responses) -> FloatArray:
    """Return (k, 3·J·J, v·w) products of columns as `_lagged` gives them with others (k, w, n·J)."""
    (k, w), (n, channels) = rows.shape[:2], r.values.shape
    v = lagged.shape[1] // (3 * channels)
    others = np.swapaxes(rows.reshape(k, w, n, channels), 1, 2).reshape(k, n, w * channels)
    found = (lagged @ others).reshape(k, 3, v, channels, w, channels)
    return np.moveaxis(found, (3, 5), (2, 3)).reshape(k, 3 * channels * channels, v * w)
