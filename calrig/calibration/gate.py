"""The gate: is the best of everything searched better than noise alone would make it?

Searching a catalogue and keeping what lowers a criterion finds an effect in pure noise in 19–45 % of cases.
What holds its rate is the maximum over all candidates, hence a family-wise p-value, bootstrapped under the
current model for these very poses. Beside an effect that others are declared to come with, these few are a
family of their own: noise alone is not asked that.

The statistic is the gain of the best candidates in full likelihood, coefficients and noise fitted anew with
each of them, less the penalties. The noise of the null alone would not do: a large effect is taken for a
correlation of 0.95 between poses and for innovations with tails, and is as likely under those as under
itself. So an alternative is judged by the noise that it leaves, and the bootstrap draws its innovations from
there; their correlation stays the null's, for noise that wanders makes slow effects of itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.channels import BoolArray
from calrig.calibration.drawn_fits import DrawnFits
from calrig.calibration.effects import UNNAMED
from calrig.calibration.model import side_by_side
from calrig.calibration.noise_model import Fit, NoiseModel, fits, noise_of
from calrig.calibration.responses import Responses
from calrig.calibration.screen import Float32Array, Screen
from calrig.estimation.angles import FloatArray

LEADERS = 16
"""Forms of effects whose full likelihood is taken in a draw of noise, those that lead on the screen: to the
upper tenth of draws the best gain is the same as of all forms, of 52 poses and of 100.
"""
QUANTILE, UNNAMED_QUANTILE = 0.98, 0.995
"""Of what a name gains from noise, where its own bar lies: an effect that has a name is likelier beforehand
than a shape that has none, and four times as much of the error rate is spent on it. So a scan of a hundred
instants does not raise the bar for an effect of one parameter.
"""
FIRST_DRAWS, MORE_DRAWS = 24, 49
FEWEST_DRAWS = 99
CLEAR_SHARE = 5
CLEAR, CLEAR_AT_FIRST = 10.0, 15.0
"""Of −2 log likelihood, beyond the largest of a fifth of all draws: the rest would not reach it either. Nor
would one in a hundred where few were drawn: over 10 a χ² of one degree of freedom falls by a factor of 150 or
more, over 15 by one of 1,800.
"""
Intp = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the gate says of one search: each candidate's ratio on the screen, and the search's p-value.

    `gain` is that of the best candidate in −2 log likelihood with penalties; `passes`, whether the p-value is
    below the level, or clearly would be with more draws; `least_p_value`, what all draws could tell at best.
    """

    candidates: Sequence[Candidate]
    ratios: Float32Array
    gain: float
    p_value: float
    passes: bool
    least_p_value: float


