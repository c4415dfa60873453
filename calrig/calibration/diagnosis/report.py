"""Report the effects of a diagnosis: parameters with standard errors, evidence and partial residuals.

Generalised least squares states the standard errors for known noise. The correlations of the noise are
estimated from the same poses, and the fit leans on the channels that look quiet, so that stated errors are
too small by 10 to 30 % (Kackar & Harville, Journal of the American Statistical Association 79, 1984). Refits
of noise drawn from the final model give the factor (parametric bootstrap: Efron & Tibshirani, An Introduction
to the Bootstrap, 1993, section 6.5).

With reading − θ = base + Σ effects + e, the partial residual of effect k is its fitted part plus e (Larsen &
McCleary, Technometrics 14, 1972). Plotted against its covariate it shows where the effect describes the poses
well, and where it does not.

How much of the residual an effect explains is its share of the mean square that bias and scale leave, in the
fit of all effects together: the covariance of the effect with that residual, over the residual's mean square
(Pratt, Proceedings of the Second International Tampere Conference in Statistics, 1987). The shares of all
effects and of the final residual add up to 1, also where effects are correlated; an effect that others
compensate can have a negative one.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    documented_forms,
    is_term_of,
    model_columns,
    own_columns,
    rebuilt,
)
from calrig.calibration.diagnosis.families import place_slope
from calrig.calibration.diagnosis.outliers import gross_errors, most_outliers, outliers
from calrig.calibration.diagnosis.ranking import FAR_BEHIND, MARGIN, SelectedEffect
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.diagnosis.sensor_model import KEPT, Model, fitted_model, parts_deg
from calrig.calibration.effects import EFFECTS, UNNAMED, covariate_of
from calrig.calibration.effects.unnamed import fitted_words
from calrig.calibration.line import fit_line, residuals_deg
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.calibration.regression.channels import ANGLE, CHANNELS, READING, SCALE_UNIT_DEG
from calrig.calibration.regression.effect import ELEVATION, LAST_MOVE, Circumstances, Scope, Shape
from calrig.calibration.regression.noise_model import (
    Fit,
    fit,
    fits,
    moved_unweighted,
    noise_of,
    varied_between_parts,
)
from calrig.calibration.regression.request import AS_USUAL, DiagnosisRequest
from calrig.calibration.regression.responses import Change, Responses, responses_of
from calrig.calibration.regression.run_changes import in_words
from calrig.calibration.regression.terms import less_line, size_deg
from calrig.calibration.results.correction import DERIVATIVE_STEP_DEG, numbers_of, slope_of_reading
from calrig.estimation.angle_text import angle_text
from calrig.estimation.angles import FloatArray

ONE_CURVE = "with a good reference each is the sensor's, and its correction is the same curve"
SCALE = "reading.scale"
A_WAVE = 2
"""Columns; an effect with more is a curve."""
DIFFERS = "it differs between quarters of the run by more than noise, and its errors allow for that"
DRAWS = 100
"""Which tell an error to 7 % of itself."""


def covariance_of(
    r: Responses,
    columns: FloatArray,
    fitted: Fit,
    seed: int = 0,
    curves: Sequence[slice] = (),
    *,
    draws: bool = True,
    parts: bool = True,
) -> FloatArray:
    """Return (p, p) covariance of a fit's coefficients, no error smaller than the fit states it.

    Errors are wider by as much as another weighting moves the coefficients (`moved_unweighted`), with `draws`
    as large as refits of noise scatter, and with `parts` by as much as parts of the run disagree.

    `columns` are (n, J, p). The coefficients of one effect's `curves` are certain in combination: one factor
    for all.
    """

    def alike(ratio: FloatArray) -> FloatArray:
        for own in curves:  # another factor for each would undo that their errors cancel
            ratio[own] = ratio[own].mean()
        return ratio

    def over(variance: FloatArray, stated: FloatArray, otherwise: float) -> FloatArray:
        return alike(np.divide(variance, stated, out=np.full_like(stated, otherwise), where=stated > 0.0))

    moved = over(moved_unweighted(r, columns, fitted) ** 2, np.diag(fitted.covariance), 0.0)
    times, varied = np.ones_like(moved), np.ones_like(moved)
    if parts:
        varied = alike(varied_between_parts(r, columns, fitted))
    if draws:
        taken = max(1.0, columns.shape[2] / len(r.channels))
        noise = noise_of(fitted.residuals, r, taken)
        drawn = np.random.default_rng(seed).standard_normal((DRAWS, *fitted.residuals.shape))
        again = fits(r, noise.colour(drawn, r.starts) * r.known, columns[None])
        stated = np.einsum("bpp->p", again.covariance) / DRAWS
        times = np.maximum(over((again.beta**2).mean(axis=0), stated, 1.0), 1.0)
    wider = np.sqrt(times * varied + moved)
    return np.asarray(fitted.covariance * wider * wider[:, None], dtype=np.float64)


def effect_documents(r: Responses, findings: Findings) -> list[dict[str, Any]]:
    """Return each effect found, with parameters from a fit of all of them together."""
    whole = [_whole_form(r, f.candidate) for f in findings.found]
    model = fitted_model(r, whole)
    own = own_columns(model.columns, whole)
    # an effect that is another in each part of the run is there all the same
    alike = covariance_with_places(model, parts=False)
    sized = [
        one if has_size(one, model.fitted.beta[at], alike[at, at]) else f.candidate
        for one, at, f in zip(whole, own, findings.found, strict=True)
    ]
    if sized != whole:  # of two coefficients that only together are certain, the one that was found
        model = fitted_model(r, whole := sized)
        own = own_columns(model.columns, whole)
        alike = covariance_with_places(model, parts=False)
    fitted = replace(model.fitted, covariance=covariance_with_places(model))
    differs = np.diag(fitted.covariance) > np.diag(alike)
    whole = _with_std_of_places(whole, fitted.covariance)
    shares = explained_shares(r, parts_deg(r, whole, model.fitted.beta))
    together = _sizes_together(r, whole, fitted, own)
    documents = [
        {
            **_document(
                r,
                one,
                candidate,
                fitted,
                at,
                together.get(candidate.label),
                is_one_curve=one.is_one_curve(r, findings.found),
            ),
            "explained": share,
            "least_p_value": findings.least_p_value,
        }
        for one, candidate, at, share in zip(findings.found, whole, own, shares, strict=True)
    ]
    is_one_to_one = not turns_round(r, whole, model.fitted.beta)
    for document, at in zip(documents, own, strict=True):
        if differs[at].any():
            document["evidence"].append(DIFFERS)
        if document["corrects"] == "unit" and document["covariate"] == ELEVATION.name and not is_one_to_one:
            document["corrects"] = None
    return documents


def _sizes_together(
    r: Responses, effects: Sequence[Candidate], fitted: Fit, own: Sequence[slice]
) -> dict[str, str]:
    """Return, by label, what several shapes of one column add together: each may undo most of another."""
    found = {}
    for label in {c.label for c in effects if not c.named}:
        several = [(c, at) for c, at in zip(effects, own, strict=True) if c.label == label]
        if len(several) < 2:
            continue
        columns = np.concatenate([c.columns[:, 0, :] for c, _ in several], axis=1)
        if several[0][0].covariate == ELEVATION.name:
            columns = less_line(r, columns)
        at = np.concatenate([np.arange(own_at.start, own_at.stop) for _, own_at in several])
        shape = Shape({READING: columns}, ("size_deg",))
        size = size_deg(shape, fitted.beta[at], fitted.covariance[np.ix_(at, at)])
        in_words = angle_text(size["value"] or 0.0, std_deg=size["std"])
        found[label] = f"together with the other structure of this column: {in_words}, peak to peak"
    return found


def explained_shares(r: Responses, effects_deg: Sequence[FloatArray]) -> list[float | None]:
    """Return the share of the mean square residual of bias and scale that each effect explains.

    `effects_deg` are (n,) what each effect adds to the readings, from one fit of all of them.

    Returns:
        As the module's docstring defines it; None if bias and scale leave nothing.
    """
    before_deg = less_line(r, r.values[:, 0])
    power = float(before_deg @ before_deg)
    return [float(before_deg @ one) / power if power > 0.0 else None for one in effects_deg]


@lru_cache(maxsize=KEPT)
def covariance_with_places(model: Model, *, draws: bool = True, parts: bool = True) -> FloatArray:
    """Return (p, p) covariance of a model's coefficients, the places that were refined among the unknowns.

    An order of the turn is known. `draws` and `parts` are as `covariance_of` has them.
    """
    own = own_columns(model.columns, model.accepted)
    slopes = [place_slope(model, own, k) for k, one in enumerate(model.accepted) if _is_refined(one)]
    r, columns, fitted = model.responses, model.columns, model.fitted
    if slopes:
        columns = np.concatenate([columns, *slopes], axis=2)
        fitted = fit(r, columns)
    curves = [at for at in own if at.stop - at.start > A_WAVE]
    return covariance_of(r, columns, fitted, curves=curves, draws=draws, parts=parts)


def _is_refined(candidate: Candidate) -> bool:
    return candidate.effect.place in candidate.shape.at_std and not candidate.shape.series


def _with_std_of_places(effects: Sequence[Candidate], covariance: FloatArray) -> list[Candidate]:
    """Return the effects with standard errors of the places refined that are those of the final model.

    Each place was refined beside the effects that were in the model then. Its variance is behind those of the
    coefficients in the covariance (`covariance_with_places`); an order keeps the error it was found with.
    """
    refined = [k for k, candidate in enumerate(effects) if _is_refined(candidate)]
    found = list(effects)
    for k, variance in zip(refined, np.diag(covariance)[len(covariance) - len(refined) :], strict=True):
        if variance > 0.0:  # else the others say the same, and leave nothing to tell it by
            first, place = effects[k], effects[k].effect.place
            for m, one in enumerate(effects):
                if one is first or is_term_of(one, first):
                    share = one.shape.at[place] / first.shape.at[place]
                    at_std = {place: share * math.sqrt(float(variance))}
                    found[m] = replace(one, shape=replace(one.shape, at_std=at_std))
    return found


def model_words(findings: Findings) -> str:
    """Return the final model, such as `reading = bias + scale·θ + backlash + 3 stage_periodic`."""
    names = Counter(
        f.candidate.label.replace("unnamed ", "f(") + ("" if f.candidate.named else ")")
        for f in findings.found
    )
    several = [name if count == 1 else f"{count} {name}" for name, count in names.items()]
    return " + ".join(["reading = bias + scale·θ", *several])


def words_of(r: Responses, candidate: Candidate) -> str:
    """Return what a sentence calls a candidate of these poses: its title, as its heading has it."""
    covariate = candidate.covariate
    words = candidate.effect.wording(reference_is_good=r.reference_is_good, covariate=covariate)
    of = "" if candidate.named else f" that follows {covariate_of(covariate).title}"
    return f"{words.inside}{of}{in_words(candidate.changed)}"


def _whole_form(r: Responses, candidate: Candidate) -> Candidate:
    """Return the form with all of an effect's parameters, where one of its parts sufficed to find it."""
    whole = candidate.shape.part_of and rebuilt(candidate, r, candidate.shape.part_of)
    return whole or candidate


