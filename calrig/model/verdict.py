"""The verdict of a result, and the limit that it is judged by."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from dataclasses import asdict, dataclass
from typing import Any, Literal

from calrig.model.base import Model

Answer = Literal["pass", "conditional_pass", "conditional_fail", "fail", "undecided"]
Left = Literal["noise", "more_than_noise"]
Interval = tuple[float, float]


class Limit(Model):
    """Limits that units are tested against (CONTRACT section 2); null in a field sets no limit.

    `units` is a pattern of serial numbers, `*` and `?` as in file names, case-sensitive; `rig` restricts it
    to results of that rig. `max_error_deg` limits the error of a calibrated elevation over the range,
    `rms_deg` the RMS residual after everything accepted; `bias_deg` and `scale` are lowest and highest.
    `guard` is w/U of the guarded rule.
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

    @property
    def rule_in_words(self) -> str:
        """Such as `guarded rule, w = 1·U`."""
        return "simple rule" if self.rule == "simple" else f"guarded rule, w = {self.guard:g}·U"


@dataclass(frozen=True, slots=True)
class Verdict:
    """CONTRACT section 2, "Verdict".

    Attributes:
        answer: against the limits that match; `no_limits` where none do.
        left: the residual after everything accepted; None where the noise is not known.
        ratio: RMS residual over that of noise alone, 1 at best; None where the noise is not known.
        says: the same in sentences, the answer first.
        limit: name of the limit that was applied.
        probability_of_conformity: that what the limit asks holds of the true figures; None without a limit,
            and where it is not known.
        probability_of_false_accept: of a pass, that it is wrong.
        reliable: False where a person must look before anything is released; None in verdicts that were
            issued before there was this word.
    """

    answer: Answer | Literal["no_limits"]
    left: Left | None
    ratio: float | None
    says: tuple[str, ...]
    limit: str | None
    probability_of_conformity: float | None = None
    probability_of_false_accept: float | None = None
    reliable: bool | None = None

    def to_dict(self) -> dict[str, Any]:
        """The verdict ready for JSON."""
        return {**asdict(self), "says": list(self.says)}
