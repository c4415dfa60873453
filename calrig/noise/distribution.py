"""The distribution of a channel's values: moments, histogram, normality and outliers.

Of n samples with autocorrelation ρ(j) the third moment is worth n/Σρ³ and the fourth n/Σρ⁴ independent ones
(Lobato & Velasco, Econometric Theory 20, 2004). With these numbers D'Agostino's test of skewness and Anscombe
and Glynn's of kurtosis are combined as by D'Agostino and Pearson (Biometrika 60, 1973). Quantised values are
compared with a Gaussian rounded to the same steps.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import ndtr, ndtri

from calrig.estimation.angles import FloatArray, IntArray

_WHOLE = 2**17
"""Samples whose autocovariance is taken at every lag; of longer logs the far lags are those of means."""
_PIECE = 2**14
_PIECES = 24


def effective_sample_sizes(centred: FloatArray) -> tuple[float, float]:
    """What the samples are worth for their third and fourth moment: n/Σρ(j)³ and n/Σρ(j)⁴ over all lags.

    `centred` (N,) are samples about their mean, not all 0.
    """
    n = len(centred)
    if n <= _WHOLE:
        near, far, block = _autocovariance(centred, n), np.zeros(0), 1
    else:
        near = _near(centred)
        block = -(-n // _WHOLE)
        means = centred[: n // block * block].reshape(-1, block).mean(axis=1)
        far = _autocovariance(means, len(means))[len(near) // block + 1 :]
    worth = []
    for power in (3, 4):
        rho = (near / near[0]) ** power
        total = 2.0 * float(rho.sum()) - 1.0 + 2.0 * block * float(((far / near[0]) ** power).sum())
        worth.append(n / max(total, 1.0))
    return worth[0], worth[1]


def _near(centred: FloatArray) -> FloatArray:
    """Return autocovariance up to half of `_PIECE`, from pieces spread over the log."""
    starts = np.linspace(0, len(centred) - _PIECE, _PIECES).astype(np.int64)
    covariance = sum(_autocovariance(centred[start : start + _PIECE], _PIECE // 2) for start in starts)
    return np.asarray(covariance / _PIECES, dtype=np.float64)


def _autocovariance(x: FloatArray, lags: int) -> FloatArray:
    """Return (lags,) Σ x[i]·x[i + j]/n, without taking the mean out again."""
    transform = rfft(x, next_fast_len(len(x) + lags, real=True))
    power = transform.real**2 + transform.imag**2
    covariance = irfft(power, next_fast_len(len(x) + lags, real=True))[:lags] / len(x)
    return np.asarray(covariance, dtype=np.float64)


SIGNIFICANCE = 0.01
"""p-value below which a distribution is said not to be Gaussian."""
COARSEST = 2.0
"""Steps of more standard deviations than that: too few values are taken for a verdict."""
FEWEST_INDEPENDENT = 30.0
"""Fewer independent samples, as in a log that mostly drifts, give no verdict."""
MOST_BINS = 400
LEAST_SIGMAS = 5.0
EXPECTED_OUTLIERS = 0.05
"""Samples further out than the limit that a Gaussian log of this length would show."""
_NEIGHBOURS = 128
_LOOKED_AT_FOR_OUTLIERS = 200_000
_QUARTILES = 2.0 * 0.6744897501960817
_LOOKED_AT = 100_000
_FINE = 20.0
"""Standard deviations of that many steps hide the steps: kurtosis changes by 5e-8."""
_ROUNDS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """How the values of one channel are distributed.

    Attributes:
        mean, std: of the Gaussian fitted, in the channel's unit (n in the denominator).
        skewness, kurtosis: third and fourth standardised moment, the latter less a Gaussian's 3.
        gaussian: whether a Gaussian fits at 1 %; None where nothing can be said.
        p_value: of the test; None where `gaussian` is.
        outliers: samples further out than chance and the channel's slow course would have them.
        step: what the values are multiples of; 0 where there is no telling.
        edges: (B + 1,) of the histogram's bins, each of a whole number of steps.
        counts: (B,) samples in each.
    """

    mean: float
    std: float
    skewness: float
    kurtosis: float
    gaussian: bool | None
    p_value: float | None
    outliers: int
    step: float
    edges: FloatArray
    counts: FloatArray


def distribution_of(x: FloatArray) -> Distribution:
    """Return the distribution of a channel's samples.

    `x` (N,) are finite samples in order; gaps between them do not matter here.
    """
    mean = float(x.mean())
    centred = x - mean
    squares = centred * centred
    variance = float(squares.mean())
    step = step_of(x)
    std = math.sqrt(variance)
    skewness = kurtosis = 0.0
    if variance > 0.0:
        skewness = float(squares @ centred) / (len(x) * std**3)
        kurtosis = float(squares @ squares) / (len(x) * variance**2) - 3.0
    del squares
    p_value = _p_value(centred, mean, std, step, skewness, kurtosis)
    edges, counts = _histogram(x, std, step)
    return Distribution(
        mean=mean,
        std=std,
        skewness=skewness,
        kurtosis=kurtosis,
        gaussian=None if p_value is None else p_value >= SIGNIFICANCE,
        p_value=p_value,
        outliers=count_outliers(x, step),
        step=step,
        edges=edges,
        counts=counts,
    )


def step_of(x: FloatArray) -> float:
    """The step that values are rounded to: the least difference, if all others are multiples; else 0."""
    values = np.unique(x[:: max(len(x) // _LOOKED_AT, 1)])
    gaps = np.diff(values)
    rounding = 8.0 * np.finfo(np.float64).eps * float(np.abs(values).max())
    gaps = gaps[gaps > rounding]
    if len(gaps) == 0:
        return 0.0
    multiples = gaps / gaps.min()
    whole = np.rint(multiples)
    if np.abs(multiples - whole).max() > 0.01:
        return 0.0
    return float(gaps.sum() / whole.sum())


def _p_value(
    centred: FloatArray, mean: float, std: float, step: float, skewness: float, kurtosis: float
) -> float | None:
    """The p-value of a Gaussian; None of values in coarse steps, and of few independent ones (a drift)."""
    if std == 0.0 or step > COARSEST * std:
        return None
    third, fourth = effective_sample_sizes(centred)
    if fourth < FEWEST_INDEPENDENT or third < FEWEST_INDEPENDENT:
        return None
    expected = _rounded_gaussian(mean, std, step) if step > 0.0 else (0.0, 0.0)
    z3 = _skewness_score(skewness - expected[0], third)
    z4 = _kurtosis_score(kurtosis - expected[1], fourth)
    return math.exp(-0.5 * (z3 * z3 + z4 * z4))


def _rounded_gaussian(mean: float, std: float, step: float) -> tuple[float, float]:
    """Skewness and excess kurtosis of a Gaussian that, rounded to multiples of `step`, has this mean and std.

    It starts with Sheppard's correction, a variance less by step²/12, and is brought to agree from there.
    """
    if std > _FINE * step:
        return 0.0, 0.0
    wanted = mean - step * round(mean / step)
    centre, spread2 = wanted, std**2 - step**2 / 12.0
    for _ in range(_ROUNDS):
        spread = math.sqrt(spread2)
        reach = math.ceil(8.0 * spread / step) + 1
        codes = step * np.arange(-reach, reach + 1)
        share = ndtr((codes + step / 2.0 - centre) / spread) - ndtr((codes - step / 2.0 - centre) / spread)
        found = float(share @ codes)
        codes = codes - found
        variance = float(share @ codes**2)
        centre += wanted - found
        spread2 = max(spread2 + std**2 - variance, (0.05 * step) ** 2)
    return float(share @ codes**3) / variance**1.5, float(share @ codes**4) / variance**2 - 3.0


def _skewness_score(skewness: float, n: float) -> float:
    """Return skewness of `n` samples as a standard normal one (D'Agostino 1970, Biometrika 57)."""
    y = skewness * math.sqrt((n + 1.0) * (n + 3.0) / (6.0 * (n - 2.0)))
    beta = 3.0 * (n**2 + 27.0 * n - 70.0) * (n + 1.0) * (n + 3.0)
    beta /= (n - 2.0) * (n + 5.0) * (n + 7.0) * (n + 9.0)
    w2 = math.sqrt(2.0 * (beta - 1.0)) - 1.0
    return math.asinh(y / math.sqrt(2.0 / (w2 - 1.0))) / math.sqrt(0.5 * math.log(w2))


def _kurtosis_score(kurtosis: float, n: float) -> float:
    """Excess kurtosis of `n` samples as a standard normal one (Anscombe & Glynn 1983, Biometrika 70)."""
    variance = 24.0 * n * (n - 2.0) * (n - 3.0) / ((n + 1.0) ** 2 * (n + 3.0) * (n + 5.0))
    x = (kurtosis + 6.0 / (n + 1.0)) / math.sqrt(variance)
    beta = 6.0 * (n**2 - 5.0 * n + 2.0) / ((n + 7.0) * (n + 9.0))
    beta *= math.sqrt(6.0 * (n + 3.0) * (n + 5.0) / (n * (n - 2.0) * (n - 3.0)))
    a = 6.0 + 8.0 / beta * (2.0 / beta + math.sqrt(1.0 + 4.0 / beta**2))
    denominator = 1.0 + x * math.sqrt(2.0 / (a - 4.0))
    cube = (
        math.copysign(abs((1.0 - 2.0 / a) / denominator) ** (1.0 / 3.0), denominator) if denominator else 0.0
    )
    return (1.0 - 2.0 / (9.0 * a) - cube) / math.sqrt(2.0 / (9.0 * a))


def _histogram(x: FloatArray, std: float, step: float) -> tuple[FloatArray, FloatArray]:
    """Return bins of Freedman and Diaconis' width (1981), of whole steps, and no more than `MOST_BINS`."""
    low, high = float(x.min()), float(x.max())
    if std == 0.0:
        return np.array([low - 0.5, low + 0.5]), np.array([float(len(x))])
    quarter, three = np.quantile(x[:: max(len(x) // _LOOKED_AT, 1)], [0.25, 0.75])
    spread = float(three - quarter) or 1.35 * std
    width = max(2.0 * spread * len(x) ** (-1.0 / 3.0), (high - low) / (MOST_BINS - 1))
    first = low
    if step > 0.0:
        width = step * math.ceil(width / step - 1e-9)
        first = low - step / 2.0
    place = ((x - first) / width).astype(np.int32)
    counts = np.bincount(place)
    return first + width * np.arange(len(counts) + 1), counts.astype(np.float64)


def count_outliers(x: FloatArray, step: float) -> int:
    """Samples beyond `LEAST_SIGMAS`, in long logs more, both of the whole log and of their surroundings.

    Sigma is by the quartiles, which outliers do not move. A sample that lies far out because the channel
    drifted there lies well among its neighbours, and one that a slow noise brought away from its neighbours
    lies well in the whole.

    `x` (N,) are finite samples in order, rounded to `step`; 0 if they are not.
    """
    suspects, limit = _far_out(x, step)
    if len(suspects) == 0:
        return 0
    windows = _windows(x)
    block = np.minimum(suspects // windows.shape[1], len(windows) - 1)
    blocks, place = np.unique(block, return_inverse=True)
    middle = np.median(windows[blocks], axis=1)
    return int(np.count_nonzero(np.abs(x[suspects] - middle[place]) > limit))


def _far_out(x: FloatArray, step: float) -> tuple[IntArray, float]:
    """Return the samples that are far out in the whole log, and how far is far in their surroundings."""
    sigmas = max(LEAST_SIGMAS, -float(ndtri(EXPECTED_OUTLIERS / (2.0 * max(len(x), 1)))))
    thinned = x[:: max(len(x) // _LOOKED_AT_FOR_OUTLIERS, 1)]
    limit = sigmas * _spread(thinned, step) + step / 2.0
    suspects = np.flatnonzero(np.abs(x - np.median(thinned)) > limit)
    if len(suspects) == 0:
        return suspects, limit
    windows = _windows(x)
    all_blocks = windows[:: max(len(windows) // (_LOOKED_AT_FOR_OUTLIERS // _NEIGHBOURS), 1)]
    nearby = all_blocks - np.median(all_blocks, axis=1, keepdims=True)
    return suspects, sigmas * _spread(nearby.ravel(), step) + step / 2.0


def _windows(x: FloatArray) -> FloatArray:
    around = min(_NEIGHBOURS, len(x))
    return x[: len(x) // around * around].reshape(-1, around)


MOST_KNOCKS, MOST_KNOCKED = 4, 0.05
"""Of more, a log tells to better than half how often they come: they are part of its noise, as are those that
make up more of the log.
"""


def knocks_of(channels: dict[str, FloatArray]) -> dict[str, list[slice]]:
    """Return the knocks of each channel (N,) that has some; none where they are too many for the whole log.

    What is left out of one channel is left out of all.
    """
    knocks = {name: found for name, values in channels.items() if (found := knocks_in(values))}
    left_out = np.zeros(len(next(iter(channels.values()), ())), dtype=np.bool_)
    for one in (one for found in knocks.values() for one in found):
        left_out[one] = True
    stretches = np.count_nonzero(np.diff(left_out, prepend=False)) / 2.0
    few = stretches <= MOST_KNOCKS and left_out.sum() <= MOST_KNOCKED * len(left_out)
    return knocks if few else {}


def knocks_in(x: FloatArray) -> list[slice]:
    """Return the few stretches that rule a log's Allan deviation and say nothing of its noise, as of a knock.

    Far out for a moment, from the start or to the end of the log, they begin and end at once, as no drift
    does, and at some averaging time they make more of the Allan variance than all the rest. Each is taken as
    long again on either side, where it swings in and out.

    `x` (N,) are samples in order, NaN where not known.
    """
    rows = np.flatnonzero(np.isfinite(x))
    x = x if len(rows) == len(x) else x[rows]
    suspects, limit = _far_out(x, step_of(x)) if len(x) else (rows, 0.0)
    parts = np.split(suspects, np.flatnonzero(np.diff(suspects) > _NEIGHBOURS) + 1)
    if len(suspects) == 0 or len(parts) > MOST_KNOCKS or len(x) < 2 * _NEIGHBOURS:
        return []
    ends = [(int(part[0]), int(part[-1]) + 1) for part in parts]
    wide = [(max(2 * a - b, 0), min(2 * b - a, len(x))) for a, b in ends]
    if sum(b - a for a, b in wide) > MOST_KNOCKED * len(x):
        return []
    phase = np.concatenate(([0.0], np.cumsum(x - np.median(x))))
    rules = np.zeros(len(ends), dtype=np.bool_)
    for m in 2 ** np.arange(int(np.log2(max(b - a for a, b in ends))) + 1):
        squares = (phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]) ** 2
        touching = [slice(max(a - 2 * m + 1, 0), b) for a, b in wide]
        own = np.array([squares[part].sum() for part in touching])
        for part in touching:
            squares[part] = 0.0
        rules |= own > squares.sum()

    def stands_out(row: int, neighbours: FloatArray) -> bool:
        return len(neighbours) > 0 and bool(abs(x[row] - np.median(neighbours)) > limit)

    return [
        slice(int(rows[begin]), int(rows[end - 1]) + 1)
        for (a, b), (begin, end), is_ruling in zip(ends, wide, rules, strict=True)
        if is_ruling
        and (a == 0 or stands_out(a, x[:a][-_NEIGHBOURS:]))
        and (b == len(x) or stands_out(b - 1, x[b : b + _NEIGHBOURS]))
    ]


def _spread(x: FloatArray, step: float) -> float:
    """Standard deviation of the Gaussian of the same quartiles; rounded values are spread over their step.

    The quartiles of rounded values are steps themselves: one is found within its step by the share of the
    samples below it.
    """
    low, high = (_quantile(x, share, step) for share in (0.25, 0.75))
    return float(max((high - low) / _QUARTILES, step / 12.0**0.5))


def _quantile(x: FloatArray, share: float, step: float) -> float:
    value = float(np.quantile(x, share))
    if step == 0.0:
        return value
    below = int(np.count_nonzero(x < value - step / 2.0))
    at = np.count_nonzero(np.abs(x - value) <= step / 2.0)
    return float(value - step / 2.0 + step * (share * len(x) - below) / max(int(at), 1))