def _document(
    r: Responses,
    found: SelectedEffect,
    candidate: Candidate,
    fitted: Fit,
    at: slice,
    together: str | None,
    *,
    is_one_curve: bool,
) -> dict[str, Any]:
    effect = candidate.effect
    beta, covariance = fitted.beta[at], fitted.covariance[at, at]
    words = effect.wording(reference_is_good=r.reference_is_good, covariate=candidate.covariate)
    parameters = effect.documented(candidate.shape, beta, covariance)
    return {
        "name": candidate.name,
        "verdict": found.verdict,
        "origin": "sensor" if candidate.is_of_sensor(r) else effect.origin,
        "covariate": candidate.covariate,
        "parameters": parameters,
        # a curve that another undoes in part is no correction by itself
        "corrects": None if together else _corrects(r, found, candidate, is_one_curve=is_one_curve),
        "p_value": found.p_value,
        "changed": candidate.changed and {"from": candidate.changed.before, "to": candidate.changed.after},
        "confusable_with": list(dict.fromkeys(rival.name for rival in found.rivals)),
        "evidence": [
            *_evidence(r, found, candidate, is_one_curve=is_one_curve),
            *fitted_words(r, candidate.shape, candidate.columns[:, 0, :] @ beta, parameters),
            *filter(None, [together]),
        ],
        "remedy": words.remedy,
        "considered": [
            {"name": label, "behind": behind, "why": _why(found, label, behind)}
            for label, behind in found.considered
        ],
        "accepted_at": None,
    }