def gate(
    r: Responses,
    columns_with: Callable[[Sequence[Candidate]], FloatArray],
    fitted: Fit,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    bootstraps: int,
    level: float,
    noise: NoiseModel | None = None,
    *,
    companions: Collection[str] = (),
    decide_only: bool = False,
) -> Verdict:
    """Judges the best of all candidates against its distribution under the current model.

    Draws that can no longer change the decision are not made (Besag & Clifford, Biometrika 78, 1991).

    Args:
        r: the responses.
        columns_with: (n, J, p) columns of the current model with some candidates beside it.
        fitted: its fit.
        candidates: everything the search looks at.
        rng: of the bootstrap.
        bootstraps: how many at most.
        level: of the decision that the p-value is for.
        noise: of the null, where a larger model tells it better than what the current one leaves.
        companions: labels that are declared to come together with what is in the model. Set beforehand, they
            are judged by themselves and all others by themselves, each of the two families at the level.
        decide_only: whether the p-value is of no interest where it is clear that it lies below the level.
    """
    least = 1.0 / (bootstraps + 1)
    if not candidates:
        return Verdict(candidates, np.empty(0, dtype=np.float32), 0.0, 1.0, level >= 1.0, least)
    model = columns_with(())
    if noise is None:
        noise = noise_of(fitted.residuals, r, max(1.0, model.shape[2] / len(r.channels)), unbiased=True)
    trial = _Trial(r, columns_with, candidates, noise)
    ratios = trial.screen.ratios(fitted.residuals[None])
    observed, alternative = trial.observed(ratios)
    null = np.empty((0, len(observed)))
    expected = np.array([label in companions for label in trial.labels])
    families = [family for family in (expected, ~expected) if family.any()]
    clear_after = max(FEWEST_DRAWS, round(1.0 / level) - 1, bootstraps // CLEAR_SHARE)
    steps = (FIRST_DRAWS, MORE_DRAWS, clear_after, 2 * clear_after, bootstraps)
    for draws in sorted({min(step, bootstraps) for step in steps}):
        values = _resampled(r, alternative, noise, rng, draws - len(null))
        null = np.concatenate([null, trial.gains_of_noise(values)])
        judged = [_above_bars(trial.labels, observed, null, family) for family in families]
        exceeded = min(int((of_noise >= best).sum()) for best, of_noise in judged)
        margin = CLEAR if draws > FIRST_DRAWS else CLEAR_AT_FIRST
        beyond = any(best > of_noise.max() + margin for best, of_noise in judged)
        is_clear = (decide_only or draws >= min(clear_after, bootstraps)) and beyond
        if is_clear or exceeded >= level * (bootstraps + 1):
            break
    p_value = (1 + exceeded) / (1 + len(null))
    passes = is_clear or p_value <= level
    return Verdict(candidates, ratios[0], float(observed.max()), p_value, passes, least)


def _above_bars(
    labels: Sequence[str], observed: FloatArray, null: FloatArray, family: BoolArray
) -> tuple[float, FloatArray]:
    """By how much the best of a family's names exceeds its own bar, and in (b,) searches of noise.

    The bars are quantiles of noise and observation together: noise that they were set by alone exceeds them
    less often than noise that they have not seen.
    """
    shares = np.array([UNNAMED_QUANTILE if label.startswith(UNNAMED) else QUANTILE for label in labels])
    every = np.sort(np.concatenate([null, observed[None]]), axis=0)
    places = np.minimum((shares * len(every)).astype(int), len(null) - 1)
    bars = np.maximum(every[places, range(len(labels))], 0.0)
    return float((observed - bars)[family].max()), (null - bars)[:, family].max(axis=1)


class _Trial:
    """The gain of the best candidates beside one model, in the poses' responses and in many of noise."""

    def __init__(
        self,
        r: Responses,
        columns_with: Callable[[Sequence[Candidate]], FloatArray],
        candidates: Sequence[Candidate],
        noise: NoiseModel,
    ) -> None:
        self._r, self._columns_with, self._candidates, self._noise = r, columns_with, candidates, noise
        self._model = columns_with(())
        self.screen = Screen(r, self._model, candidates, noise)
        self._penalties = np.log(len(r)) * np.array([c.parameters for c in candidates])
        by_form: dict[tuple[str, str], list[int]] = {}
        for index, candidate in enumerate(candidates):
            by_form.setdefault((candidate.label, candidate.shape.form), []).append(index)
        self.labels = list(dict.fromkeys(label for label, _ in by_form))
        self._forms = [np.array(indices) for indices in by_form.values()]
        self._label_of = np.array([self.labels.index(label) for label, _ in by_form])
        self._replacing = np.array([c.shape.replaces is not None for c in candidates])
        self._drawn = DrawnFits(r, columns_with, candidates, noise)

    def observed(self, ratios: Float32Array) -> tuple[FloatArray, Fit]:
        """(L,) gains of the poses' own responses by the best candidate of each name, and the best fit.

        Every form of every effect is fitted: the screen has the null's noise, in which a large effect is half
        hidden, and favours forms that say too little.
        """
        labels, candidates = self._leaders(ratios, len(self._forms))
        values = self._r.values[None]
        null = fits(self._r, values, self._model[None]).criterion
        many = np.repeat(values, candidates.shape[1], axis=0)
        fitted = fits(self._r, many, self._columns(candidates.ravel()))
        gains = self._gains(labels, candidates, null, fitted.criterion, self._own(fitted.beta, candidates))
        best = int(np.argmin(fitted.criterion + self._penalties[candidates[0]]))
        noise = NoiseModel(fitted.rotation[best], fitted.rho[best])
        parts = fitted.beta[best], fitted.covariance[best], fitted.residuals[best]
        return gains[0], Fit(*parts, noise, float(fitted.criterion[best]))

    def gains_of_noise(self, values: FloatArray) -> FloatArray:
        """(b, L) the same in sets of responses (b, n, J) drawn from the noise.

        There the screen is right: the forms that lead on it reach what all would (`LEADERS`).
        """
        labels, candidates = self._leaders(self.screen.ratios(values), LEADERS)
        null = self._drawn.null(values)
        return self._gains(labels, candidates, null, *self._drawn.beside(values, candidates))

    def _own(self, beta: FloatArray, candidates: Intp) -> list[FloatArray]:
        """The candidates' own coefficients among those of their models (b·k, p)."""
        first = self._model.shape[2] - self._replacing[candidates.ravel()]
        return [one[at:] for one, at in zip(beta, first.tolist(), strict=True)]

    def _gains(
        self,
        labels: Intp,
        candidates: Intp,
        null: FloatArray,
        criterion: FloatArray,
        own: Sequence[FloatArray],
    ) -> FloatArray:
        """(b, L) reductions of −2 log likelihood, less penalties, by the best candidate of each name.

        Minus infinity for names that do not lead on the screen, and for what physics rules out.
        """
        possible = [
            self._candidates[k].is_possible(beta)
            for k, beta in zip(candidates.ravel().tolist(), own, strict=True)
        ]
        gained = null[:, None] - criterion.reshape(labels.shape) - self._penalties[candidates]
        gains = np.full((len(labels), len(self.labels)), -np.inf)
        reached = np.where(np.reshape(possible, labels.shape), gained, -np.inf)
        np.maximum.at(gains, (np.arange(len(labels))[:, None], labels), reached)
        return gains

    def _leaders(self, ratios: Float32Array, most: int) -> tuple[Intp, Intp]:
        """(b, k) the best candidates of the forms that lead on the screen, after their labels."""
        penalised = ratios - self._penalties
        best = np.stack([indices[penalised[:, indices].argmax(axis=1)] for indices in self._forms], axis=1)
        scores = np.take_along_axis(penalised, best, axis=1)
        leading = np.argsort(-scores, axis=1, kind="stable")[:, :most]
        return self._label_of[leading], np.take_along_axis(best, leading, axis=1)

    def _columns(self, chosen: Intp) -> FloatArray:
        """(m, n, J, p) of the model with each of the chosen candidates; narrower ones end in zeros."""
        kinds, of_kind = np.unique(chosen, return_inverse=True)
        each = side_by_side([self._columns_with([self._candidates[k]]) for k in kinds])
        return np.asarray(each[of_kind.ravel()], dtype=np.float64)


def _resampled(
    r: Responses, alternative: Fit, noise: NoiseModel, rng: np.random.Generator, count: int
) -> FloatArray:
    """(count, n, J) responses of noise alone: innovations that the alternative leaves, coloured as the null.

    All channels of a pose are drawn together with one sign, so that tails and what channels share stay.
    """
    innovations = alternative.noise.whiten(alternative.residuals, r.starts)
    innovations = innovations - innovations.mean(axis=0)
    size = np.sqrt((innovations**2).mean(axis=0))
    innovations = np.divide(innovations, size, out=np.ones_like(innovations), where=size > 0.0)
    drawn = innovations[rng.integers(0, len(r), (count, len(r)))]
    drawn = drawn * rng.choice(np.array([-1.0, 1.0]), (count, len(r), 1))
    return np.asarray(noise.colour(drawn, r.starts) * r.known, dtype=np.float64)
