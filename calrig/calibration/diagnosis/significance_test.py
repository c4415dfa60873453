"""Family-wise significance test of a search: the bootstrap of the maximum gain over all candidates.

Searching a catalogue and keeping what lowers a criterion finds an effect in pure noise in 19–45 % of cases.
The maximum over all candidates holds its rate: its distribution is bootstrapped under the current model for
these very poses. Candidates that are declared to accompany an effect in the model are a family of their own.

The statistic is the gain of the best candidates in full likelihood, coefficients and noise fitted again with
each of them, less the penalties. With the noise of the null a large effect would be taken for a correlation
of 0.95 between poses and for innovations with heavy tails. So a candidate is tested with the noise that it
leaves, and the bootstrap draws its innovations from there; their correlation stays the null's, because slow
noise looks like slow effects.

The noise of the draws is known, so that one orthonormal set of columns serves all of them (Frisch & Waugh,
Econometrica 1, 1933). The folds of a cross-validation reuse the null distribution of all poses, and draw
their own only where it leaves a decision open.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidate_fits import fit_candidates
from calrig.calibration.diagnosis.candidates import Candidate
from calrig.calibration.diagnosis.screen import Float32Array, Screen
from calrig.calibration.effects import UNNAMED
from calrig.calibration.regression.channels import BoolArray
from calrig.calibration.regression.noise_model import (
    STRONG_RHO,
    Fit,
    NoiseModel,
    RepeatedSteps,
    fit,
    lagged_products,
    noise_of,
    orthonormal,
)
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

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

        Args:
            level: of the decision.
            margin: by how much to be ahead of all of them is clear.
            bootstraps: how many are enough to take the p-value as it is.
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
BATCH = 32
"""Responses at a time: what belongs to them then stays in the processor's cache."""


class DrawnFits:
    """A model's criterion in responses drawn from a noise, alone and beside each of some candidates.

    Args:
        r: the responses, for what their poses have in common.
        columns_with: (n, J, p) columns of the model with some candidates beside it.
        candidates: those that may be.
        noise: that the responses are drawn from.
    """

    def __init__(
        self,
        r: Responses,
        columns_with: Callable[[Sequence[Candidate]], FloatArray],
        candidates: Sequence[Candidate],
        noise: NoiseModel,
    ) -> None:
        self._candidates = candidates
        self._models = {"": _Model(r, columns_with(()), noise)}
        for c in candidates:
            if c.shape.replaces and c.shape.replaces not in self._models:
                base = columns_with((c,))[:, :, : -c.columns.shape[2]]
                self._models[c.shape.replaces] = _Model(r, base, noise)
        self._kind_of = [(c.columns.shape[2], c.shape.replaces or "") for c in candidates]

    def null(self, values: FloatArray) -> FloatArray:
        """Return (b,) criterion of the model alone in responses (b, n, J)."""
        return self._models[""].alone(values)

    def beside(self, values: FloatArray, drawn: Intp, chosen: Intp) -> tuple[FloatArray, list[FloatArray]]:
        """Return (m,) criterion in some responses of (b, n, J), each beside a chosen candidate.

        And these candidates' own coefficients. The responses' places `drawn` (m,) are in their order.
        """
        flat = chosen.tolist()
        criterion = np.empty(len(flat))
        own: list[FloatArray] = [np.empty(0)] * len(flat)
        for first in range(0, len(values), BATCH):
            alike: dict[tuple[int, str], list[int]] = {}
            for pair in range(*np.searchsorted(drawn, [first, first + BATCH]).tolist()):
                alike.setdefault(self._kind_of[flat[pair]], []).append(pair)
            for (_, replaced), pairs in alike.items():
                kinds = [flat[pair] for pair in pairs]
                criterion[pairs], betas = self._models[replaced].beside(
                    values[first : first + BATCH],
                    drawn[pairs] - first,
                    kinds,
                    {k: self._candidates[k] for k in kinds},
                )
                for pair, beta in zip(pairs, betas, strict=True):
                    own[pair] = beta
        return criterion, own


class _Columns(NamedTuple):
    """Columns in rows (…, p, n·J), orthonormal once whitened: `white`, and `plain`, as they were before that.

    Coefficients of the columns that they were made of are those of these times `turn` (…, p, p).
    """

    white: FloatArray
    plain: FloatArray
    turn: FloatArray