def _corrects(
    r: Responses, found: SelectedEffect, candidate: Candidate, *, is_one_curve: bool
) -> Scope | None:
    """Return whose correction it is once a person accepts it; None if it cannot be accepted."""
    if candidate.changed is not None:
        return None
    if is_one_curve:
        return "unit"
    is_of_unit = candidate.named and candidate.is_of_sensor(r)
    scope: Scope = "unit" if is_of_unit else candidate.effect.scope
    return scope if found.verdict == "named" and scope != "run" else None


def _why(found: SelectedEffect, label: str, behind: float) -> str:
    """Why a candidate was chosen, or lost."""
    if label == found.candidate.label:
        return "the best, not claimed" if found.rivals else "explains these poses best"
    rivals = [rival.label for rival in found.rivals]
    doubts = dict(zip(reversed(rivals), reversed(found.doubts), strict=False))  # of those that came later
    if label in rivals:
        worse = "explains these poses worse, but poses taken like these cannot rule it out"
        return doubts.get(label, worse if behind >= MARGIN else "indistinguishable from it by these poses")
    if behind < MARGIN and label.startswith(UNNAMED) and found.candidate.named:
        return "fits as well, but a cause with a name goes first"
    if behind > FAR_BEHIND:
        return "explains these poses far worse"
    return f"explains these poses worse: odds about 1 : {math.exp(behind / 2.0):,.0f}"


