"""Decide whether a result conforms to its limits (JCGM 106:2012, ILAC-G8:09/2019).

The simple rule takes the measured figure for the true one: of units at their limit, half are wrongly
accepted. The guarded rule keeps them away from the limit L by w = guard·U, and has four answers (ILAC-G8,
4.2.3): pass ≤ L − w < conditional pass ≤ L < conditional fail ≤ L + w < fail. A figure within its limit
whose uncertainty is unknown is undecided.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np

from calrig.calibration.uncertainty.budget import reference_part
from calrig.calibration.uncertainty.coverage import COVERAGE, coverage_factor
from calrig.estimation.angle_text import angle_text
from calrig.estimation.angles import FloatArray
from calrig.model.result import Reference
from calrig.model.verdict import Answer, Figures, Interval, Limit, VerdictFigures


def deg(value: float) -> str:
    """Format an angle with two significant digits and the degree sign."""
    return angle_text(value, 2)


def deg_and_limit(value: float, limit: float) -> tuple[str, str]:
    """Format an angle and its upper limit; the digits show on which side of the limit the angle lies."""

    def shown(number: float, digits: int) -> float:
        return float(f"{number:.{digits - 1}e}")

    of_limit = next((digits for digits in range(2, 12) if shown(limit, digits) == limit), 12)
    side = value > limit, value == limit
    digits = next(
        (n for n in range(2, 17) if (shown(value, n) > limit, shown(value, n) == limit) == side), 17
    )
    return angle_text(value, digits), angle_text(limit, of_limit)


def significant(value: float) -> str:
    """Format a value with two significant digits and a typographic minus sign."""
    if value == 0.0 or not 1e-6 <= abs(value) < 1e6:
        return f"{value:.2g}".replace("-", "−", 1)
    return f"{value:.{max(0, 1 - math.floor(math.log10(abs(value))))}f}".replace("-", "−")


def percent(probability: float) -> str:
    """Format a probability in percent; one that rounds to 0 or 100 % becomes a bound."""
    if probability < 5e-5:
        return "less than 0.01 %"
    if probability > 1.0 - 5e-5:
        return "more than 99.99 %"
    return f"{100.0 * probability:.{2 if probability < 0.01 or probability > 0.99 else 1}f} %"


ANSWERS: tuple[Answer, ...] = ("pass", "conditional_pass", "conditional_fail", "undecided", "fail")
"""Ascending precedence: of several figures, the last answer in this order decides."""


def limit_for(limits: Iterable[Limit], unit: str, rig: str | None) -> Limit | None:
    """Return the first limit that matches a unit on a rig; None if none does."""
    matching = (one for one in limits if fnmatchcase(unit, one.units) and one.rig in {None, rig})
    return next(matching, None)


def decide(limit: Limit, beyond: float, expanded: float | None, *, known: bool = True) -> Answer:
    """Apply a limit's decision rule to one figure.

    Args:
        limit: gives rule and guard.
        beyond: distance of the figure beyond its limit; negative or 0 within it.
        expanded: expanded uncertainty U of the figure; None if it is unknown.
        known: whether the expanded uncertainty of the calibrated elevation is known: nothing passes without.
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


def beyond_interval(value: float, allowed: Interval) -> float:
    """Return the distance of a value beyond an interval; negative within it, to the nearer end."""
    return max(allowed[0] - value, value - allowed[1])


TESTED = (
    ("max_error_deg", "largest_error_deg", "error_expanded_deg", True),
    ("bias_deg", "bias_deg", "bias_expanded_deg", False),
    ("scale", "scale", "scale_expanded", False),
    ("rms_deg", "rms_deg", "rms_expanded_deg", True),
)
"""Field of a limit, the figure and the uncertainty it is tested on, and whether it also needs the U of an
elevation to be known."""


@dataclass(frozen=True, slots=True)
class Decided:
    """The answer for one figure; `expanded` is None if its uncertainty is unknown."""

    value: float
    expanded: float | None
    answer: Answer


def decisions(limit: Limit, figures: Figures) -> dict[str, Decided | None]:
    """Decide every figure that a limit sets, by the limit's field name; None where it cannot be decided."""
    u_deg = figures.expanded_deg
    found: dict[str, Decided | None] = {}
    for name, figure, uncertainty, needs_u in TESTED:
        allowed: float | Interval | None = getattr(limit, name)
        if allowed is None:
            continue
        value: float | None = getattr(figures, figure)
        if value is None:
            found[name] = None
            continue
        expanded: float | None = getattr(figures, uncertainty)
        beyond = beyond_interval(value, allowed) if isinstance(allowed, tuple) else value - allowed
        known = u_deg is not None or not needs_u
        found[name] = Decided(value, expanded, decide(limit, beyond, expanded, known=known))
    allowed_deg = limit.expanded_uncertainty_deg
    if allowed_deg is not None:
        found["expanded_uncertainty_deg"] = (
            None if u_deg is None else Decided(u_deg, None, "pass" if u_deg <= allowed_deg else "fail")
        )
    return found


def combined_answer(found: Iterable[Decided | None], *, relied_on: bool) -> Answer:
    """Combine the answers for all figures.

    A figure that fails decides. Otherwise the answer is undecided if a figure is, or if there are no figures,
    or if they are not `relied_on`.
    """
    answers: list[Answer] = ["undecided" if one is None else one.answer for one in found]
    if not (answers and relied_on):
        answers.append("undecided")
    return max(answers, key=ANSWERS.index)


def answer_of(figures: VerdictFigures, limit: Limit | None) -> Answer | Literal["no_limits"]:
    """Return the `answer` of the verdict on a result with these figures, under the limit that matches it."""
    if limit is None:
        return "no_limits"
    if figures.without is not None:
        return figures.without
    return combined_answer(decisions(limit, figures).values(), relied_on=figures.relied_on)


def cannot_pass(limit: Limit, reference: Reference | None, theta_deg: FloatArray) -> list[str]:
    """Return why no unit can pass a limit on a stage, however good it is; known before anything moves.

    Only the stage's own contribution is counted, so that these reasons are certain.

    Args:
        limit: that matches the unit.
        reference: standard uncertainty of the stage's angle; None if it is not stated.
        theta_deg: (n,) elevations of the poses to come.
    """
    against = f"limits “{limit.name}”, {limit.rule_in_words}"
    if reference is None:
        return [
            "No unit can pass on this stage: its rig has no `reference` for the uncertainty of the "
            f"stage's angle, and without an expanded uncertainty nothing passes ({against})."
        ]
    scale = 1.0 if np.ptp(theta_deg) > 0.0 else None
    part = reference_part(theta_deg, scale, reference)
    k = coverage_factor(0.0, 1.0, 1.0, reference.combined_distribution)
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
