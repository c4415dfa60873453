"""Make the verdict on a result: the residual compared with noise, and conformity with limits, in sentences.

`make_verdict` is the only place where a `calrig.model.verdict.Verdict` is made. It rests on this package:
budget and coverage factor give U, conformity the answer, risk its probability, doubts the reasons for not
releasing a calibration.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from calrig.calibration.uncertainty.budget import frozen
from calrig.calibration.uncertainty.conformity import (
    Decided,
    combined_answer,
    decisions,
    deg,
    deg_and_limit,
    percent,
    significant,
)
from calrig.calibration.uncertainty.coverage import coverage_factor
from calrig.calibration.uncertainty.doubts import STAYS_A_DRAFT, doubts_of
from calrig.calibration.uncertainty.risk import probability_of_conformity
from calrig.estimation.angle_text import angle_text
from calrig.model.result import Extremes, RangeErrors, Reference, Result, Verified
from calrig.model.verdict import Answer, Figures, Interval, Left, Limit, Verdict, VerdictFigures

Document = Mapping[str, Any]

CONFIDENCE = 0.99
"""Noise alone exceeds `noise_bound` in 1 % of runs, as in the significance test of the diagnosis."""
FEW_POSES = 6
WORTH_APPLYING = 3.0
"""Standard errors by which a scale must differ from 1 before it is worth applying."""
IN_WORDS: dict[Answer, str] = {
    "pass": "Pass",
    "conditional_pass": "Conditional pass",
    "conditional_fail": "Conditional fail",
    "fail": "Fail",
    "undecided": "Undecided",
}
SAME_EFFECT = "the same at another period"
"""Names an effect that is confusable with itself: only the spacing of the poses could distinguish them."""


def make_verdict(
    result: Result,
    diagnosis: Document | None = None,
    *,
    verification: bool = False,
    move_mismatches: int = 0,
    limit: Limit | None = None,
    calibration: Document | None = None,
) -> Verdict:
    """Make the verdict on a run's result.

    With s the standard error of one reading (`noise_deg`, pooled from within the dwells), n poses and p
    fitted parameters, noise alone leaves residuals r with Σr²/s² distributed as χ² with ν = n − p degrees of
    freedom (Draper & Smith, Applied Regression Analysis, 1998, section 2.1, lack of fit with σ known). So
    ratio = √(Σr²/(ν·s²)), and noise alone keeps it under √(χ²(0.99; ν)/ν): 1.34 of 26 poses, 1.08 of 500.

    Args:
        result: CONTRACT section 2's, bias and scale (and accepted effects) with what they leave.
        diagnosis: the run's latest, CONTRACT section 5; None before the first.
        verification: whether an earlier calibration was applied, and nothing was fitted to these poses.
        move_mismatches: moves in which the unit measured another rotation than the stage reported; used only
            if the result has no `doubts` of its own.
        limit: that matches the unit; None if none does.
        calibration: the document made from these poses, CONTRACT section 6; its figures, if given, are
            tested instead of the result's.
    """
    ratio, bound, freedom = _over_noise(result, diagnosis, verification=verification)
    left = _left(ratio, bound)
    doubts = doubts_of(result, move_mismatches=move_mismatches, verification=verification)
    tested = None if limit is None else _test(limit, result, calibration, relied_on=not doubts)
    verified = result.verified if verification else None
    of_stage = _of_the_stage(result, freedom, left)
    says = [
        *_outside(verified),
        *(one.says for one in doubts),
        *([STAYS_A_DRAFT] if doubts and not verification else []),
        *(() if tested is None else tested.says),
        *_left_in_words(left, ratio, bound, freedom, verified, alone=tested is None),
        _before_and_after(result, verification=verification, of_one_run=_is_solved(calibration)),
        *of_stage,
        *([result.reference_says] if result.reference_says else []),
        *([] if of_stage and diagnosis is None else _diagnosed(diagnosis, left)),
        *([] if verification else _scale(result)),
    ]
    if result.n_poses < FEW_POSES:
        says.append(f"It rests on only {_poses(result.n_poses)}.")
    if limit is None or tested is None:
        return Verdict("no_limits", left, ratio, tuple(says), limit=None, reliable=not doubts)
    return Verdict(
        answer=tested.answer,
        left=left,
        ratio=ratio,
        says=tuple(says),
        limit=limit.name,
        probability_of_conformity=tested.probability_of_conformity,
        probability_of_false_accept=tested.probability_of_false_accept,
        reliable=not doubts,
    )


def verdict_figures(
    result: Result, diagnosis: Document | None, *, verification: bool, move_mismatches: int
) -> VerdictFigures:
    """Return what `answer` and `left` of the verdict follow from, whatever the limits; arguments as there."""
    ratio, bound, _ = _over_noise(result, diagnosis, verification=verification)
    measured = _measured(result)
    return VerdictFigures(
        left=_left(ratio, bound),
        without=_without_figures(result) if measured is None else None,
        relied_on=not doubts_of(result, move_mismatches=move_mismatches, verification=verification),
        **({} if measured is None else measured.figures.model_dump()),
    )


def noise_bound(freedom: float) -> float:
    """Return the residual over its noise that noise alone stays under with probability `CONFIDENCE`.

    With the noise known, Σr²/s² is χ² with ν = `freedom` degrees of freedom (Draper & Smith, Applied
    Regression Analysis, 1998, section 2.1), so that √(χ²(0.99; ν)/ν) bounds the ratio: 1.34 of 24, 1.08 of
    498.
    """
    from scipy.special import chdtri

    return math.sqrt(float(chdtri(freedom, 1.0 - CONFIDENCE)) / freedom)


def _over_noise(
    result: Result, diagnosis: Document | None, *, verification: bool
) -> tuple[float | None, float | None, int]:
    """Return the residual over the one that noise predicts, the bound of noise alone, and ν."""
    if verification and result.verified is not None:
        return result.verified.ratio, result.verified.bound, result.verified.n_tested
    freedom = result.n_poses - (0 if verification else _fitted_parameters(result, diagnosis))
    if not verification and result.over_range is not None:  # rows of before lack the effects
        freedom = min(freedom, result.over_range.freedom)
    ratio = _ratio(result, freedom)
    return ratio, None if ratio is None else noise_bound(freedom), freedom


def _left(ratio: float | None, bound: float | None) -> Left | None:
    if ratio is None or bound is None:
        return None
    return "noise" if ratio <= bound else "more_than_noise"


def _fitted_parameters(result: Result, diagnosis: Document | None) -> int:
    """Count bias, scale, and the parameters that accepted effects have fitted to these poses."""
    line = 1 if result.scale is None else 2
    if diagnosis is None or result.rms_with_effects_deg is None:
        return line
    accepted = [effect for effect in diagnosis["effects"] if effect.get("accepted_at") is not None]
    values = [value for effect in accepted for value in effect["parameters"].values()]
    return line + sum(value is not None and value["std"] is not None for value in values)


def _left_deg(result: Result) -> float | None:
    """Return the RMS residual of a reading, degrees, after every accepted effect."""
    with_effects = result.rms_with_effects_deg
    calibrated = result.rms_calibrated_deg if with_effects is None else with_effects
    scale = result.scale
    return None if calibrated is None else calibrated * (1.0 if scale is None else abs(scale))


def _ratio(result: Result, freedom: int, also_deg: float = 0.0) -> float | None:
    """Return the residual over the one that noise, and a further error of each pose, predict."""
    left_deg, noise_deg = _left_deg(result), result.noise_deg
    if left_deg is None or not noise_deg or freedom < 1:
        return None
    expected_deg = math.hypot(noise_deg, also_deg) * math.sqrt(freedom / result.n_poses)
    return float(left_deg / expected_deg)


def _left_in_words(
    left: str | None,
    ratio: float | None,
    bound: float | None,
    freedom: int,
    verified: Verified | None,
    *,
    alone: bool,
) -> list[str]:
    """Say whether the residual is noise; `alone` if no limit says whether it is good enough."""
    if ratio is None or bound is None:
        what = "Not judged" if alone else "What is left is not judged"
        if verified is not None and verified.rms_deg is None:
            return [f"{what}: {_poses(verified.n_tested)} within the calibrated range are too few."]
        return [f"{what}: the noise of a reading is not known, or there are too few poses."]
    noise = "Good: only noise is left." if alone else "Only noise is left."
    shown, most = _apart(ratio, bound)
    if verified is not None:
        return [
            noise if left == "noise" else "More than noise is left.",
            f"The residual is {shown} times what noise and the uncertainty of calibration and stage "
            f"predict; they alone stay under {most} in {100 * CONFIDENCE:.0f} % of runs "
            f"({_poses(freedom)}, correlation {verified.correlation or 0.0:.2f} from pose to pose).".replace(
                "-", "−"
            ),
            *_as_before(left, verified),
        ]
    return [
        noise if left == "noise" else "More than noise is left.",
        f"The residual RMS is {shown} times what noise alone predicts; noise alone stays under "
        f"{most} in {100 * CONFIDENCE:.0f} % of runs ({freedom} degrees of freedom).",
    ]


def _apart(ratio: float, bound: float) -> tuple[str, str]:
    """Format two figures with two decimals, or with as many more as show which one is larger."""
    for decimals in range(2, 17):
        first, second = f"{ratio:.{decimals}f}", f"{bound:.{decimals}f}"
        if first != second:
            break
    return first, second


def _as_before(left: str | None, verified: Verified) -> list[str]:
    """Say that the calibration's own poses scatter as much, if more than noise is left and they do."""
    p_value = verified.against_calibration_p
    if left != "more_than_noise" or p_value is None or p_value < 1.0 - CONFIDENCE:
        return []
    return ["The calibration's own poses scatter as much: no change since the calibration is shown."]


