"""Judge a result: the residual against noise, conformity with limits, and the sentences that say so.

The few numbers that a verdict's answer follows from, whatever the limits: kept of a run, they find it.

A result held against the limits that match it: figure by figure, and all together.

Whether a result is good: what is left after everything accepted, against what noise alone would leave.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Protocol

from calrig.calibration.diagnosis.verdict import (
    CONFIDENCE,
    ELSEWHERE,
    between_runs,
    not_repeated_better,
    upper_limit,
)
from calrig.calibration.uncertainty.budget import frozen
from calrig.calibration.uncertainty.conformity import (
    beyond_interval,
    decide,
    deg,
    percent,
    probability_of_conformity,
    significant,
    worst,
)
from calrig.calibration.uncertainty.coverage import coverage_factor
from calrig.calibration.uncertainty.doubts import STAYS_A_DRAFT, doubts_of
from calrig.model.result import RangeErrors, Reference, Result
from calrig.model.verdict import Answer, Interval, Left, Limit, Verdict


class Figures(Protocol):
    """What limits are held against; None where it is not known, or cannot be decided by these poses.

    `expanded_deg` is the expanded uncertainty of a calibrated elevation, the others that of their figure.
    """

    @property
    def largest_error_deg(self) -> float | None: ...  # noqa: D102
    @property
    def error_expanded_deg(self) -> float | None: ...  # noqa: D102
    @property
    def bias_deg(self) -> float | None: ...  # noqa: D102
    @property
    def bias_expanded_deg(self) -> float | None: ...  # noqa: D102
    @property
    def scale(self) -> float | None: ...  # noqa: D102
    @property
    def scale_expanded(self) -> float | None: ...  # noqa: D102
    @property
    def rms_deg(self) -> float | None: ...  # noqa: D102
    @property
    def rms_expanded_deg(self) -> float | None: ...  # noqa: D102
    @property
    def expanded_deg(self) -> float | None: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Decided:
    """A figure held against its limit; `expanded` is None where its uncertainty is not known."""

    value: float
    expanded: float | None
    answer: Answer


def decisions(limit: Limit, figures: Figures) -> dict[str, Decided | None]:
    """How all that a limit asks is decided, by the name it has there; None where it cannot be."""
    found: dict[str, Decided | None] = {}
    expanded_deg = figures.expanded_deg
    if limit.max_error_deg is not None:
        error_deg, of_error = figures.largest_error_deg, figures.error_expanded_deg
        known = expanded_deg is not None
        found["max_error_deg"] = _decide_at_most(limit, error_deg, limit.max_error_deg, of_error, known=known)
    if limit.bias_deg is not None:
        bias_deg = figures.bias_deg
        of_bias = None if bias_deg is None else figures.bias_expanded_deg
        found["bias_deg"] = _decide_between(limit, bias_deg, limit.bias_deg, of_bias)
    if limit.scale is not None:
        found["scale"] = _decide_between(limit, figures.scale, limit.scale, figures.scale_expanded)
    if limit.rms_deg is not None:
        rms_deg, of_rms = figures.rms_deg, figures.rms_expanded_deg
        known = expanded_deg is not None
        found["rms_deg"] = _decide_at_most(limit, rms_deg, limit.rms_deg, of_rms, known=known)
    if limit.expanded_uncertainty_deg is not None:
        allowed_deg = limit.expanded_uncertainty_deg
        found["expanded_uncertainty_deg"] = (
            None
            if expanded_deg is None
            else Decided(expanded_deg, None, "pass" if expanded_deg <= allowed_deg else "fail")
        )
    return found


def taken_together(found: Iterable[Decided | None], *, relied_on: bool) -> Answer:
    """Return the answer to all that a limit asks: undecided where a part is, unless another part fails."""
    answers: list[Answer] = ["undecided" if one is None else one.answer for one in found]
    if not (answers and relied_on):
        answers.append("undecided")
    return worst(answers)


def _decide_at_most(
    limit: Limit, value: float | None, allowed: float, expanded: float | None, *, known: bool
) -> Decided | None:
    if value is None:
        return None
    return Decided(value, expanded, decide(limit, value - allowed, expanded, known=known))


def _decide_between(
    limit: Limit, value: float | None, allowed: Interval, expanded: float | None
) -> Decided | None:
    if value is None:
        return None
    answer = decide(limit, beyond_interval(value, allowed), expanded, known=expanded is not None)
    return Decided(value, expanded, answer)


@dataclass(frozen=True, slots=True)
class VerdictFigures:
    """Of a run's result, all that the answer and `left` of its verdict follow from, once a limit is given.

    Attributes:
        left: as `calrig.calibration.verdict.Verdict` has it.
        without: the answer to any limit, where there are no figures to hold against it; else None.
        relied_on: False where there is a doubt about the result (`calrig.calibration.uncertainty.doubts`).
        largest_error_deg: and all others as of `Figures`.
    """

    left: Left | None
    without: Answer | None
    relied_on: bool
    largest_error_deg: float | None = None
    error_expanded_deg: float | None = None
    bias_deg: float | None = None
    bias_expanded_deg: float | None = None
    scale: float | None = None
    scale_expanded: float | None = None
    rms_deg: float | None = None
    rms_expanded_deg: float | None = None
    expanded_deg: float | None = None

    def answer(self, limit: Limit | None) -> Answer | Literal["no_limits"]:
        """Against the limit that matches, None where none does."""
        if limit is None:
            return "no_limits"
        if self.without is not None:
            return self.without
        return taken_together(decisions(limit, self).values(), relied_on=self.relied_on)


FIGURES = tuple(one.name for one in fields(VerdictFigures))[3:]
"""The names that `Figures` has."""


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

    found: RangeErrors
    reference: Reference | None
    reference_std: tuple[float, float] | None
    rms_deg: float | None
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
    def rms_expanded_deg(self) -> float | None:
        """Expanded uncertainty of the RMS."""
        if self.rms_deg is None:
            return None
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
    limit: Limit, result: Result, calibration: Document | None, *, relied_on: bool
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


def without_figures(result: Result) -> Answer:
    """The answer where no error over the range was kept, or there is none."""
    return "fail" if result.rms_calibrated_deg is None else "undecided"


def _nothing_to_hold(limit: Limit, result: Result) -> LimitVerdict:
    """The same in words."""
    against, answer = f"against the limits “{limit.name}”", without_figures(result)
    if answer == "fail":
        return LimitVerdict(answer, (f"Fail {against}: the reading does not follow the stage.",), 0.0, None)
    says = (
        f"Undecided {against}.",
        "An earlier version of calrig computed this result, and did not keep what limits ask about.",
    )
    return LimitVerdict(answer, says, None, None)


def measured_of(result: Result, calibration: Document | None = None) -> Measured | None:
    """What of a result limits are held against; None where it has no error over the range."""
    found = result.over_range
    if found is None:
        return None
    if calibration is not None:
        same = ("bias_deg", "scale", "covariance", "expanded_uncertainty_deg", "coverage_factor")
        own_deg = found.error_expanded_uncertainty_deg
        found = replace(found, **{key: frozen(calibration[key]) for key in same})
        if own_deg is not None and found.expanded_uncertainty_deg is not None:
            least_deg = min(own_deg, found.expanded_uncertainty_deg)
            found = replace(found, error_expanded_uncertainty_deg=least_deg)
    stage = result.reference
    with_effects = result.rms_with_effects_deg
    rms = result.rms_calibrated_deg if with_effects is None else with_effects
    return Measured(
        found=found,
        reference=None if stage is None else stage.reference,
        reference_std=None if stage is None else (stage.bias_std_deg, stage.scale_std or 0.0),
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
        yield undecided if bias is None else _say_between("Bias", "°", limit.bias_deg, bias)
    if limit.scale is not None:
        scale, undecided = found["scale"], "Scale: not decided, for all poses stand at one elevation."
        yield undecided if scale is None else _say_between("Scale", "", limit.scale, scale)
    if limit.rms_deg is not None and (rms := found["rms_deg"]):
        yield _say_at_most(f"RMS error {deg(rms.value)}", rms.expanded, limit.rms_deg, rms.answer)
    if limit.expanded_uncertainty_deg is not None:
        own = found["expanded_uncertainty_deg"]
        yield (
            "Expanded uncertainty: not known, so that nothing passes."
            if own is None
            else _say_at_most("Expanded uncertainty", own.value, limit.expanded_uncertainty_deg, own.answer)
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
    return _say_at_most(where, largest.expanded, allowed_deg, largest.answer)


def _say_at_most(what: str, expanded_deg: float | None, allowed_deg: float, answer: Answer) -> str:
    u = "U not known" if expanded_deg is None else f"U = {deg(expanded_deg)}"
    return f"{what}, {u}; at most {deg(allowed_deg)} allowed: {IN_WORDS[answer].lower()}."


def _say_between(name: str, unit: str, allowed: Interval, found: Decided) -> str:
    u = "U not known" if found.expanded is None else f"U = {significant(found.expanded)}{unit}"
    low, high = (f"{end:g}{unit}".replace("-", "−") for end in allowed)
    shown = f"{found.value:.3f}{unit}" if unit else f"{found.value:.5f}"
    return (
        f"{name} {shown.replace('-', '−')}, {u}; {low} to {high} allowed: {IN_WORDS[found.answer].lower()}."
    )


def _probability(limit: Limit, measured: Measured) -> float | None:
    if measured.reference is None or measured.expanded_deg is None or measured.rms_deg is None:
        return None
    asked = limit.expanded_uncertainty_deg
    if asked is not None and (measured.found.expanded_uncertainty_deg or 0.0) > asked:
        return 0.0
    return probability_of_conformity(
        limit.model_copy(update={"name": "", "units": "*", "rig": None, "rule": "simple", "guard": 1.0}),
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


FEW_POSES = 6
WORTH_APPLYING = 3.0
"""Standard errors by which a scale must differ from 1 before it is worth applying."""


def verdict(
    result: Result,
    diagnosis: Document | None = None,
    *,
    verification: bool = False,
    move_mismatches: int = 0,
    limit: Limit | None = None,
    calibration: Document | None = None,
) -> Verdict:
    """Judges a run's result.

    With s the standard error of one reading (`noise_deg`, pooled from within the dwells), n poses and p
    fitted parameters, noise alone leaves residuals r with Σr²/s² distributed as χ² with ν = n − p degrees of
    freedom (Draper & Smith, Applied Regression Analysis, 1998, section 2.1, lack of fit with σ known). So
    ratio = √(Σr²/(ν·s²)), and noise alone keeps it under √(χ²(0.99; ν)/ν): 1.34 of 26 poses, 1.08 of 500.

    Args:
        result: CONTRACT section 2's, bias and scale (and accepted effects) with what they leave.
        diagnosis: the run's last one, CONTRACT section 5; None before.
        verification: a calibration made earlier was applied; nothing was fitted to these poses.
        move_mismatches: of the run's moves, how many the unit felt otherwise than the stage reported; counts
            where the result keeps no `doubts`.
        limit: that matches the unit; None where none does.
        calibration: the document made of these poses, CONTRACT section 6; its figures are what the limit is
            held against, where there is one.
    """
    ratio, bound, freedom = _over_noise(result, diagnosis, verification=verification)
    left = _left(ratio, bound)
    doubts = doubts_of(result, move_mismatches=move_mismatches, verification=verification)
    held = None if limit is None else held_against(limit, result, calibration, relied_on=not doubts)
    says = [
        *(one.says for one in doubts),
        *([STAYS_A_DRAFT] if doubts and not verification else []),
        *(() if held is None else held.says),
        *_left_in_words(left, ratio, bound, freedom, alone=held is None),
        _before_and_after(result, verification=verification),
        *_of_the_stage(result, freedom, left),
        *([result.reference_says] if result.reference_says else []),
        *_diagnosed(diagnosis, left),
        *([] if verification else _scale(result)),
    ]
    if result.n_poses < FEW_POSES:
        says.append(f"It rests on only {_poses(result.n_poses)}.")
    if limit is None or held is None:
        return Verdict("no_limits", left, ratio, tuple(says), limit=None, reliable=not doubts)
    return Verdict(
        answer=held.answer,
        left=left,
        ratio=ratio,
        says=tuple(says),
        limit=limit.name,
        probability_of_conformity=held.probability_of_conformity,
        probability_of_false_accept=held.probability_of_false_accept,
        reliable=not doubts,
    )


def verdict_figures(
    result: Result, diagnosis: Document | None, *, verification: bool, move_mismatches: int
) -> VerdictFigures:
    """What `answer` and `left` of a run's verdict follow from, of the same arguments."""
    ratio, bound, _ = _over_noise(result, diagnosis, verification=verification)
    left, measured = _left(ratio, bound), measured_of(result)
    relied_on = not doubts_of(result, move_mismatches=move_mismatches, verification=verification)
    if measured is None:
        return VerdictFigures(left, without_figures(result), relied_on=relied_on)
    kept = {name: getattr(measured, name) for name in FIGURES}
    return VerdictFigures(left, None, relied_on=relied_on, **kept)