class _Model:
    """One model (n, J, p) in one noise, and what it leaves of the candidates that were beside it so far."""

    def __init__(self, r: Responses, model: FloatArray, noise: NoiseModel) -> None:
        self._r, self._noise, self._width = r, noise, model.shape[2]
        white, plain = self._rows(model[None])
        base = _orthonormal(white, plain, np.linalg.norm(white, axis=2))
        self._base = _Columns(*(one[0] for one in base))
        self._made: dict[int, _Columns] = {}
        self._again = None
        if noise.rho.max() >= STRONG_RHO:
            self._again = RepeatedSteps(r, self._base.plain[np.any(self._base.plain != 0.0, axis=1)])

    def alone(self, values: FloatArray) -> FloatArray:
        """Return (b,) criterion in responses (b, n, J)."""
        left = self._left(values, self._white(values))
        nothing = np.empty((1, 0, left.shape[1]))
        return self._criterion(left, nothing, np.zeros(len(left), dtype=np.intp))[0]

    def beside(
        self, values: FloatArray, drawn: Intp, kinds: Sequence[int], candidates: dict[int, Candidate]
    ) -> tuple[FloatArray, FloatArray]:
        """Return (m,) criterion and (m, w) coefficients of one candidate each, all of one width.

        Args:
            values: (b, n, J) responses.
            drawn: (m,) which of them.
            kinds: (m,) which of the candidates, by their keys.
            candidates: those.
        """
        new = [k for k in candidates if k not in self._made]
        if new:
            self._made.update(zip(new, self._orthonormal([candidates[k] for k in new]), strict=True))
        white = self._white(values)
        place = {k: at for at, k in enumerate(candidates)}
        at = np.array([place[k] for k in kinds])
        of_white, of_plain, turn = (
            np.stack(one) for one in zip(*(self._made[k] for k in candidates), strict=True)
        )
        inside = of_white[at] @ white[drawn][:, :, None]
        left = self._left(values, white)[drawn] - (np.swapaxes(inside, 1, 2) @ of_plain[at])[:, 0]
        criterion, more = self._criterion(left, of_plain, at)
        return criterion, (turn[at] @ (inside + more[:, :, None]))[:, :, 0]

    def _orthonormal(self, candidates: Sequence[Candidate]) -> list[_Columns]:
        """Candidates of one width, beside the model."""
        white, plain = self._rows(np.stack([c.columns for c in candidates]))
        inside = white @ self._base.white.T
        size = np.linalg.norm(white, axis=2)
        made = _orthonormal(white - inside @ self._base.white, plain - inside @ self._base.plain, size)
        return [_Columns(*one) for one in zip(*made, strict=True)]

    def _white(self, values: FloatArray) -> FloatArray:
        """Return (…, n·J) responses or columns (…, n, J) whitened."""
        return self._noise.whiten(values, self._r.starts).reshape(*values.shape[:-2], -1)

    def _left(self, values: FloatArray, white: FloatArray) -> FloatArray:
        """Return (b, n·J) what the model leaves of responses (b, n, J), by themselves and whitened."""
        return np.asarray(values.reshape(white.shape) - (white @ self._base.white.T) @ self._base.plain)

    def _criterion(self, left: FloatArray, beside: FloatArray, at: Intp) -> tuple[FloatArray, FloatArray]:
        """Return (m,) of what one step leaves (m, n·J), and (m, w) what further steps add to coefficients.

        Of those columns (k, w, n·J) that it was fitted beside, by their places `at` (m,).
        """
        width = beside.shape[1]
        taken = max(1.0, (self._width + width) / len(self._r.channels))
        if self._again is not None:
            steps = self._again.steps(left, beside, at, taken)
            return steps.products.criterion(*steps.products.noises(taken)), steps.more
        products = lagged_products(left.reshape(-1, *self._r.values.shape), self._r.starts, self._r.rounding)
        return products.criterion(*products.noises(taken)), np.zeros((len(left), width))

    def _rows(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return columns (m, n, J, p) whitened and as they are, in rows (m, p, n·J)."""
        rows = np.moveaxis(columns, 3, 1)
        return self._white(rows), rows.reshape(*rows.shape[:2], -1)


def _orthonormal(white: FloatArray, plain: FloatArray, size: FloatArray) -> _Columns:
    """Of rows (m, p, n·J), of sizes (m, p) before others were taken off them."""
    turn = orthonormal(white @ np.swapaxes(white, 1, 2), size)
    across = np.swapaxes(turn, 1, 2)
    return _Columns(across @ white, across @ plain, turn)


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


@dataclass(frozen=True, slots=True)
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
    """

    candidates: Sequence[Candidate]
    ratios: Float32Array
    gain: float
    p_value: float
    passes: bool
    least_p_value: float
    drawn: NullGains | None = None


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
    """
    least = 1.0 / (bootstraps + 1)
    if not candidates:
        return Verdict(candidates, np.empty(0, dtype=np.float32), 0.0, 1.0, level >= 1.0, least)
    model = columns_with(())
    if noise is None:
        noise = noise_of(fitted.residuals, r, max(1.0, model.shape[2] / len(r.channels)), unbiased=True)
    labels = tuple(dict.fromkeys(c.label for c in candidates))
    by_known = known and known.of(labels, noise)
    trial = _Trial(r, columns_with, candidates, noise, fitted.residuals, draws=by_known is None)
    families = [family for family in (trial.are(companions), ~trial.are(companions)) if family.any()]
    ratios = trial.ratios[0]
    clear_after = max(FEWEST_DRAWS, round(1.0 / level) - 1, bootstraps // CLEAR_SHARE)
    if by_known is not None:
        margin = CLEAR if len(by_known) >= clear_after else CLEAR_AT_FIRST
        led = trial.leading()
        judged = FamilyTest(labels, led, by_known, families)
        if judged.ahead > margin:
            return Verdict(candidates, ratios, float(led.max()), judged.p_value, True, least)
        judged = FamilyTest(labels, trial.observed[0], by_known, families)
        passes = judged.passes(level, margin, bootstraps)
        if passes is not None:
            gain = float(trial.observed[0].max())
            return Verdict(candidates, ratios, gain, judged.p_value, passes, least)
    observed, alternative = trial.observed
    null, least_gain = np.empty((0, len(observed))), -np.inf
    steps = {min(step, bootstraps) for step in (FIRST_DRAWS, MORE_DRAWS, clear_after, 2 * clear_after)}
    for values in _drawn(r, alternative, noise, rng, sorted({*steps, bootstraps})):
        null = np.concatenate([null, trial.gains_of_noise(values, least_gain)])
        draws = len(null)
        judged = FamilyTest(labels, observed, null, families)
        margin = FAR if draws < FIRST_DRAWS else CLEAR_AT_FIRST if draws == FIRST_DRAWS else CLEAR
        is_clear = (decide_only or draws >= min(clear_after, bootstraps)) and judged.ahead > margin
        most = level * (bootstraps + 1)
        if is_clear or judged.exceeded.min() >= most:
            break
        # of either family that the draws have yet to tell
        lowest = judged.best[judged.exceeded < most].min()
        least_gain = lowest / 2.0 if judged.ahead > FAR else -np.inf
        if draws >= FIRST_DRAWS and noise.rho.max() < STRONG_RHO:
            least_gain = max(least_gain, lowest - NEAR)
    passes = is_clear or judged.p_value <= level
    drawn = NullGains(labels, null, float(noise.rho.max()))
    return Verdict(candidates, ratios, float(observed.max()), judged.p_value, passes, least, drawn)


class _Trial:
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
        self._r, self._columns_with, self._candidates, self._noise = r, columns_with, candidates, noise
        self._model = columns_with(())
        self.screen = Screen(r, self._model, candidates, noise)
        self.ratios = self.screen.ratios(residuals[None]) if draws else self.screen.once(residuals)[None]
        self._penalties = np.log(len(r)) * np.array([c.parameters for c in candidates])
        by_form: dict[tuple[str, str], list[int]] = {}
        for index, candidate in enumerate(candidates):
            by_form.setdefault((candidate.label, candidate.shape.form), []).append(index)
        self.labels = list(dict.fromkeys(label for label, _ in by_form))
        self._forms = [np.array(indices) for indices in by_form.values()]
        self._label_of = np.array([self.labels.index(label) for label, _ in by_form])

    @cached_property
    def _drawn(self) -> DrawnFits:
        return DrawnFits(self._r, self._columns_with, self._candidates, self._noise)

    def are(self, some: Collection[str]) -> BoolArray:
        """Return (L,) which of the labels are among some."""
        return np.array([label in some for label in self.labels])

    def leading(self) -> FloatArray:
        """(L,) the gain of the one candidate that leads on the screen; minus infinity of all other names."""
        labels, chosen, _ = self._leaders(self.ratios, 1)
        null = np.array([fit(self._r, self._model).criterion])
        with_it = fit(self._r, self._columns_with([self._candidates[chosen[0, 0]]]))
        own = with_it.beta[-self._candidates[chosen[0, 0]].columns.shape[2] :]
        gained = self._gained(chosen[0], null, np.array([with_it.criterion]), [own])
        return np.asarray(self._of_labels(labels, gained[None])[0], dtype=np.float64)

    @cached_property
    def observed(self) -> tuple[FloatArray, Fit]:
        """(L,) gains of the poses' own responses by the best candidate of each name, and the best fit.

        Every form of every effect is fitted: the screen has the null's noise, in which a large effect is half
        hidden, and favours forms that say too little.
        """
        labels, chosen, _ = self._leaders(self.ratios, len(self._forms))
        candidates = [self._candidates[k] for k in chosen[0]]
        null = np.array([fit(self._r, self._model).criterion])
        fitted = fit_candidates(self._r, self._columns_with, candidates)
        own = [beta[-c.columns.shape[2] :] for beta, c in zip(fitted.beta, candidates, strict=True)]
        gains = self._of_labels(labels, self._gained(chosen[0], null, fitted.criterion, own)[None])
        best = candidates[int(np.argmin(fitted.criterion + self._penalties[chosen[0]]))]
        return gains[0], fit(self._r, self._columns_with([best]))

    def gains_of_noise(self, values: FloatArray, least_gain: float) -> FloatArray:
        """Return (b, L) the same in sets of responses (b, n, J) drawn from the noise.

        There the screen is right: the forms that lead on it reach what all would (`LEADERS`). What it says
        will do of those that it takes nowhere, and where it takes none as far as some least gain.
        """
        labels, candidates, scores = self._leaders(self.screen.ratios(values), LEADERS)
        gains = self._of_labels(labels, scores)
        may = scores[:, 0] >= least_gain
        if may.any():
            values, labels, candidates, scores = values[may], labels[may], candidates[may], scores[may]
            drawn, place = np.nonzero(scores > HOPELESS)
            chosen, null = candidates[drawn, place], self._drawn.null(values)[drawn]
            scores[drawn, place] = self._gained(chosen, null, *self._drawn.beside(values, drawn, chosen))
            gains[may] = self._of_labels(labels, scores)
        return gains

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

    def _of_labels(self, labels: Intp, gained: FloatArray) -> FloatArray:
        """Return (b, L) the largest of each label's gains (b, k); minus infinity where it has none."""
        gains = np.full((len(labels), len(self.labels)), -np.inf)
        np.maximum.at(gains, (np.arange(len(labels))[:, None], labels), gained)
        return gains

    def _leaders(self, ratios: Float32Array, most: int) -> tuple[Intp, Intp, FloatArray]:
        """(b, k) labels, candidates and screened gains of the forms that lead on the screen, best first."""
        penalised = ratios - self._penalties
        best = np.stack([indices[penalised[:, indices].argmax(axis=1)] for indices in self._forms], axis=1)
        scores = np.take_along_axis(penalised, best, axis=1)
        leading = np.argsort(-scores, axis=1, kind="stable")[:, :most]
        chosen, gains = (np.take_along_axis(of_forms, leading, axis=1) for of_forms in (best, scores))
        return self._label_of[leading], chosen, gains


def _drawn(
    r: Responses, alternative: Fit, noise: NoiseModel, rng: np.random.Generator, steps: Sequence[int]
) -> Iterator[FloatArray]:
    """(b, n, J) responses of noise alone, as many in all as each step says, few of the first beforehand."""
    before = 0
    for draws in steps:
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