def _outside(verified: Verified | None) -> list[str]:
    """Say which poses lie outside the calibrated range, with both ranges; nothing if none does."""
    if verified is None or not verified.n_outside:
        return []
    measured, calibrated = (
        [_range(of_angle, "°"), *([] if of_temperature is None else [_range(of_temperature, " °C")])]
        for of_angle, of_temperature in (
            (verified.measured_deg, verified.measured_c),
            (verified.calibrated_deg, verified.calibrated_c),
        )
    )
    return [
        f"Outside the calibrated range: {verified.n_outside} of "
        f"{_poses(verified.n_outside + verified.n_tested)}. Verified at {', '.join(measured)}; calibrated at "
        f"{', '.join(calibrated)}. The calibration promises nothing outside, so those poses are not judged."
    ]


def _range(ends: Extremes, unit: str) -> str:
    return f"{ends.min:.1f}{unit} to {ends.max:.1f}{unit}".replace("-", "−")


def _is_solved(calibration: Document | None) -> bool:
    """Return whether a document is of a joint solution, whose verdict is on the poses of one of its runs."""
    return "elevation_std_deg" in (calibration or {})


def _before_and_after(result: Result, *, verification: bool, of_one_run: bool) -> str:
    raw, calibrated, both = result.rms_raw_deg, result.rms_calibrated_deg, result.rms_with_effects_deg
    if calibrated is None:
        return f"RMS error {deg(raw)} raw; the reading does not follow the stage and cannot be calibrated."
    if verification:
        applied = calibrated if both is None else both
        words = f"As found, against the document: RMS error {deg(raw)} raw, {deg(applied)} once it is applied"
        if both is not None:
            words += f" ({deg(calibrated)} by its bias and scale alone)"
    else:
        what = "RMS error of one run of the joint solution" if of_one_run else "RMS error"
        words = f"{what} {deg(raw)} raw, {deg(calibrated)} calibrated"
        if both is not None:
            words += f", {deg(both)} with accepted effects"
    if result.noise_deg is not None:
        words += f"; standard error of one reading {deg(result.noise_deg)}"
    return f"{words}."