def _over_noise(
    result: Result, diagnosis: Document | None, *, verification: bool
) -> tuple[float | None, float | None, int]:
    """What is left over what noise would leave, the bound of noise alone, and the degrees of freedom."""
    fitted = 0 if verification else _fitted_parameters(result, diagnosis)
    freedom = result.n_poses - fitted
    ratio = _ratio(result, freedom)
    return ratio, None if ratio is None else upper_limit(freedom), freedom


def _left(ratio: float | None, bound: float | None) -> Left | None:
    if ratio is None or bound is None:
        return None
    return "noise" if ratio <= bound else "more_than_noise"


def _fitted_parameters(result: Result, diagnosis: Document | None) -> int:
    """Bias, scale, and what was fitted to these poses of the effects accepted from their diagnosis."""
    line = 1 if result.scale is None else 2
    if diagnosis is None or result.rms_with_effects_deg is None:
        return line
    accepted = [effect for effect in diagnosis["effects"] if effect.get("accepted_at") is not None]
    values = [value for effect in accepted for value in effect["parameters"].values()]
    return line + sum(value is not None and value["std"] is not None for value in values)


def _left_deg(result: Result) -> float | None:
    """RMS that is left of a reading, degrees, after everything accepted."""
    with_effects = result.rms_with_effects_deg
    calibrated = result.rms_calibrated_deg if with_effects is None else with_effects
    scale = result.scale
    return None if calibrated is None else calibrated * (1.0 if scale is None else abs(scale))


