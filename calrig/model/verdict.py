"""The verdict of a result, and the limit that it is judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from pydantic import TypeAdapter

Answer = Literal["pass", "conditional_pass", "conditional_fail", "fail", "undecided"]
Left = Literal["noise", "more_than_noise"]
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
    def from_dict(cls, document: Mapping[str, Any]) -> Limit:
        """Return the limit of a JSON object with these keys; keys that are not known are left out."""
        return _LIMIT.validate_python(document)

    def to_dict(self) -> dict[str, Any]:
        """Return the limit ready for JSON."""
        return {
            key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()
        }

    @property
    def rule_in_words(self) -> str:
        """Such as `guarded rule, w = 1·U`."""
        return "simple rule" if self.rule == "simple" else f"guarded rule, w = {self.guard:g}·U"


_LIMIT = TypeAdapter(Limit)


@dataclass(frozen=True, slots=True)
class Verdict:
    """CONTRACT section 2, "Verdict".

    Attributes:
        answer: against the limits that match; `no_limits` where none do.
        left: what is left after everything accepted; None where the noise is not known.
        ratio: RMS of what is left over what noise alone would leave, 1 at best; None likewise.
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
