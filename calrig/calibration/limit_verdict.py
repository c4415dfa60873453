"""A result held against the limits that match it: figure by figure, and all together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from calrig.calibration.conformity import Answer, Interval, Limit
from calrig.calibration.coverage import coverage_factor
from calrig.calibration.over_range import OverRange, frozen
from calrig.calibration.reference_figures import ReferenceFigures
from calrig.calibration.specific_risk import probability_of_conformity
from calrig.calibration.uncertainty import Reference
from calrig.calibration.verdict_figures import Decided, decisions, taken_together
from calrig.calibration.wording import deg, percent, significant

Document = Mapping[str, Any]

IN_WORDS: dict[Answer, str] = {
    "pass": "Pass",
    "conditional_pass": "Conditional pass",
    "conditional_fail": "Conditional fail",
    "fail": "Fail",
    "undecided": "Undecided",
}


@dataclass(frozen=True, slots=True)
class LimitVerdict:
    """The answer to a limit, in sentences as well, and its specific risk; None where that is not known."""

    answer: Answer
    says: tuple[str, ...]
    probability_of_conformity: float | None
    probability_of_false_accept: float | None


@dataclass(frozen=True, slots=True)
class Measured:
    """What limits are held against, with all that is said of it.

    Attributes:
        found: bias, scale, and the errors over the range.
        reference: what the stage is worth; None where nobody has said.
        reference_std: its part of bias and scale.
        rms_deg: what is left after everything accepted.
        level_known: whether elevations are absolute.
    """

    found: OverRange
    reference: Reference | None
    reference_std: tuple[float, float] | None
    rms_deg: float
    level_known: bool

    @property
    def largest_error_deg(self) -> float | None:
        """Over the range; None where at one elevation nothing is relative to the others."""
        found = self.found
        if found.elevation_deg[0] == found.elevation_deg[-1] and not self.level_known:
            return None
        return max(self.errors_deg)

    @property
    def errors_deg(self) -> list[float]:
        """The larger of each stretch of the range; relative to the mean until the level is known."""
        level_deg = 0.0 if self.level_known else self.found.mean_error_deg
        at_ends = zip(self.found.lowest_error_deg, self.found.highest_error_deg, strict=True)
        return [max(abs(low - level_deg), abs(high - level_deg)) for low, high in at_ends]

    @property
    def error_expanded_deg(self) -> float | None:
        """Expanded uncertainty of that error."""
        return self.found.error_expanded_uncertainty_deg

    @property
    def bias_deg(self) -> float | None:
        """As found; None until the level is known, for it may be the clamping's."""
        return self.found.bias_deg if self.level_known else None

    @property
    def bias_expanded_deg(self) -> float | None:
        """Expanded uncertainty of the bias."""
        return self._expanded(0)

    @property
    def scale(self) -> float | None:
        """As found; None where all poses stand at one elevation."""
        return self.found.scale

    @property
    def scale_expanded(self) -> float | None:
        """Expanded uncertainty of the scale."""
        return self._expanded(1)

    @property
    def rms_expanded_deg(self) -> float:
        """Expanded uncertainty of the RMS."""
        return 1.96 * self.rms_deg / math.sqrt(2.0 * max(self.found.freedom, 1))

    @property
    def expanded_deg(self) -> float | None:
        """Expanded uncertainty of a calibrated elevation; None where it is not known."""
        return self.found.expanded_uncertainty_deg

    def _expanded(self, which: int) -> float | None:
        """Of bias (0) or scale (1), its type A and the stage's part combined."""
        found, reference = self.found, self.reference
        if found.covariance is None or reference is None or self.reference_std is None:
            return None
        if self.expanded_deg is None:
            return None
        own, of_stage = math.sqrt(found.covariance[which][which]), self.reference_std[which]
        distribution = "normal" if reference.kind == "setting" else reference.distribution
        return coverage_factor(own, found.freedom, of_stage, distribution) * math.hypot(own, of_stage)


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
        relied_on: False where there is a doubt about the result: it is undecided then, unless it fails.
    """
    measured = measured_of(result, calibration)
    if measured is None:
        return _nothing_to_hold(limit, result)
    found = decisions(limit, measured)
    all_decided, any_decided = None not in found.values(), any(found.values())
    answer = taken_together(found.values(), relied_on=relied_on)
    probability = _probability(limit, measured) if any_decided else None
    return LimitVerdict(
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


def without_figures(result: Document) -> Answer:
    """The answer where no error over the range was kept, or there is none."""
    return "fail" if result["rms_calibrated_deg"] is None else "undecided"


def _nothing_to_hold(limit: Limit, result: Document) -> LimitVerdict:
    """The same in words."""
    against, answer = f"against the limits “{limit.name}”", without_figures(result)
    if answer == "fail":
        return LimitVerdict(answer, (f"Fail {against}: the reading does not follow the stage.",), 0.0, None)
    says = (
        f"Undecided {against}.",
        "An earlier version of calrig computed this result, and did not keep what limits ask about.",
    )
    return LimitVerdict(answer, says, None, None)


def measured_of(result: Document, calibration: Document | None = None) -> Measured | None:
    """What of a result limits are held against; None where it has no error over the range."""
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
    return Measured(
        found=found,
        reference=stage and ReferenceFigures.from_dict(stage).reference,
        reference_std=stage and (stage["bias_std_deg"], stage["scale_std"] or 0.0),
        rms_deg=rms,
        level_known=bool((calibration or {}).get("level_known", False)),
    )


def _says(limit: Limit, measured: Measured, found: Mapping[str, Decided | None]) -> Iterator[str]:
    """What is said of each figure that the limit asks about; where it is not decided, why not."""
    if limit.max_error_deg is not None:
        yield _largest_error(limit.max_error_deg, measured, found["max_error_deg"])
    if limit.bias_deg is not None:
        bias, shown = found["bias_deg"], deg(measured.found.bias_deg)
        undecided = f"Bias {shown}: not decided, for the level is not known: it may be the clamping's."
        yield undecided if bias is None else _between("Bias", "°", limit.bias_deg, bias)
    if limit.scale is not None:
        scale, undecided = found["scale"], "Scale: not decided, for all poses stand at one elevation."
        yield undecided if scale is None else _between("Scale", "", limit.scale, scale)
    if limit.rms_deg is not None and (rms := found["rms_deg"]):
        yield _at_most(f"RMS error {deg(rms.value)}", rms.expanded, limit.rms_deg, rms.answer)
    if limit.expanded_uncertainty_deg is not None:
        own = found["expanded_uncertainty_deg"]
        yield (
            "Expanded uncertainty: not known, so that nothing passes."
            if own is None
            else _at_most("Expanded uncertainty", own.value, limit.expanded_uncertainty_deg, own.answer)
        )


def _largest_error(allowed_deg: float, measured: Measured, largest: Decided | None) -> str:
    found, errors = measured.found, measured.errors_deg
    if largest is None:
        return "Largest error: not decided, for at one elevation nothing is relative to the others."
    low, high = found.elevation_deg[0], found.elevation_deg[-1]
    near = round(found.elevation_deg[errors.index(largest.value)], 2)
    where = f"Largest error {deg(largest.value)}, near {near:g}°".replace("-", "−")
    if not measured.level_known:
        over = f"{low:.4g}° to {high:.4g}°".replace("-", "−")
        where += f", of the elevation less its mean over {over} (the level is not known)"
    return _at_most(where, largest.expanded, allowed_deg, largest.answer)


def _at_most(what: str, expanded_deg: float | None, allowed_deg: float, answer: Answer) -> str:
    u = "U not known" if expanded_deg is None else f"U = {deg(expanded_deg)}"
    return f"{what}, {u}; at most {deg(allowed_deg)} allowed: {IN_WORDS[answer].lower()}."


def _between(name: str, unit: str, allowed: Interval, found: Decided) -> str:
    u = "U not known" if found.expanded is None else f"U = {significant(found.expanded)}{unit}"
    low, high = (f"{end:g}{unit}".replace("-", "−") for end in allowed)
    shown = f"{found.value:.3f}{unit}" if unit else f"{found.value:.5f}"
    return (
        f"{name} {shown.replace('-', '−')}, {u}; {low} to {high} allowed: {IN_WORDS[found.answer].lower()}."
    )


def _probability(limit: Limit, measured: Measured) -> float | None:
    if measured.reference is None or measured.expanded_deg is None:
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