def _same_elsewhere(found: SelectedEffect, candidate: Candidate) -> list[str]:
    """Return the same effect at other places that these poses cannot tell from its own."""
    place = candidate.effect.place
    alike = [other for other in found.alike if other.name == candidate.name]  # not those of its rival
    values = sorted((other.shape.at[place] for other in alike), reverse=True)
    if not values:
        return []
    parameter = next(p for p in candidate.effect.parameters if p.name == place)
    own, *others = dict.fromkeys(
        f"{value:.4g}{parameter.unit}" for value in (candidate.shape.at[place], *values)
    )
    told = f"a {parameter.title.lower()} of {', '.join(others)} would look the same as {own} at these poses"
    return [told] if others else []


def _evidence(r: Responses, found: SelectedEffect, candidate: Candidate, *, is_one_curve: bool) -> list[str]:
    said = [f"family-wise p-value {found.p_value:.3g}: the chance of so strong an effect in noise alone"]
    witnesses = [
        CHANNELS[c] for k, c in enumerate(r.channels) if k and np.ptp(candidate.columns[:, k, :]) > 0.0
    ]
    if witnesses:
        said.append(f"seen by {', '.join(witnesses)} as well as by the reading, as it must be")
    if candidate.changed is not None:
        said.append(f"changed{in_words(candidate.changed)}: the values are the later less the earlier ones")
    if candidate.shape.says:
        said.append(candidate.shape.says)
    said += _same_elsewhere(found, candidate)
    if candidate.named and found.rivals:
        names = ", ".join(dict.fromkeys(words_of(r, rival) for rival in found.rivals))
        alone = found.candidate.effect.told_apart(has_accelerometer=ANGLE in r.channels)
        apart = ONE_CURVE if is_one_curve else alone
        said.append(f"indistinguishable from {names} by these poses: {apart}")
    elif candidate.named and math.isfinite(found.lead):
        said.append(f"ΔBIC of the next best candidate: {found.lead:.1f}")
        is_of_stage = candidate.effect.origin == "stage" and not candidate.is_of_sensor(r)
        if not witnesses and is_of_stage and candidate.covariate == "target_deg":
            said.append("no witness was read: an error of the unit itself of this shape looks the same")
    return [*said, *found.doubts, *candidate.effect.evidence(r, candidate.shape)]


Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class PartialResidual:
    """The partial residual of one effect of a diagnosis, in the order measured.

    Attributes:
        covariate: what it was traced to (CONTRACT section 5).
        at: (n,) the covariate, in its own unit.
        theta_deg: (n,) elevation.
        residual_deg: (n,) reading less bias, scale and all other effects, degrees.
        effect_deg: (n,) what the effect adds to the reading, degrees.
    """

    covariate: str
    at: FloatArray
    theta_deg: FloatArray
    residual_deg: FloatArray
    effect_deg: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DrawnResiduals:
    """What a diagnosis leaves of its poses, in the order measured, before and after.

    Attributes:
        theta_deg: (n,) elevation.
        time_s: (n,) since the run began; None where it is not known of every pose.
        before_deg: (n,) left by bias and scale.
        after_deg: (n,) left by bias, scale and effects.
        effects: the partial residual of each effect.
    """

    theta_deg: FloatArray
    time_s: FloatArray | None
    before_deg: FloatArray
    after_deg: FloatArray
    effects: list[PartialResidual]