def _of_the_stage(result: Result, freedom: int, left: str | None) -> list[str]:
    """Say that the setting uncertainty of the stage explains the residual, if it does."""
    reference = result.reference
    if left != "more_than_noise" or reference is None or reference.kind != "setting":
        return []
    ratio = _ratio(result, freedom, reference.std_deg)
    if ratio is None or ratio > noise_bound(freedom):
        return []
    return [f"The stage's own setting uncertainty of {deg(reference.std_deg)} accounts for it."]


def _diagnosed(diagnosis: Document | None, left: str | None) -> list[str]:
    """Say what the diagnosis knows of the residual's cause."""
    if diagnosis is None:
        return (
            ["Its cause is not known: the run has not been diagnosed."] if left == "more_than_noise" else []
        )
    open_ones = [effect for effect in diagnosis["effects"] if effect.get("accepted_at") is None]
    if not open_ones and left == "more_than_noise":
        return ["The diagnosis names no further effect.", *not_repeated_better(diagnosis)]
    is_good = diagnosis.get("reference") == "good"
    return [_found(effect, reference_is_good=is_good) for effect in open_ones]


def _found(effect: Document, *, reference_is_good: bool) -> str:
    if effect["verdict"] == "unnamed":
        return "The diagnosis finds an effect that is not in its catalogue."
    names = candidate_titles(effect, reference_is_good=reference_is_good)
    if effect["verdict"] == "named" and effect.get("changed"):
        return f"The diagnosis names {names[0]}{between_runs(effect)}."
    if effect["verdict"] == "named":
        return f"The diagnosis names {names[0]}, which has not been accepted."
    return f"The diagnosis cannot distinguish {' from '.join(names)}."


