"""Family-wise significance test of a search: the bootstrap of the maximum gain over all candidates.

Searching a catalogue and keeping what lowers a criterion finds an effect in pure noise in 19–45 % of cases.
The maximum over all candidates holds its rate: its distribution is bootstrapped under the current model for
these very poses. Candidates that are declared to accompany an effect in the model are a family of their own.

The statistic is the gain of the best candidates in full likelihood, coefficients and noise fitted again with
each of them, less the penalties. With the noise of the null a large effect would be taken for a correlation
of 0.95 between poses and for innovations with heavy tails. So a candidate is tested with the noise that it
leaves, and the bootstrap draws its innovations from there; their correlation stays the null's, because slow
noise looks like slow effects.

The folds of a cross-validation reuse the null distribution of all poses, and draw their own only where it
leaves a decision open. Where a search refuses the best candidate and asks again, the same draws serve.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidate_fits import fit_candidates
from calrig.calibration.diagnosis.candidates import Candidate
from calrig.calibration.diagnosis.drawn_fits import DrawnFits
from calrig.calibration.diagnosis.screen import Float32Array, Screen
from calrig.calibration.effects import UNNAMED
from calrig.calibration.regression.noise_model import (
    STRONG_RHO,
    Fit,
    NoiseModel,
    fit,
    noise_of,
)
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import BoolArray, FloatArray

QUANTILE, UNNAMED_QUANTILE = 0.98, 0.995
"""Of what a name gains from noise, where its own bar lies: an effect that has a name is likelier beforehand
than a shape that has none, and four times as much of the error rate is spent on it. So a scan of a hundred
instants does not raise the bar for an effect of one parameter.
"""
UNLIKELY = 1e-3
"""Chance that draws known already tell wrongly on which side of the level a p-value lies."""


class FamilyTest:
    """The best of each family against searches of noise (b, L).

    Attributes:
        best, exceeded: of each family, by how much it exceeds its bar, and how many searches do so by more.
        ahead: of the largest of noise, the family that is farthest.
        p_value: of the family that is rarer in noise.
    """

    def __init__(
        self,
        labels: Sequence[str],
        observed: FloatArray,
        null: FloatArray,
        families: Sequence[BoolArray],
    ) -> None:
        judged = [_above_bars(labels, observed, null, family) for family in families]
        self.best = np.array([best for best, _ in judged])
        self.exceeded = np.array([(of_noise >= best).sum() for best, of_noise in judged])
        self.ahead = max(
            best - float(of_noise.max()) if np.isfinite(best) else -np.inf for best, of_noise in judged
        )
        self.p_value = (1 + int(self.exceeded.min())) / (1 + len(null))
        self._draws = len(null)

    def passes(self, level: float, margin: float, bootstraps: int) -> bool | None:
        """Return whether the p-value is below a level; None where so many searches of noise leave that open.

        `margin` is by how much to be ahead of all of them is clear; so many `bootstraps` are enough to take
        the p-value as it is.
        """
        from scipy.special import bdtr, bdtrc

        if self.ahead > margin:
            return True
        exceeded = self.exceeded.min()
        if self._draws >= bootstraps:
            return self.p_value <= level
        if bdtr(exceeded, self._draws, level) < UNLIKELY:
            return True
        return False if bdtrc(exceeded - 1, self._draws, level) < UNLIKELY else None


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


FEWEST = 24
"""Draws to be told anything by."""
OTHER_RHO = 0.2
"""By how much the correlation of a fold's noise may be another: the bars for slow effects grow with it."""


class NullGains(NamedTuple):
    """Null distribution of candidate gains, bootstrapped once on all poses and reused by the folds' searches.

    Attributes:
        labels: of the L candidates.
        gains: (b, L) of the best candidate of each label, in −2 log likelihood with penalties.
        rho: the largest correlation of the noise.
    """

    labels: tuple[str, ...]
    gains: FloatArray
    rho: float

    def of(self, labels: Sequence[str], noise: NoiseModel) -> FloatArray | None:
        """Return (b, l) those of some labels; None where they do not tell what a noise gains there."""
        places = {label: k for k, label in enumerate(self.labels)}
        other = abs(max(float(noise.rho.max()), 0.0) - max(self.rho, 0.0))
        if len(self.gains) < FEWEST or other > OTHER_RHO:
            return None
        if not places.keys() >= set(labels):
            return None
        return self.gains[:, [places[label] for label in labels]]


ModelKey = tuple[tuple[str, ...], frozenset[str]]
"""The columns of its base by name, and the labels of the effects in it."""
Noises = Mapping[ModelKey, NullGains]


def model_of(r: Responses, accepted: Sequence[Candidate]) -> ModelKey:
    """Return what a model has in common with that of more poses."""
    return r.base_names, frozenset(c.label for c in accepted)


