"""A result held against the limits that match it: figure by figure, and all together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from calrig.calibration.conformity import Answer, Limit, beyond_interval, decide, worst
from calrig.calibration.coverage import coverage_factor
from calrig.calibration.over_range import OverRange, frozen
from calrig.calibration.reference_figures import ReferenceFigures
from calrig.calibration.specific_risk import probability_of_conformity
from calrig.calibration.uncertainty import Reference
from calrig.calibration.wording import deg, percent, significant

Document = Mapping[str, Any]

IN_WORDS: dict[Answer, str] = {
    "pass": "Pass",
    "conditional_pass": "Conditional pass",
    "conditional_fail": "Conditional fail",
    "fail": "Fail",
}


@dataclass(frozen=True, slots=True)
class LimitVerdict:
    """The answer to a limit, in sentences as well, and its specific risk; None where that is not known."""

    answer: Answer
    says: tuple[str, ...]
    probability_of_conformity: float | None
    probability_of_false_accept: float | None


@dataclass(frozen=True, slots=True)
class _Figure:
    """A figure held against its limit: what is said of it, and the answer; None: it cannot be decided."""

    says: str
    answer: Answer | None


@dataclass(frozen=True, slots=True)
class _Measured:
    """What limits are held against; `known`: whether the expanded uncertainty of an elevation is."""

    found: OverRange
    reference: Reference | None
    reference_std: tuple[float, float] | None
    rms_deg: float
    level_known: bool

    @property
    def known(self) -> bool:
        return self.found.expanded_uncertainty_deg is not None


def held_against(
    limit: Limit, result: Document, calibration: Document | None, *, relied_on: bool
) -> LimitVerdict:
    """Holds a result against a limit.

    What is calibrated is the elevation, so the largest error is the one that is left after everything
    accepted was applied; bias and scale are held as they were found. Until the level is known, elevations
    are relative to their mean over the range: the largest error is that, and a limit on the bias cannot be
    decided. What cannot be decided, and whatever has no uncertainty, is never passed.

    Args:
        limit: that matches the unit.
        result: CONTRACT section 2's, with `over_range`.
        calibration: CONTRACT section 6's, of the same poses; its figures go before those of the result.
        relied_on: False where something says that the poses do not belong together.
    """
    measured = _measured(result, calibration)
    if measured is None:
        return _nothing_to_hold(limit, result)
    figures = list(_figures(limit, measured))
    decided = [figure.answer for figure in figures if figure.answer is not None]
    answer = worst(decided or ["conditional_pass"])
    if answer == "pass" and (len(decided) < len(figures) or not relied_on):
        answer = "conditional_pass"
    probability = _probability(limit, measured) if decided else None
    return LimitVerdict(
        answer=answer,
        says=(
            f"{IN_WORDS[answer]} against the limits “{limit.name}” ({limit.rule_in_words}).",
            *(figure.says for figure in figures),
            *_risk(answer, probability, of="the unit" if len(decided) == len(figures) else "what is decided"),
        ),
        probability_of_conformity=probability,
        probability_of_false_accept=1.0 - probability
        if answer == "pass" and probability is not None
        else None,
    )


def _nothing_to_hold(limit: Limit, result: Document) -> LimitVerdict:
    """The answer where no error over the range was kept, or there is none."""
    against = f"against the limits “{limit.name}”"
    if result["rms_calibrated_deg"] is None:
        return LimitVerdict("fail", (f"Fail {against}: the reading does not follow the stage.",), 0.0, None)
    says = (
        f"Conditional pass {against}: not decided.",
        "An earlier version of calrig computed this result, and did not keep what limits ask about.",
    )
    return LimitVerdict("conditional_pass", says, None, None)


def _measured(result: Document, calibration: Document | None) -> _Measured | None:
    over = result.get("over_range")
    if over is None:
        return None
    found = OverRange.from_dict(over)
    if calibration is not None:
        same = ("bias_deg", "scale", "covariance", "expanded_uncertainty_deg", "coverage_factor")
        own_deg = found.error_expanded_uncertainty_deg
        found = replace(found, **{key: frozen(calibration[key]) for key in same})
        if own_deg is not None and found.expanded_uncertainty_deg is not None:
            least_deg = min(own_deg, found.expanded_uncertainty_deg)
            found = replace(found, error_expanded_uncertainty_deg=least_deg)
    stage = result.get("reference")
    rms = result["rms_calibrated_deg" if result["rms_with_effects_deg"] is None else "rms_with_effects_deg"]
    return _Measured(
        found=found,
        reference=stage and ReferenceFigures.from_dict(stage).reference,
        reference_std=stage and (stage["bias_std_deg"], stage["scale_std"] or 0.0),
        rms_deg=rms,
        level_known=bool((calibration or {}).get("level_known", False)),
    )


def _figures(limit: Limit, measured: _Measured) -> Iterator[_Figure]:
    found = measured.found
    expanded_deg = found.expanded_uncertainty_deg
    if limit.max_error_deg is not None:
        yield _largest_error(limit, limit.max_error_deg, measured)
    if limit.bias_deg is not None:
        if not measured.level_known:
            said = f"Bias {deg(found.bias_deg)}: not decided, for the level is not known"
            yield _Figure(f"{said}: it may be the clamping's.", None)
        else:
            yield _between("Bias", "°", limit, found.bias_deg, limit.bias_deg, _expanded_of(measured, 0))
    if limit.scale is not None:
        if found.scale is None:
            yield _Figure("Scale: not decided, for all poses stand at one elevation.", None)
        else:
            yield _between("Scale", "", limit, found.scale, limit.scale, _expanded_of(measured, 1))
    if limit.rms_deg is not None:
        of_rms = 1.96 * measured.rms_deg / math.sqrt(2.0 * max(found.freedom, 1))
        answer = decide(limit, measured.rms_deg - limit.rms_deg, of_rms, known=measured.known)
        yield _at_most(f"RMS error {deg(measured.rms_deg)}", of_rms, limit.rms_deg, answer)
    if limit.expanded_uncertainty_deg is not None:
        if expanded_deg is None:
            yield _Figure("Expanded uncertainty: not known, so that nothing passes.", None)
        else:
            within = expanded_deg <= limit.expanded_uncertainty_deg
            yield _at_most(
                "Expanded uncertainty",
                expanded_deg,
                limit.expanded_uncertainty_deg,
                "pass" if within else "fail",
            )


def _largest_error(limit: Limit, allowed_deg: float, measured: _Measured) -> _Figure:
    found = measured.found
    level_deg = 0.0 if measured.level_known else found.mean_error_deg
    at_ends = zip(found.lowest_error_deg, found.highest_error_deg, strict=True)
    errors = [max(abs(low - level_deg), abs(high - level_deg)) for low, high in at_ends]
    largest = max(errors)
    low, high = found.elevation_deg[0], found.elevation_deg[-1]
    if low == high and not measured.level_known:
        return _Figure(
            "Largest error: not decided, for at one elevation nothing is relative to the others.", None
        )
    where = f"Largest error {deg(largest)}, near {found.elevation_deg[errors.index(largest)]:g}°".replace(
        "-", "−"
    )
    if not measured.level_known:
        where += (
            f", of the elevation less its mean over {low:g}° to {high:g}° (the level is not known)".replace(
                "-", "−"
            )
        )
    expanded_deg = found.error_expanded_uncertainty_deg
    answer = decide(limit, largest - allowed_deg, expanded_deg, known=measured.known)
    return _at_most(where, expanded_deg, allowed_deg, answer)


def _at_most(what: str, expanded_deg: float | None, allowed_deg: float, answer: Answer) -> _Figure:
    u = "U not known" if expanded_deg is None else f"U = {deg(expanded_deg)}"
    return _Figure(f"{what}, {u}; at most {deg(allowed_deg)} allowed: {IN_WORDS[answer].lower()}.", answer)


def _between(
    name: str, unit: str, limit: Limit, value: float, allowed: tuple[float, float], expanded: float | None
) -> _Figure:
    answer = decide(limit, beyond_interval(value, allowed), expanded, known=expanded is not None)
    u = "U not known" if expanded is None else f"U = {significant(expanded)}{unit}"
    low, high = (f"{end:g}{unit}".replace("-", "−") for end in allowed)
    shown = f"{value:.3f}{unit}" if unit else f"{value:.5f}"
    return _Figure(
        f"{name} {shown.replace('-', '−')}, {u}; {low} to {high} allowed: {IN_WORDS[answer].lower()}.", answer
    )


def _expanded_of(measured: _Measured, which: int) -> float | None:
    """Expanded uncertainty of bias (0) or scale (1), its type A and the stage's part combined."""
    found, reference = measured.found, measured.reference
    if found.covariance is None or reference is None or measured.reference_std is None or not measured.known:
        return None
    own, of_stage = math.sqrt(found.covariance[which][which]), measured.reference_std[which]
    distribution = "normal" if reference.kind == "setting" else reference.distribution
    return coverage_factor(own, found.freedom, of_stage, distribution) * math.hypot(own, of_stage)


def _probability(limit: Limit, measured: _Measured) -> float | None:
    if measured.reference is None or not measured.known:
        return None
    asked = limit.expanded_uncertainty_deg
    if asked is not None and (measured.found.expanded_uncertainty_deg or 0.0) > asked:
        return 0.0
    return probability_of_conformity(
        replace(limit, name="", units="*", rig=None, rule="simple", guard=1.0),
        measured.found,
        measured.reference,
        rms_deg=measured.rms_deg,
        level_known=measured.level_known,
    )


def _risk(answer: Answer, probability: float | None, *, of: str) -> list[str]:
    if probability is None:
        return ["How probable it is that the unit conforms is not known."]
    said = f"By the uncertainty of this result, {of} conforms with a probability of {percent(probability)}"
    if answer != "pass":
        return [f"{said}."]
    return [f"{said}: the risk of a false acceptance is {percent(1.0 - probability)}."]