def candidate_titles(effect: Document, *, reference_is_good: bool) -> list[str]:
    """Return the titles, inside a sentence, of an effect and of those that it is confusable with."""
    from calrig.calibration.effects import title_inside  # not loaded before it is needed

    own, title = effect["name"], partial(title_inside, reference_is_good=reference_is_good)
    others = (SAME_EFFECT if name == own else title(name) for name in effect["confusable_with"])
    return [title(own), *others]


def not_repeated_better(diagnosis: Document) -> list[str]:
    """Say why a residual exceeds the noise of its dwells, although no effect of the poses can explain it.

    Returns:
        One sentence; none if the residual is within that noise, or exceeds what revisited poses repeat to.
    """
    noise = diagnosis.get("noise") or {}
    floor_deg, tested = noise.get("floor_deg"), noise.get("lack_of_fit")
    if not floor_deg or tested is None or tested["rejected"]:
        return []
    if noise["std_deg"] <= floor_deg * noise_bound(max(tested["freedom"][0], 1.0)):
        return []
    # three significant digits, as in the sentences of the diagnosis
    return [
        f"Revisited poses repeat no better than {angle_text(noise['pure_error_deg'])}, where the noise "
        f"within a dwell is {angle_text(floor_deg)}: the rig does not return to one place, or the filter has "
        "not settled."
    ]


def between_runs(effect: Document) -> str:
    """Return, for example, `, changed from run 17 to run 18`; empty if the effect is the same in all runs."""
    changed = effect.get("changed")
    return f", changed from run {changed['from']} to run {changed['to']}" if changed else ""


def _scale(result: Result) -> list[str]:
    scale, std = _scale_as_applied(result)
    if scale is None:
        return ["All poses are at one elevation: the scale is not known and counts as 1."]
    if not std:
        return []
    distance = abs(scale - 1.0)
    if distance <= WORTH_APPLYING * std:
        return ["The scale does not differ significantly from 1."]
    words = f"The scale differs from 1 by {distance / std:.0f} standard errors"
    of_stage = (0.0 if result.reference is None else result.reference.scale_std) or 0.0
    if distance > WORTH_APPLYING * math.hypot(std, of_stage):
        return [f"{words}."]
    return [f"{words}, but no more than the stage's own uncertainty allows."]


def _scale_as_applied(result: Result) -> tuple[float | None, float | None]:
    """Return scale and standard error, fitted with every accepted effect if the result has them."""
    over = result.over_range
    if over is None or over.covariance is None:
        return result.scale, result.scale_std
    return over.scale, math.sqrt(over.covariance[1][1])


def _poses(count: int) -> str:
    return f"{count} pose" if count == 1 else f"{count} poses"


@dataclass(frozen=True, slots=True)
class _Measured:
    """What a limit is tested on: `figures`, and the rest of a result that sentences and risk need."""

    figures: Figures
    found: RangeErrors
    errors_deg: list[float]
    reference: Reference | None
    level_known: bool


@dataclass(frozen=True, slots=True)
class _Tested:
    """The answer to a limit, its sentences, and the probability that the unit conforms; None if unknown."""

    answer: Answer
    says: tuple[str, ...]
    probability_of_conformity: float | None
    probability_of_false_accept: float | None