def partial_residuals(
    runs: Sequence[Sequence[Pose]],
    effects: Sequence[Document],
    run_ids: Sequence[str] | None = None,
    request: DiagnosisRequest = AS_USUAL,
) -> list[PartialResidual]:
    """Return the partial residual of each effect of a diagnosis; as `drawn_residuals`."""
    return drawn_residuals(runs, effects, run_ids, request).effects


def drawn_residuals(
    runs: Sequence[Sequence[Pose]],
    effects: Sequence[Document],
    run_ids: Sequence[str] | None = None,
    request: DiagnosisRequest = AS_USUAL,
) -> DrawnResiduals:
    """Return the residuals of a diagnosis, from one fit of all its effects together.

    Args:
        runs: the poses that were diagnosed, as `diagnose` took them.
        effects: the `effects` of the document; what was scanned for is taken from it, not searched again.
        run_ids: of the runs, as the document has them where something changed between two.
        request: of the diagnosis.

    Raises:
        DiagnosisError: the poses cannot show an effect (any more).
    """
    r = responses_of(runs, run_ids, request)
    r = r.rows(np.delete(np.arange(len(r)), gross_errors(r)))
    chosen = likeliest_forms(r, [_forms(r, effect) for effect in effects])
    fewest = len(r) - most_outliers(len(r))
    model = fitted_model(r, chosen)
    while len(apart := outliers(model.responses, model.accepted, len(r) - fewest)):
        others = np.delete(np.arange(len(r)), apart)
        r, chosen = r.rows(others), [c.rows(others) for c in chosen]
        model = fitted_model(r, chosen)
    fitted = model.fitted
    reading_deg = r.theta_deg + r.values[:, 0]
    line = fit_line(r.theta_deg, reading_deg)
    before_deg = residuals_deg(r.theta_deg, reading_deg, line.bias_deg, line.scale)
    after_deg = left_deg(r, chosen, fitted)
    partial = []
    for candidate, own in zip(chosen, parts_deg(r, chosen, fitted.beta), strict=True):
        at = _column(r, candidate.covariate)
        effect_deg = own
        if candidate.shape.knots:
            effect_deg = less_line(r, own)
        residual_deg = fitted.residuals[:, 0] + effect_deg
        partial.append(PartialResidual(candidate.covariate, at, r.theta_deg, residual_deg, effect_deg))
    return DrawnResiduals(r.theta_deg, r.time_s, before_deg, after_deg, partial)


def fitted_scale(r: Responses, beta: FloatArray) -> float:
    """Return the scale of the reading in a fit's coefficients (p,); 1 where it has none."""
    names = r.base_names
    return 1.0 + float(beta[names.index(SCALE)]) / SCALE_UNIT_DEG if SCALE in names else 1.0


def left_deg(r: Responses, accepted: Sequence[Candidate], fitted: Fit) -> FloatArray:
    """Return (n,) what a fitted model leaves of the readings, in degrees of elevation."""
    return np.asarray(fitted.residuals[:, 0] / slopes_of_errors(r, accepted, fitted.beta))


def slopes_of_errors(r: Responses, accepted: Sequence[Candidate], beta: FloatArray) -> FloatArray:
    """Return (n,) what errors of the readings are divided by, for degrees of elevation, in a model fitted.

    It is the unit's slope at each pose, or the mean slope, that of bias and scale alone, if the unit's curves
    turn it round.
    """
    slope, mean = _unit_slopes(r, accepted, beta)
    return np.full(len(r), mean) if (slope * mean <= 0.0).any() else slope


BACK = 0.05
"""Of the mean slope, what one the other way is more than: where readings stop, noise decides its sign."""


def turns_round(r: Responses, accepted: Sequence[Candidate], beta: FloatArray) -> bool:
    """Return whether a reading stands for several elevations, in a model with coefficients (p,)."""
    slope, mean = _unit_slopes(r, accepted, beta)
    return bool((slope / mean < -BACK).any())


