"""The few numbers that a verdict's answer follows from, whatever the limits: kept of a run, they find it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal, Protocol

from calrig.calibration.conformity import Answer, Interval, Limit, beyond_interval, decide, worst

Left = Literal["noise", "more_than_noise"]


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
        found["max_error_deg"] = _at_most(limit, error_deg, limit.max_error_deg, of_error, known=known)
    if limit.bias_deg is not None:
        bias_deg = figures.bias_deg
        of_bias = None if bias_deg is None else figures.bias_expanded_deg
        found["bias_deg"] = _between(limit, bias_deg, limit.bias_deg, of_bias)
    if limit.scale is not None:
        found["scale"] = _between(limit, figures.scale, limit.scale, figures.scale_expanded)
    if limit.rms_deg is not None:
        rms_deg, of_rms = figures.rms_deg, figures.rms_expanded_deg
        known = expanded_deg is not None
        found["rms_deg"] = _at_most(limit, rms_deg, limit.rms_deg, of_rms, known=known)
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


def _at_most(
    limit: Limit, value: float | None, allowed: float, expanded: float | None, *, known: bool
) -> Decided | None:
    if value is None:
        return None
    return Decided(value, expanded, decide(limit, value - allowed, expanded, known=known))


def _between(limit: Limit, value: float | None, allowed: Interval, expanded: float | None) -> Decided | None:
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
        relied_on: False where there is a doubt about the result (`calrig.calibration.doubts`).
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