def _measured(result: Result, calibration: Document | None = None) -> _Measured | None:
    """Gather what limits are tested on; None if the result has no error over the range.

    Calibrated is the elevation, so that the largest error is the one after every accepted effect; bias and
    scale are tested as found. Until the level is known, elevations are relative to their mean over the range.
    """
    found, stage = result.over_range, result.reference
    if found is None:
        return None
    if calibration is not None:
        same = ("bias_deg", "scale", "covariance", "expanded_uncertainty_deg", "coverage_factor")
        own_deg = found.error_expanded_uncertainty_deg
        is_same_fit = frozen(calibration["covariance"]) == found.covariance
        found = replace(found, **{key: frozen(calibration[key]) for key in same})
        found = found if is_same_fit else replace(found, error_steps=None)
        if own_deg is not None and found.expanded_uncertainty_deg is not None:
            least_deg = min(own_deg, found.expanded_uncertainty_deg)
            found = replace(found, error_expanded_uncertainty_deg=least_deg)
    with_effects = result.rms_with_effects_deg
    rms_deg = result.rms_calibrated_deg if with_effects is None else with_effects
    if result.verified is not None:
        rms_deg = result.verified.rms_deg
    level_known = bool((calibration or {}).get("level_known", False))
    level_deg = 0.0 if level_known else found.mean_error_deg
    at_ends = zip(found.lowest_error_deg, found.highest_error_deg, strict=True)
    errors_deg = [max(abs(low - level_deg), abs(high - level_deg)) for low, high in at_ends]
    is_one_elevation = found.elevation_deg[0] == found.elevation_deg[-1]
    of_stage = (None, None) if stage is None else (stage.bias_std_deg, stage.scale_std or 0.0)
    reference = None if stage is None else stage.reference
    figures = Figures(
        # at one elevation nothing is relative to the others
        largest_error_deg=None if is_one_elevation and not level_known else max(errors_deg),
        error_expanded_deg=found.error_expanded_uncertainty_deg,
        bias_deg=found.bias_deg if level_known else None,
        bias_expanded_deg=_line_expanded(0, found, reference, of_stage[0]),
        scale=found.scale,
        scale_expanded=_line_expanded(1, found, reference, of_stage[1]),
        rms_deg=rms_deg,
        rms_expanded_deg=None if rms_deg is None else 1.96 * rms_deg / math.sqrt(2.0 * max(found.freedom, 1)),
        expanded_deg=found.expanded_uncertainty_deg,
    )
    return _Measured(figures, found, errors_deg, reference, level_known)


def _line_expanded(
    which: int, found: RangeErrors, reference: Reference | None, of_stage: float | None
) -> float | None:
    """Combine type A of bias (`which` 0) or scale (1) with the stage's part, and expand it."""
    if found.covariance is None or reference is None or of_stage is None:
        return None
    if found.expanded_uncertainty_deg is None:
        return None
    variance = found.covariance[which][which]
    if variance < 0.0:  # of a document that somebody else made
        return None
    own = math.sqrt(variance)
    factor = coverage_factor(own, found.freedom, of_stage, reference.combined_distribution)
    return factor * math.hypot(own, of_stage)


def _test(limit: Limit, result: Result, calibration: Document | None, *, relied_on: bool) -> _Tested:
    """Test a result against a limit. A figure without uncertainty never passes.

    Args:
        limit: that matches the unit.
        result: CONTRACT section 2's, with `over_range`.
        calibration: CONTRACT section 6's of the same poses; its figures replace those of the result.
        relied_on: False if there is a doubt about the result: it is undecided then, unless it fails.
    """
    measured = _measured(result, calibration)
    if measured is None:
        return _nothing_to_test(limit, result)
    found = decisions(limit, measured.figures)
    all_decided, any_decided = None not in found.values(), any(found.values())
    answer = combined_answer(found.values(), relied_on=relied_on)
    probability = _probability(limit, measured) if any_decided else None
    return _Tested(
        answer=answer,
        says=(
            f"{IN_WORDS[answer]} against the limits “{limit.name}” ({limit.rule_in_words}).",
            *_says(limit, measured, found),
            *_risk(answer, probability, of="the unit" if all_decided else "what is decided"),
        ),
        probability_of_conformity=probability,
        probability_of_false_accept=1.0 - probability
        if answer == "pass" and probability is not None
        else None,
    )


def _without_figures(result: Result) -> Answer:
    """Return the answer to any limit if the result has no error over the range."""
    return "fail" if result.rms_calibrated_deg is None else "undecided"


def _nothing_to_test(limit: Limit, result: Result) -> _Tested:
    against, answer = f"against the limits “{limit.name}”", _without_figures(result)
    if answer == "fail":
        return _Tested(answer, (f"Fail {against}: the reading does not follow the stage.",), 0.0, None)
    if result.verified is not None:
        why = "Too few poses are within the calibrated range; the calibration promises nothing outside it."
        return _Tested(answer, (f"Undecided {against}.", why), None, None)
    says = (
        f"Undecided {against}.",
        "An earlier version of calrig computed this result and did not store the figures that limits need.",
    )
    return _Tested(answer, says, None, None)


