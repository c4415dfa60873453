"""Whether a result is good: what is left after everything accepted, against what noise alone would leave."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from calrig.calibration.conformity import Answer, Limit
from calrig.calibration.diagnosis_verdict import ELSEWHERE, between_runs, not_repeated_better
from calrig.calibration.doubts import STAYS_A_DRAFT, doubts_of
from calrig.calibration.limit_verdict import held_against, measured_of, without_figures
from calrig.calibration.noise_bound import CONFIDENCE, upper_limit
from calrig.calibration.verdict_figures import FIGURES, Left, VerdictFigures
from calrig.calibration.wording import deg

FEW_POSES = 6
WORTH_APPLYING = 3.0
"""Standard errors by which a scale must differ from 1 before it is worth applying."""

Document = Mapping[str, Any]


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


def verdict(
    result: Document,
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
        *([result["reference_says"]] if result.get("reference_says") else []),
        *_diagnosed(diagnosis, left),
        *([] if verification else _scale(result)),
    ]
    if result["n_poses"] < FEW_POSES:
        says.append(f"It rests on only {_poses(result['n_poses'])}.")
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
    result: Document, diagnosis: Document | None, *, verification: bool, move_mismatches: int
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
    result: Document, diagnosis: Document | None, *, verification: bool
) -> tuple[float | None, float | None, int]:
    """What is left over what noise would leave, the bound of noise alone, and the degrees of freedom."""
    fitted = 0 if verification else _fitted_parameters(result, diagnosis)
    freedom = result["n_poses"] - fitted
    ratio = _ratio(result, freedom)
    return ratio, None if ratio is None else upper_limit(freedom), freedom


def _left(ratio: float | None, bound: float | None) -> Left | None:
    if ratio is None or bound is None:
        return None
    return "noise" if ratio <= bound else "more_than_noise"


def _fitted_parameters(result: Document, diagnosis: Document | None) -> int:
    """Bias, scale, and what was fitted to these poses of the effects accepted from their diagnosis."""
    line = 1 if result["scale"] is None else 2
    if diagnosis is None or result["rms_with_effects_deg"] is None:
        return line
    accepted = [effect for effect in diagnosis["effects"] if effect.get("accepted_at") is not None]
    values = [value for effect in accepted for value in effect["parameters"].values()]
    return line + sum(value is not None and value["std"] is not None for value in values)


def _left_deg(result: Document) -> float | None:
    """RMS that is left of a reading, degrees, after everything accepted."""
    with_effects: float | None = result["rms_with_effects_deg"]
    calibrated: float | None = result["rms_calibrated_deg"] if with_effects is None else with_effects
    scale = result["scale"]
    return None if calibrated is None else calibrated * (1.0 if scale is None else abs(scale))


def _ratio(result: Document, freedom: int, also_deg: float = 0.0) -> float | None:
    """What is left over what noise (and a further error of each pose) would leave."""
    left_deg, noise_deg = _left_deg(result), result["noise_deg"]
    if left_deg is None or not noise_deg or freedom < 1:
        return None
    expected_deg = math.hypot(noise_deg, also_deg) * math.sqrt(freedom / result["n_poses"])
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


def _before_and_after(result: Document, *, verification: bool) -> str:
    raw, calibrated, both = (
        result[key] for key in ("rms_raw_deg", "rms_calibrated_deg", "rms_with_effects_deg")
    )
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
    if result["noise_deg"] is not None:
        words += f"; standard error of one reading {deg(result['noise_deg'])}"
    return f"{words}."


def _of_the_stage(result: Document, freedom: int, left: str | None) -> list[str]:
    """That a stage which sets each pose anew explains what is left, where it does."""
    reference = result.get("reference")
    if left != "more_than_noise" or reference is None or reference["kind"] != "setting":
        return []
    ratio = _ratio(result, freedom, reference["std_deg"])
    if ratio is None or ratio > upper_limit(freedom):
        return []
    return [f"The stage's own setting uncertainty of {deg(reference['std_deg'])} accounts for it."]


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


def _scale(result: Document) -> list[str]:
    scale, std = _scale_as_applied(result)
    if scale is None:
        return ["All poses stand at one elevation: the scale is not known and counts as 1."]
    if not std:
        return []
    distance = abs(scale - 1.0)
    if distance <= WORTH_APPLYING * std:
        return ["The scale does not differ significantly from 1."]
    words = f"The scale differs from 1 by {distance / std:.0f} standard errors"
    of_stage = (result.get("reference") or {}).get("scale_std") or 0.0
    if distance > WORTH_APPLYING * math.hypot(std, of_stage):
        return [f"{words}."]
    return [f"{words}, but no more than the stage's own uncertainty allows."]


def _scale_as_applied(result: Document) -> tuple[float | None, float | None]:
    """The scale and its standard error, beside all effects accepted where the result says so."""
    over = result.get("over_range")
    if over is None or over["covariance"] is None:
        return result["scale"], result["scale_std"]
    return over["scale"], math.sqrt(over["covariance"][1][1])


def _poses(count: int) -> str:
    return f"{count} pose" if count == 1 else f"{count} poses"
