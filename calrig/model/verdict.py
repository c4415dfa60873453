"""The verdict on a result, the limit that it is tested against, and the figures that it follows from.

`calrig.calibration.uncertainty.verdict` makes verdicts; `calrig.store.verdicts` finds runs by them.
"""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from pydantic import BaseModel

from calrig.model.base import Model

Answer = Literal["pass", "conditional_pass", "conditional_fail", "fail", "undecided"]
Left = Literal["noise", "more_than_noise"]
Interval = tuple[float, float]


class Limit(Model):
    """What a unit must comply with (CONTRACT section 2, `/api/limits`); None sets no limit on that figure.

    Attributes:
        name: title for users.
        units: pattern of serial numbers, `*` and `?` as in file names, case-sensitive.
        rig: only results of this rig; None for all.
        max_error_deg: largest error of a calibrated elevation over the range.
        bias_deg, scale: lowest and highest allowed value.
        rms_deg: RMS of the residual after every accepted effect.
        expanded_uncertainty_deg: largest allowed expanded uncertainty.
        rule: decision rule, `simple` or `guarded`.
        guard: guard band w over U of the guarded rule.
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
        """Return the decision rule for a sentence, such as `guarded rule, w = 1·U`."""
        return "simple rule" if self.rule == "simple" else f"guarded rule, w = {self.guard:g}·U"


class Figures(BaseModel):
    """What limits are tested on: a result's figures, each with its own expanded uncertainty.

    None: not known, or these poses cannot decide it. The table `verdict_figures` has these columns.

    Attributes:
        largest_error_deg: largest error of a calibrated elevation over the range.
        bias_deg: bias as found; None while the level is unknown, because the clamping may cause it.
        scale: scale as found; None if all poses are at one elevation.
        rms_deg: RMS of the residual after every accepted effect.
        expanded_deg: expanded uncertainty of a calibrated elevation.
    """

    largest_error_deg: float | None = None
    error_expanded_deg: float | None = None
    bias_deg: float | None = None
    bias_expanded_deg: float | None = None
    scale: float | None = None
    scale_expanded: float | None = None
    rms_deg: float | None = None
    rms_expanded_deg: float | None = None
    expanded_deg: float | None = None


class VerdictFigures(Figures):
    """What `answer` and `left` of a run's verdict follow from, whatever the limits.

    Attributes:
        left: as in `Verdict`.
        without: the answer to any limit if the result has no figures to test; else None.
        relied_on: False if there is a doubt about the result (`calrig.calibration.uncertainty.doubts`).
    """

    left: Left | None
    without: Answer | None
    relied_on: bool


@dataclass(frozen=True)
class Verdict:
    """CONTRACT section 2, "Verdict".

    Attributes:
        answer: conformity with the limit that matches; `no_limits` if none does.
        left: residual after every accepted effect; None if the noise is unknown.
        ratio: residual RMS over the one that noise alone predicts, 1 at best; None if the noise is unknown.
        says: the verdict in sentences, the answer first.
        limit: name of the limit that was applied.
        probability_of_conformity: that the true figures comply with the limit; None without a limit, and if
            it is unknown.
        probability_of_false_accept: that a pass is wrong; None for every other answer.
        reliable: False if a person must decide before anything is released; None in verdicts that were
            issued before this field existed.
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