def _says(limit: Limit, measured: _Measured, found: Mapping[str, Decided | None]) -> Iterator[str]:
    """Say how each figure is decided that the limit sets; if it is undecided, why."""
    if limit.max_error_deg is not None:
        yield _largest_error(limit.max_error_deg, measured, found["max_error_deg"])
    if limit.bias_deg is not None:
        bias, shown = found["bias_deg"], deg(measured.found.bias_deg)
        undecided = f"Bias {shown}: not decided, because the level is unknown: it may be the clamping's."
        yield undecided if bias is None else _say_between("Bias", "°", limit.bias_deg, bias)
    if limit.scale is not None:
        scale, undecided = found["scale"], "Scale: not decided, because all poses are at one elevation."
        yield undecided if scale is None else _say_between("Scale", "", limit.scale, scale)
    if limit.rms_deg is not None and (rms := found["rms_deg"]):
        yield _say_at_most("RMS error", rms, limit.rms_deg)
    if limit.expanded_uncertainty_deg is not None:
        own = found["expanded_uncertainty_deg"]
        yield (
            "Expanded uncertainty: unknown, so that nothing passes."
            if own is None
            else _say_at_most("Expanded uncertainty U =", own, limit.expanded_uncertainty_deg, has_own=False)
        )


def _largest_error(allowed_deg: float, measured: _Measured, largest: Decided | None) -> str:
    found, errors = measured.found, measured.errors_deg
    if largest is None:
        return "Largest error: not decided, because at one elevation nothing is relative to the others."
    low, high = found.elevation_deg[0], found.elevation_deg[-1]
    near = round(found.elevation_deg[errors.index(largest.value)], 2)
    where = f", near {near:g}°".replace("-", "−")
    if not measured.level_known:
        over = f"{low:.4g}° to {high:.4g}°".replace("-", "−")
        where += f", of the elevation less its mean over {over} (the level is not known)"
    of_elevation, of_error = found.expanded_uncertainty_deg, largest.expanded
    note = ""
    if of_elevation is not None and of_error is not None and deg(of_elevation) != deg(of_error):
        note = f" (of an elevation {deg(of_elevation)}, which contains the residual)"
    return _say_at_most("Largest error", largest, allowed_deg, where=where, note=note)


def _say_at_most(
    what: str, found: Decided, allowed_deg: float, *, where: str = "", note: str = "", has_own: bool = True
) -> str:
    """Say a figure, its uncertainty if it `has_own`, and its limit, with digits that show why."""
    value, most = deg_and_limit(found.value, allowed_deg)
    u = ", U not known" if found.expanded is None else f", U = {deg(found.expanded)}{note}"
    answer = IN_WORDS[found.answer].lower()
    return f"{what} {value}{where}{u if has_own else ''}; at most {most} allowed: {answer}."


def _say_between(name: str, unit: str, allowed: Interval, found: Decided) -> str:
    u = "U not known" if found.expanded is None else f"U = {significant(found.expanded)}{unit}"
    low, high = (f"{end:g}{unit}".replace("-", "−") for end in allowed)
    is_inside = allowed[0] <= found.value <= allowed[1]
    decimals = range(3 if unit else 5, 17)
    shown = next(
        (
            text
            for text in (f"{found.value:.{n}f}" for n in decimals)
            if (allowed[0] <= float(text) <= allowed[1]) == is_inside
        ),
        f"{found.value}",
    )
    shown, answer = shown.replace("-", "−"), IN_WORDS[found.answer].lower()
    return f"{name} {shown}{unit}, {u}; {low} to {high} allowed: {answer}."


def _probability(limit: Limit, measured: _Measured) -> float | None:
    rms_deg = measured.figures.rms_deg
    if measured.reference is None or measured.figures.expanded_deg is None or rms_deg is None:
        return None
    asked = limit.expanded_uncertainty_deg
    if asked is not None and (measured.found.expanded_uncertainty_deg or 0.0) > asked:
        return 0.0
    return probability_of_conformity(
        limit.model_copy(update={"name": "", "units": "*", "rig": None, "rule": "simple", "guard": 1.0}),
        measured.found,
        measured.reference,
        rms_deg=rms_deg,
        level_known=measured.level_known,
    )


def _risk(answer: Answer, probability: float | None, *, of: str) -> list[str]:
    if probability is None:
        return ["How probable it is that the unit conforms is not known."]
    said = f"By the uncertainty of this result, {of} conforms with a probability of {percent(probability)}"
    if answer != "pass":
        return [f"{said}."]
    return [f"{said}: the risk of a false acceptance is {percent(1.0 - probability)}."]