def _ratio(result: Result, freedom: int, also_deg: float = 0.0) -> float | None:
    """What is left over what noise (and a further error of each pose) would leave."""
    left_deg, noise_deg = _left_deg(result), result.noise_deg
    if left_deg is None or not noise_deg or freedom < 1:
        return None
    expected_deg = math.hypot(noise_deg, also_deg) * math.sqrt(freedom / result.n_poses)
    return float(left_deg / expected_deg)


def _left_in_words(
    left: str | None, ratio: float | None, bound: float | None, freedom: int, *, alone: bool
) -> list[str]:
    """What is left; `alone` where no limit says whether that is good enough."""
    if ratio is None or bound is None:
        what = "Not judged" if alone else "What is left is not judged"
        return [f"{what}: the noise of a reading is not known, or there are too few poses."]
    noise = "Good: only noise is left." if alone else "Only noise is left."
    return [
        noise if left == "noise" else "More than noise is left.",
        f"The residual RMS is {ratio:.2f} times what noise alone predicts; noise alone stays under "
        f"{bound:.2f} in {100 * CONFIDENCE:.0f} % of runs ({freedom} degrees of freedom).",
    ]


def _before_and_after(result: Result, *, verification: bool) -> str:
    raw, calibrated, both = result.rms_raw_deg, result.rms_calibrated_deg, result.rms_with_effects_deg
    if calibrated is None:
        return f"RMS error {deg(raw)} raw; the reading does not follow the stage and cannot be calibrated."
    if verification:
        applied = calibrated if both is None else both
        words = f"As found, against the document: RMS error {deg(raw)} raw, {deg(applied)} once it is applied"
        if both is not None:
            words += f" ({deg(calibrated)} by its bias and scale alone)"
    else:
        words = f"RMS error {deg(raw)} raw, {deg(calibrated)} calibrated"
        if both is not None:
            words += f", {deg(both)} with accepted effects"
    if result.noise_deg is not None:
        words += f"; standard error of one reading {deg(result.noise_deg)}"
    return f"{words}."


