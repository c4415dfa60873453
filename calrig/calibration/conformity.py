"""Limits, and whether a result conforms to them, after JCGM 106:2012 and ILAC-G8:09/2019.

The simple rule takes the measured figure for the true one: of units at their limit, half are wrongly
accepted. The guarded rule keeps them away from the limit L by w = guard·U, and has four answers (ILAC-G8,
4.2.3): pass ≤ L − w < conditional pass ≤ L < conditional fail ≤ L + w < fail. What lies within its limit
and has no known uncertainty is undecided.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np

from calrig.calibration.coverage import COVERAGE, coverage_factor
from calrig.calibration.uncertainty import Reference, reference_part
from calrig.calibration.wording import deg, significant
from calrig.estimation.angles import FloatArray

Answer = Literal["pass", "conditional_pass", "conditional_fail", "fail", "undecided"]
ANSWERS: tuple[Answer, ...] = ("pass", "conditional_pass", "conditional_fail", "undecided", "fail")
"""In the order in which the later one decides over the earlier ones, of several figures."""
Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Limit:
    """What units are held against (CONTRACT section 2, `/api/limits`); None: nothing is asked of that.

    Attributes:
        name: what people call it.
        units: pattern of serial numbers, `*` and `?` as in file names, capitals as they stand.
        rig: only results of this rig; None for all.
        max_error_deg: largest error of a calibrated elevation over the range.
        bias_deg, scale: lowest and highest, as found.
        rms_deg: RMS of what is left after everything accepted.
        expanded_uncertainty_deg: largest expanded uncertainty.
        rule: `simple` or `guarded`.
        guard: w over U of the guarded rule.
    """

    name: str
    units: str = "*"
    rig: str | None = None
    max_error_deg: float | None = None
    bias_deg: Interval | None = None
    scale: Interval | None = None
    rms_deg: float | None = None
    expanded_uncertainty_deg: float | None = None
    rule: Literal["simple", "guarded"] = "simple"
    guard: float = 1.0

    @classmethod
    def from_dict(cls, document: dict[str, Any]) -> Limit:
        """The limit of a JSON object with these keys."""
        pairs = {key: tuple(document[key]) for key in ("bias_deg", "scale") if document.get(key) is not None}
        return cls(**{**document, **pairs})

    def to_dict(self) -> dict[str, Any]:
        """The limit ready for JSON."""
        pairs = {
            key: list(value) for key in ("bias_deg", "scale") if (value := getattr(self, key)) is not None
        }
        return {**asdict(self), **pairs}

    @property
    def rule_in_words(self) -> str:
        """Such as `guarded rule, w = 1·U`."""
        return "simple rule" if self.rule == "simple" else f"guarded rule, w = {self.guard:g}·U"


def limit_for(limits: Iterable[Limit], unit: str, rig: str | None) -> Limit | None:
    """The first limit that matches a unit, on a rig; None where none does."""
    matching = (one for one in limits if fnmatchcase(unit, one.units) and one.rig in {None, rig})
    return next(matching, None)


def decide(limit: Limit, beyond: float, expanded: float | None, *, known: bool = True) -> Answer:
    """The answer of a limit's rule.

    Args:
        limit: its rule and guard.
        beyond: how far the figure lies beyond its limit; within it, negative or 0.
        expanded: expanded uncertainty U of the figure; None where it is not known.
        known: whether that of the calibrated elevation is: without it nothing passes.
    """
    within = beyond <= 0.0
    if limit.rule == "simple":
        if not within:
            return "fail"
        return "pass" if known and expanded is not None else "undecided"
    if expanded is None or not known:
        return "undecided" if within else "conditional_fail"
    width = limit.guard * expanded
    if within:
        return "pass" if beyond <= -width else "conditional_pass"
    return "conditional_fail" if beyond <= width else "fail"


def worst(answers: Sequence[Answer]) -> Answer:
    """The answer to all of them together, by the order of `ANSWERS`."""
    return max(answers, key=ANSWERS.index)


def beyond_interval(value: float, allowed: Interval) -> float:
    """How far a value lies outside of an interval; within it, minus its distance from the nearer end."""
    return max(allowed[0] - value, value - allowed[1])


def cannot_pass(limit: Limit, reference: Reference | None, theta_deg: FloatArray) -> list[str]:
    """Why no unit can pass a limit on a stage, however good it is: known before anything moves.

    Only what the stage itself contributes is counted, so that these are certain.

    Args:
        limit: that matches the unit.
        reference: what the stage's own angle is worth; None where nobody has said.
        theta_deg: (n,) elevations of the poses to come.
    """
    against = f"limits “{limit.name}”, {limit.rule_in_words}"
    if reference is None:
        return [
            "No unit can pass on this stage: its rig does not say what the stage's angle is worth "
            f"(`reference`), and without an expanded uncertainty nothing passes ({against})."
        ]
    scale = 1.0 if np.ptp(theta_deg) > 0.0 else None
    part = reference_part(theta_deg, scale, reference)
    distribution = "normal" if reference.kind == "setting" else reference.distribution
    k = coverage_factor(0.0, 1.0, 1.0, distribution)
    of_elevation = k * part.elevation_deg
    reasons = []
    if limit.expanded_uncertainty_deg is not None and of_elevation > limit.expanded_uncertainty_deg:
        reasons.append(
            f"U = {deg(of_elevation)} ({100 * COVERAGE:.0f} %) of the stage alone is more than the "
            f"{deg(limit.expanded_uncertainty_deg)} allowed"
        )
    if limit.bias_deg is not None:
        reasons.append("the level is not known, and until it is no limit on the bias can be decided")
    if limit.rule == "guarded":
        room = [("largest error", limit.max_error_deg, of_elevation, "°")]
        if limit.scale is not None and part.scale is not None:
            room.append(("scale", 0.5 * (limit.scale[1] - limit.scale[0]), k * part.scale, ""))
        reasons += [
            f"w = {limit.guard:g}·U with U = {significant(expanded)}{unit} of the stage alone leaves nothing "
            f"of the ±{significant(allowed)}{unit} allowed to the {name}"
            for name, allowed, expanded, unit in room
            if allowed is not None and limit.guard * expanded >= allowed
        ]
    return [f"No unit can pass on this stage: {reason} ({against})." for reason in reasons]
