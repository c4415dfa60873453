"""Which of the selected effects are large enough, beside their standard errors, to be listed.

A search tests whether something is there. It does not test whether each effect of the final model has a size:
two terms that entered one after the other may cancel each other. Each effect is judged by a Wald test of all
its coefficients together (Seber & Wild, Nonlinear Regression, 1989, section 5.3), so of amplitude and phase
of a wave at once. Where a document states one size of an effect, that reaches two of its standard errors.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.diagnosis.candidates import Candidate, own_columns
from calrig.calibration.diagnosis.families import with_free_orphans
from calrig.calibration.diagnosis.ranking import MARGIN, SelectedEffect, candidates_in
from calrig.calibration.diagnosis.report import covariance_with_places, has_size, words_of
from calrig.calibration.diagnosis.reselection import penalised_criterion
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.regression.noise_model import distance_of
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

TWO_STANDARD_ERRORS = 0.0455
"""Chance that noise alone gives a coefficient of two standard errors or more."""
CLEAR = 4.0
"""Standard errors from which on the refits of noise that widen them need not be drawn."""


def established(findings: Findings, *, draws: bool) -> Findings:
    """Return the findings less the effects whose size is below two of its standard errors.

    Of two effects that are uncertain only beside each other one stays, and is ambiguous with the other. Where
    neither explains what both explain together, both stay.

    With `draws`, standard errors are widened by refits of noise, as in a document.
    """
    r, found = findings.responses, list(findings.found)
    staying: set[Candidate] = set()
    while found:
        chances = _chances(r, found, draws=draws)
        followed = {f.candidate.follows for f in found}
        may_leave = [
            k for k, f in enumerate(found) if f.candidate.name not in followed and f.candidate not in staying
        ]
        least = max(may_leave, key=chances.__getitem__, default=None)
        if least is None or chances[least] <= TWO_STANDARD_ERRORS:
            break
        staying.add(found[least].candidate)
        found = _without(r, found, least, draws=draws)
    return findings if found == list(findings.found) else with_effects(findings, found)


def with_effects(findings: Findings, found: Sequence[SelectedEffect]) -> Findings:
    """Return findings of the same poses with other effects."""
    found = with_free_orphans(findings.responses, list(found))
    model = fitted_model(findings.responses, [f.candidate for f in found])
    return replace(findings, found=tuple(found), fitted=model.fitted, columns=model.columns)


def _without(
    r: Responses, found: Sequence[SelectedEffect], weak: int, *, draws: bool
) -> list[SelectedEffect]:
    """Return the effects without a weak one or what makes it weak; all of them if both are needed."""
    one = found[weak]
    rest = [f for f in found if f is not one]
    for other in rest:
        fewer = [f for f in found if f is not other]
        chances = _chances(r, fewer, draws=draws)
        if chances[next(k for k, f in enumerate(fewer) if f is one)] > TWO_STANDARD_ERRORS:
            continue
        if any(f.candidate.follows == other.candidate.name for f in fewer):
            continue
        kept, left = min(
            ((rest, other), (fewer, one)), key=lambda pair: penalised_criterion(r, candidates_in(pair[0]))
        )
        after, before = (penalised_criterion(r, candidates_in(those)) for those in (kept, found))
        if after > before + MARGIN:
            told = f"these poses determine its size only without {words_of(r, other.candidate)} and need both"
            return [one.against(other.candidate, told) if f is one else f for f in found]
        dropped = one if kept is rest else other
        return [_ambiguous_with(r, f, dropped) if f is left else f for f in kept]
    return rest


def _ambiguous_with(r: Responses, one: SelectedEffect, dropped: SelectedEffect) -> SelectedEffect:
    if dropped.candidate.label in {rival.label for rival in one.rivals}:
        return one
    told = f"these poses determine either it or {words_of(r, dropped.candidate)}, not both together"
    return one.against(dropped.candidate, told)


def _chances(r: Responses, found: Sequence[SelectedEffect], *, draws: bool) -> list[float]:
    """Return each effect's chance of coefficients as large in noise alone, the other effects present.

    It is 1 where the one size that a document would state is below two standard errors. Several may be
    certain together alone, as the offsets of two axes over a short arc.
    """
    from scipy.special import fdtrc

    candidates = candidates_in(found)
    model = fitted_model(r, candidates)
    own = own_columns(model.columns, candidates)
    freedom = max(1, len(r) - int(np.any(model.columns[:, 0, :] != 0.0, axis=0).sum()))
    beta = model.fitted.beta

    def wald(covariance: FloatArray) -> list[float]:
        """Return each squared distance from 0, per coefficient."""
        return [distance_of(beta[at], covariance[at, at]) / (at.stop - at.start) for at in own]

    is_drawn = draws and min(wald(covariance_with_places(model, draws=False, parts=False))) < CLEAR**2
    covariance, stated = (
        covariance_with_places(model, draws=is_drawn, parts=parts) for parts in (False, True)
    )
    return [
        float(fdtrc(at.stop - at.start, freedom, distance))
        if has_size(candidate, beta[at], stated[at, at], together=True)
        else 1.0
        for candidate, at, distance in zip(candidates, own, wald(covariance), strict=True)
    ]