def _of_the_stage(result: Result, freedom: int, left: str | None) -> list[str]:
    """That a stage which sets each pose anew explains what is left, where it does."""
    reference = result.reference
    if left != "more_than_noise" or reference is None or reference.kind != "setting":
        return []
    ratio = _ratio(result, freedom, reference.std_deg)
    if ratio is None or ratio > upper_limit(freedom):
        return []
    return [f"The stage's own setting uncertainty of {deg(reference.std_deg)} accounts for it."]


def _diagnosed(diagnosis: Document | None, left: str | None) -> list[str]:
    """What is known of the cause of what is left."""
    if diagnosis is None:
        return (
            ["Its cause is not known: the run has not been diagnosed."] if left == "more_than_noise" else []
        )
    open_ones = [effect for effect in diagnosis["effects"] if effect.get("accepted_at") is None]
    if not open_ones and left == "more_than_noise":
        return ["The diagnosis names no further effect.", *not_repeated_better(diagnosis)]
    return [_found(effect) for effect in open_ones]


def _found(effect: Document) -> str:
    if effect["verdict"] == "unnamed":
        return "The diagnosis finds an effect that is not in its catalogue."
    rivals = (ELSEWHERE if name == effect["name"] else name for name in effect["confusable_with"])
    names = [name.replace("_", " ") for name in (effect["name"], *rivals)]
    if effect["verdict"] == "named" and effect.get("changed"):
        return f"The diagnosis names {names[0]}{between_runs(effect)}."
    if effect["verdict"] == "named":
        return f"The diagnosis names {names[0]}, which has not been accepted."
    return f"The diagnosis cannot distinguish {' from '.join(names)}."


def _scale(result: Result) -> list[str]:
    scale, std = _scale_as_applied(result)
    if scale is None:
        return ["All poses stand at one elevation: the scale is not known and counts as 1."]
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
    """The scale and its standard error, beside all effects accepted where the result says so."""
    over = result.over_range
    if over is None or over.covariance is None:
        return result.scale, result.scale_std
    return over.scale, math.sqrt(over.covariance[1][1])


def _poses(count: int) -> str:
    return f"{count} pose" if count == 1 else f"{count} poses"