def _unit_slopes(r: Responses, accepted: Sequence[Candidate], beta: FloatArray) -> tuple[FloatArray, float]:
    """Return the unit's slope at each pose (n,): its scale and its own effects; and that of bias and scale.

    Beside a curve that is not the unit's the model's scale is the slope at 0°, where perhaps no pose lies:
    the mean slope takes its place.
    """
    members = [member for candidate in accepted for member in candidate.members]
    of_unit = [m.effect.scope == "unit" or m.is_of_sensor(r) or m.is_smooth_of_sensor(r) for m in members]
    scale = mean = fitted_scale(r, beta)
    line = fit_line(r.theta_deg, r.theta_deg + r.values[:, 0])
    if line.follows and line.scale is not None:
        mean = line.scale
        curves = [not m.named and m.covariate == ELEVATION.name for m in members]
        if any(is_curve and not own for is_curve, own in zip(curves, of_unit, strict=True)):
            scale = mean
    curved, others = np.zeros(len(r)), []
    columns = model_columns(r, accepted)
    for member, own, at in zip(members, of_unit, own_columns(columns, members), strict=True):
        at_elevation = member.shape.at_elevation
        if not own or member.changed is not None:
            continue
        if at_elevation is not None:
            ahead, behind = (
                at_elevation(r.theta_deg + side).reshape(len(r), -1) @ beta[at]
                for side in (DERIVATIVE_STEP_DEG, -DERIVATIVE_STEP_DEG)
            )
            curved += (ahead - behind) / (2.0 * DERIVATIVE_STEP_DEG)
        elif member.named and member.covariate != LAST_MOVE.name:  # a move says nothing of where it ends
            stated = member.effect.documented(member.shape, beta[at], np.zeros((at.stop - at.start,) * 2))
            others.append((member.name, numbers_of(stated)))
    bias_deg = float(beta[r.base_names.index(f"{READING}.bias")])
    slope = slope_of_reading(r.theta_deg, bias_deg, scale, others, Circumstances.of(r)) + curved
    return slope, mean


def likeliest_forms(r: Responses, forms: Sequence[Sequence[Candidate]]) -> list[Candidate]:
    """Of each effect the form with the best likelihood, penalised as the search does, beside the others."""
    chosen = [options[0] for options in forms]
    bic_penalty = math.log(len(r))
    for k, options in enumerate(forms):
        if len(options) > 1:
            criteria = [
                fitted_model(r, [*chosen[:k], option, *chosen[k + 1 :]]).fitted.criterion
                + bic_penalty * option.parameters
                for option in options
            ]
            chosen[k] = options[int(np.argmin(criteria))]
    return chosen


def _forms(r: Responses, document: Document) -> list[Candidate]:
    name, covariate = document["name"], document["covariate"]
    known = name in EFFECTS
    numbers = numbers_of(document["parameters"])
    forms = documented_forms(r, name, covariate, numbers, _change(r, document)) if known else []
    if not forms:
        raise DiagnosisError(f"these poses cannot show {name} against {covariate}: diagnose them again")
    return forms


def _change(r: Responses, document: Document) -> Change | None:
    """Between which of these runs an effect changed; DiagnosisError where they are others."""
    changed = document.get("changed")
    if changed is None:
        return None
    if changed["to"] not in r.run_ids:
        raise DiagnosisError(f"run {changed['to']}, in which {document['name']} changed, has no poses left")
    return Change(r.run_ids.index(changed["to"]), changed["from"], changed["to"])


def _column(r: Responses, covariate: str) -> FloatArray:
    column = covariate_of(covariate).of(r)
    if column is None:
        raise DiagnosisError(f"these poses have no {covariate}: diagnose them again")
    return column


NO_SIZES = ("phase_deg", "at")
"""What a document states of an effect that says where it is, and not how large."""


def has_size(
    candidate: Candidate, beta: FloatArray, covariance: FloatArray, *, together: bool = False
) -> bool:
    """Return whether one of the sizes that a document states reaches two standard errors.

    `beta` (p,) and `covariance` (p, p) are the candidate's own. With `together`, several sizes are judged
    elsewhere, all at once.
    """
    stated = candidate.effect.reported(candidate.shape, beta, covariance)
    sizes = [size for name, size in stated.items() if size is not None and name not in NO_SIZES]
    known = [(size["value"], size["std"]) for size in sizes]
    is_large = any(v is not None and std is not None and abs(v) >= 2.0 * std for v, std in known)
    return is_large or (together and len(known) > 1)