Intp = npt.NDArray[np.intp]
LEADERS = 16
"""Forms of effects whose full likelihood is taken in a draw of noise, those that lead on the screen: to the
upper tenth of draws the best gain is the same as of all forms, of 52 poses and of 100.
"""
FIRST_DRAWS, MORE_DRAWS = 24, 49
FEWEST_DRAWS = 99
FEW_DRAWS, FAR, NEAR = 8, 40.0, 10.0
"""Of −2 log likelihood: beyond the largest of so few draws by `FAR`, what noise comes nowhere near. Of the
draws that follow only those are fitted that the screen takes half as far; and where noise is not strongly
correlated, those that it takes to within `NEAR`: of 1,000 draws none to two gain 10 more than it says.
"""
HOPELESS = -2.0
"""Of −2 log likelihood less penalties: a form that the screen takes less far in noise reaches no bar."""
CLEAR_SHARE = 5
CLEAR, CLEAR_AT_FIRST = 10.0, 15.0
"""Of −2 log likelihood, beyond the largest of a fifth of all draws: the rest would not reach it either. Nor
would one in a hundred where few were drawn: over 10 a χ² of one degree of freedom falls by a factor of 150 or
more, over 15 by one of 1,800.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Result of the significance test of one search.

    Attributes:
        candidates: everything the search looked at.
        ratios: the likelihood ratio of each on the screen.
        gain: of the best candidate, in −2 log likelihood with penalties.
        p_value: family-wise, of the best candidate.
        passes: whether the p-value is below the level, or clearly would be with more draws.
        least_p_value: the smallest that all draws could give.
        drawn: the null distribution drawn for the test; None where it was known.
        trial: of all candidates that were tested with this model, for a test of fewer of them.
    """

    candidates: Sequence[Candidate]
    ratios: Float32Array
    gain: float
    p_value: float
    passes: bool
    least_p_value: float
    drawn: NullGains | None = None
    trial: Trial | None = None


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
    known: NullGains | None = None,
    decide_only: bool = False,
    earlier: Trial | None = None,
) -> Verdict:
    """Judge the best of all candidates against its distribution under the current model.

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
        known: what noise gained beside the same effects in more poses, asked before any is drawn.
        decide_only: whether the p-value is of no interest where it is clear that it lies below the level.
        earlier: of the same model, with these candidates and others that have been refused since.
    """
    least = 1.0 / (bootstraps + 1)
    if not candidates:
        return Verdict(candidates, np.empty(0, dtype=np.float32), 0.0, 1.0, level >= 1.0, least)
    model = columns_with(())
    if noise is None:
        noise = noise_of(fitted.residuals, r, max(1.0, model.shape[2] / len(r.channels)))
    by_known = known and known.of(tuple({c.label: None for c in candidates}), noise)
    if earlier is None:
        trial = Trial(r, columns_with, candidates, noise, fitted.residuals, draws=by_known is None)
    else:
        trial = earlier.among({c.label for c in candidates})
    labels, offered = trial.labels, trial.offered
    families = [family & offered for family in (trial.are(companions), ~trial.are(companions))]
    families = [family for family in families if family.any()]
    candidates, ratios = trial.candidates, trial.ratios
    clear_after = max(FEWEST_DRAWS, round(1.0 / level) - 1, bootstraps // CLEAR_SHARE)
    if by_known is not None:
        those, of_those = [label for label, is_in in zip(labels, offered, strict=True) if is_in], offered
        own = [family[of_those] for family in families]
        margin = CLEAR if len(by_known) >= clear_after else CLEAR_AT_FIRST
        led = trial.leading()
        judged = FamilyTest(those, led[of_those], by_known, own)
        if judged.ahead > margin:
            return Verdict(candidates, ratios, float(led.max()), judged.p_value, True, least, trial=trial)
        judged = FamilyTest(those, trial.observed[0][of_those], by_known, own)
        passes = judged.passes(level, margin, bootstraps)
        if passes is not None:
            gain = float(trial.observed[0].max())
            return Verdict(candidates, ratios, gain, judged.p_value, passes, least, trial=trial)
    observed, alternative = trial.observed
    most = level * (bootstraps + 1)
    least_gain = -np.inf
    if trial.draws:  # what they tell of the candidates that are left, before any more is fitted
        least_gain = _worth_fitting(FamilyTest(labels, observed, trial.null(np.inf), families), trial, most)
    steps = {min(step, bootstraps) for step in (FIRST_DRAWS, MORE_DRAWS, clear_after, 2 * clear_after)}
    for values in _drawn(r, alternative, noise, rng, sorted({*steps, bootstraps}), trial.draws):
        trial.draw(values)
        null = trial.null(least_gain)
        draws = len(null)
        judged = FamilyTest(labels, observed, null, families)
        margin = FAR if draws < FIRST_DRAWS else CLEAR_AT_FIRST if draws == FIRST_DRAWS else CLEAR
        is_clear = (decide_only or draws >= min(clear_after, bootstraps)) and judged.ahead > margin
        if is_clear or judged.exceeded.min() >= most:
            break
        least_gain = _worth_fitting(judged, trial, most)
    passes = is_clear or judged.p_value <= level
    drawn = NullGains(labels, null, float(noise.rho.max()))
    return Verdict(candidates, ratios, float(observed.max()), judged.p_value, passes, least, drawn, trial)


def _worth_fitting(judged: FamilyTest, trial: Trial, most: float) -> float:
    """Return the least gain on the screen of a draw that may still change a decision.

    At `most` so many searches of noise may exceed the best of a family.
    """
    yet_to_tell = judged.best[judged.exceeded < most]
    lowest = float(yet_to_tell.min() if len(yet_to_tell) else judged.best.min())
    least_gain = lowest / 2.0 if judged.ahead > FAR else -np.inf
    if trial.draws >= FIRST_DRAWS and trial.noise.rho.max() < STRONG_RHO:
        least_gain = max(least_gain, lowest - NEAR)
    return least_gain


class Trial:
    """The gain of the best candidates beside one model, in the poses' responses and in many of noise."""

    def __init__(
        self,
        r: Responses,
        columns_with: Callable[[Sequence[Candidate]], FloatArray],
        candidates: Sequence[Candidate],
        noise: NoiseModel,
        residuals: FloatArray,
        *,
        draws: bool,
    ) -> None:
        self._r, self._columns_with, self._candidates = r, columns_with, candidates
        self.noise = noise
        self._model = columns_with(())
        self.screen = Screen(r, self._model, candidates, noise)
        self._ratios = self.screen.ratios(residuals[None]) if draws else self.screen.once(residuals)[None]
        self._penalties = np.log(len(r)) * np.array([c.parameters for c in candidates])
        by_form: dict[tuple[str, str], list[int]] = {}
        for index, candidate in enumerate(candidates):
            by_form.setdefault((candidate.label, candidate.shape.form), []).append(index)
        self.labels = tuple(dict.fromkeys(label for label, _ in by_form))
        self._forms = [np.array(indices) for indices in by_form.values()]
        self._label_of = np.array([self.labels.index(label) for label, _ in by_form])
        self.offered = np.ones(len(self.labels), dtype=bool)
        self._noises: list[_OfNoise] = []

    def among(self, labels: Collection[str]) -> Trial:
        """Return the trial of the candidates of some labels; what was drawn and fitted serves both."""
        fewer = copy(self)
        fewer.offered = self.are(labels)
        return fewer

    @property
    def candidates(self) -> list[Candidate]:
        """Those of the labels that are offered."""
        return [self._candidates[k] for k in self._places]

    @property
    def ratios(self) -> Float32Array:
        """Their likelihood ratios on the screen."""
        return np.asarray(self._ratios[0, self._places])

    @property
    def _places(self) -> Intp:
        offered = {label for label, is_in in zip(self.labels, self.offered, strict=True) if is_in}
        return np.flatnonzero([c.label in offered for c in self._candidates])

    @property
    def draws(self) -> int:
        """How many sets of responses have been drawn."""
        return sum(len(some.values) for some in self._noises)

    @cached_property
    def _drawn(self) -> DrawnFits:
        return DrawnFits(self._r, self._columns_with, self._candidates, self.noise)

    def are(self, some: Collection[str]) -> BoolArray:
        """Return (L,) which of the labels are among some."""
        return np.array([label in some for label in self.labels])

    def leading(self) -> FloatArray:
        """(L,) the gain of the one candidate that leads on the screen; minus infinity of all other names."""
        chosen, scores = self._best_of_forms(self._ratios)
        form = int(self._leading(scores)[0, 0])
        best = chosen[:, form]
        null = np.array([fit(self._r, self._model).criterion])
        with_it = fit(self._r, self._columns_with([self._candidates[best[0]]]))
        own = with_it.beta[-self._candidates[best[0]].columns.shape[2] :]
        gains = np.full(len(self.labels), -np.inf)
        gains[self._label_of[form]] = self._gained(best, null, np.array([with_it.criterion]), [own])[0]
        return gains

    @cached_property
    def _fits_of_forms(self) -> tuple[FloatArray, FloatArray, Intp]:
        """(F,) gains of the poses' own responses by the best candidate of each form, criteria, and those.

        Every form of every effect is fitted: the screen has the null's noise, in which a large effect is half
        hidden, and favours forms that say too little.
        """
        chosen = self._best_of_forms(self._ratios)[0][0]
        candidates = [self._candidates[k] for k in chosen]
        null = np.array([fit(self._r, self._model).criterion])
        fitted = fit_candidates(self._r, self._columns_with, candidates)
        own = [beta[-c.columns.shape[2] :] for beta, c in zip(fitted.beta, candidates, strict=True)]
        gained = self._gained(chosen, null, fitted.criterion, own)
        return gained, fitted.criterion + self._penalties[chosen], chosen

    @property
    def observed(self) -> tuple[FloatArray, Fit]:
        """(L,) gains of the poses' own responses by the best candidate of each name, and the best fit."""
        gained, penalised, chosen = self._fits_of_forms
        best = int(np.where(self.offered[self._label_of], penalised, np.inf).argmin())
        fitted = fit(self._r, self._columns_with([self._candidates[chosen[best]]]))
        return np.where(self.offered, self._of_labels(gained[None])[0], -np.inf), fitted

    def draw(self, values: FloatArray) -> None:
        """Add sets of responses (b, n, J) drawn from the noise; nothing of none."""
        if len(values):
            chosen, scores = self._best_of_forms(self.screen.ratios(values))
            self._noises.append(_OfNoise(values, chosen, scores, np.full(scores.shape, np.nan)))

    def null(self, least_gain: float) -> FloatArray:
        """Return (b, L) gains in all sets of responses that were drawn.

        There the screen is right: the forms that lead on it reach what all would (`LEADERS`). What it says
        will do of all others, of those that it takes nowhere, and where it takes none as far as some least
        gain.
        """
        return np.concatenate([self._gains(some, least_gain) for some in self._noises])

    def _gains(self, some: _OfNoise, least_gain: float) -> FloatArray:
        leading = self._leading(some.scores)[:, :LEADERS]
        scores = np.take_along_axis(some.scores, leading, axis=1)
        is_fitted = ~np.isnan(np.take_along_axis(some.gained, leading, axis=1))
        drawn, place = np.nonzero((scores > HOPELESS) & (scores[:, :1] >= least_gain) & ~is_fitted)
        if len(drawn):
            forms = leading[drawn, place]
            chosen = some.chosen[drawn, forms]
            which, at = np.unique(drawn, return_inverse=True)
            values = some.values[which]
            null = self._drawn.null(values)[at]
            some.gained[drawn, forms] = self._gained(chosen, null, *self._drawn.beside(values, at, chosen))
        return self._of_labels(np.where(np.isnan(some.gained), some.scores, some.gained))

    def _gained(
        self, chosen: Intp, null: FloatArray, criterion: FloatArray, own: Sequence[FloatArray]
    ) -> FloatArray:
        """Return (m,) reductions of −2 log likelihood, less penalties, by some candidates (m,).

        Minus infinity where physics rules them out.
        """
        gained = np.asarray(null - criterion - self._penalties[chosen])
        for k in np.flatnonzero(gained > 0.0).tolist():
            if not self._candidates[chosen[k]].is_possible(own[k]):
                gained[k] = -np.inf
        return gained

    def _of_labels(self, gained: FloatArray) -> FloatArray:
        """Return (b, L) the largest of each label's gains (b, F)."""
        gains = np.full((len(gained), len(self.labels)), -np.inf)
        np.maximum.at(gains, (np.arange(len(gained))[:, None], self._label_of), gained)
        return gains

    def _best_of_forms(self, ratios: Float32Array) -> tuple[Intp, FloatArray]:
        """(b, F) the best candidate of each form on the screen, and its gain there."""
        penalised = ratios - self._penalties
        best = np.stack([indices[penalised[:, indices].argmax(axis=1)] for indices in self._forms], axis=1)
        return best, np.take_along_axis(penalised, best, axis=1)

    def _leading(self, scores: FloatArray) -> Intp:
        """Return (b, F) the forms that are offered in the order of their gains (b, F), then all others."""
        offered = self.offered[self._label_of]
        return np.argsort(np.where(offered, -scores, np.inf), axis=1, kind="stable")[:, : offered.sum()]


class _OfNoise(NamedTuple):
    """Sets of responses (b, n, J) drawn from noise, and what each form gains in them.

    Of each form (b, F) the candidate that leads on the screen, its gain there, and its gain where it has been
    fitted, else NaN.
    """

    values: FloatArray
    chosen: Intp
    scores: FloatArray
    gained: FloatArray


def _drawn(
    r: Responses,
    alternative: Fit,
    noise: NoiseModel,
    rng: np.random.Generator,
    steps: Sequence[int],
    before: int,
) -> Iterator[FloatArray]:
    """(b, n, J) responses of noise alone, as many in all as each step says, few of the first beforehand.

    Where there are some from before, none at first: they may be enough.
    """
    if before:
        yield np.empty((0, *r.values.shape))
    for draws in (step for step in steps if step > before):
        values = _resampled(r, alternative, noise, rng, draws - before)
        yield from np.split(values, [FEW_DRAWS]) if before == 0 else (values,)
        before = draws


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
