"""Why a new calibration stays a draft until a person releases it: every reason, with its sentence.

CONTRACT section 2, `reliable`, and section 6, `warnings`. A run's result carries its reasons as `doubts`; the
verdict, the document of its revision, the page, the terminal and the feed show their sentences.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Self

from calrig.calibration.uncertainty.conformity import deg
from calrig.model.result import Doubt, Result

Document = Mapping[str, Any]

ZERO_G_DEG = 4.6
"""What an MPU-6050's zero-g output of 80 mg, its largest (PS-MPU-6000A, 6.2), does to an elevation: the bias
that a sound unit may have before it was ever calibrated."""
REMOUNT_LIMIT_DEG = 1.0
"""As a rig's `remount_limit_deg` is by default: a hand clamps to a degree."""
ODD_SCALE = 1.25
"""No sensor of an angle in degrees errs by a larger factor, whichever way (an MPU-6050's axes by 3 %)."""
STAYS_A_DRAFT = "So its calibration is not released by itself: a person decides, and gives a reason."
"""What a verdict says after its doubts."""
COVERS = 2.0
"""Standard uncertainties that are added to `remount_limit_deg`."""
RESIDUAL_FACTOR = 3.0
"""By how much a residual must exceed the one in force, and the reading noise, to be doubted."""
COUNT_DEG = 0.0035
"""One count of an MPU-6050's accelerometer at ±2 g, 1/16384 g (PS-MPU-6000A, 6.2): no residual is expected
smaller."""
RESIDUAL_P = 1e-4
"""How rarely chance may raise a residual that is doubted."""


@dataclass(frozen=True, slots=True)
class Line:
    """Bias and scale with their standard uncertainties; the scale is None where it is not known."""

    bias_deg: float
    scale: float | None
    bias_std_deg: float
    scale_std: float

    @classmethod
    def of(cls, result: Result, *, other_stage: bool) -> Self:
        """Of a run's result, without accepted effects: as every run can give it.

        Args:
            result: CONTRACT section 2's.
            other_stage: whether it is compared with a run on another stage, whose uncertainty is another one.
        """
        of_bias = of_scale = 0.0
        if other_stage and result.reference is not None:
            of_bias, of_scale = result.reference.bias_std_deg, result.reference.scale_std or 0.0
        return cls(
            result.bias_deg,
            result.scale,
            bias_std_deg=math.hypot(result.bias_std_deg or 0.0, of_bias),
            scale_std=math.hypot(result.scale_std or 0.0, of_scale),
        )


def doubts_of(result: Result, *, move_mismatches: int, verification: bool = False) -> list[Doubt]:
    """Return the doubts of a run's result.

    Args:
        result: CONTRACT section 2's. One without `doubts` is of a run that made no draft, or of an earlier
            version: only what the run itself tells can be said of it.
        move_mismatches: moves of the run in which unit and stage disagree.
        verification: whether the result applies an earlier calibration and fits nothing.
    """
    if "doubts" in result.model_fields_set:
        return result.doubts
    clamping = [] if verification else clamping_doubts(result.bias_deg)
    return [*pose_doubts(result, move_mismatches), *clamping]


def to_dicts(doubts: Sequence[Doubt]) -> list[dict[str, str]]:
    """Return the doubts ready for JSON."""
    return [asdict(one) for one in doubts]


def pose_doubts(result: Result, mismatches: int) -> list[Doubt]:
    """Return what makes a run's own poses doubtful."""
    found = []
    if mismatches:
        moves = "1 move" if mismatches == 1 else f"{mismatches} moves"
        found.append(
            Doubt(
                "move_mismatch",
                f"Not to be relied on: in {moves} the unit measured another rotation than the stage "
                "reported; steps were lost or it slipped there, and poses before and after do not belong "
                "together.",
            )
        )
    if result.rms_calibrated_deg is None:
        found.append(
            Doubt(
                "ambiguous_readings",
                "The reading does not follow the stage: one reading, or noise, stands for every elevation, "
                "or it is not in degrees.",
            )
        )
    elif result.scale is not None and _is_odd(result.scale, result.scale_std):
        found.append(
            Doubt(
                "odd_scale",
                f"The reading changes by {result.scale:.4g}° per degree of elevation: it is not in degrees, "
                "or unit and stage count in opposite senses (sign in the rig's settings).".replace("-", "−"),
            )
        )
    if result.lost_says:
        found.append(Doubt("missing_poses", result.lost_says))
    if result.far_says:
        found.append(Doubt("far_poses", result.far_says))
    return found


def _is_odd(scale: float, scale_std: float | None) -> bool:
    off = max(scale - ODD_SCALE, 1.0 / ODD_SCALE - scale)
    return off > COVERS * (scale_std or 0.0)


def clamping_doubts(
    bias_deg: float, known_deg: float | None = None, remount_limit_deg: float = REMOUNT_LIMIT_DEG
) -> list[Doubt]:
    """Return whether gravity finds the unit at another clamping angle than the plan's.

    Args:
        bias_deg: what the unit reads where the stage stands at 0° and the unit at the plan's mount.
        known_deg: the unit's known bias; None before its first calibration, when it may have the offset that
            its data sheet allows.
        remount_limit_deg: how far remounting may turn a unit.
    """
    if abs(bias_deg - (known_deg or 0.0)) <= ZERO_G_DEG + remount_limit_deg:
        return []
    expected = "" if known_deg is None else f", and {known_deg:+.2f}° by its calibration"
    return [
        Doubt(
            "clamping",
            f"The unit reads {bias_deg:+.1f}° where the stage stands at 0°{expected}: it is clamped at "
            "another angle than the plan says, or the stage's zero is another one.".replace("-", "−"),
        )
    ]


def remount_doubts(
    before: Line, now: Line, range_deg: Sequence[float], remount_limit_deg: float, against: str
) -> list[Doubt]:
    """Compare two calibrations of a unit, where too few repeats tell what remounting adds.

    Args:
        before: of the calibration in force.
        now: of the new one.
        range_deg: its lowest and highest elevation: there the two lines differ most.
        remount_limit_deg: what remounting may add; `COVERS` standard uncertainties come on top. The new
            calibration adds no larger ones than the one in force: its own scatter may be what is wrong.
        against: names the calibration in force, for the sentence.
    """
    scale = 0.0 if before.scale is None or now.scale is None else now.scale - before.scale
    apart_deg = [now.bias_deg - before.bias_deg + scale * end for end in range_deg]
    most_deg = max(apart_deg, key=abs)
    reach_deg = max(abs(end) for end in range_deg)
    bias_std_deg = math.hypot(before.bias_std_deg, min(before.bias_std_deg, now.bias_std_deg))
    scale_std = math.hypot(before.scale_std, min(before.scale_std, now.scale_std))
    std_deg = math.hypot(bias_std_deg, reach_deg * scale_std)
    if abs(most_deg) <= remount_limit_deg + COVERS * std_deg:
        return []
    return [
        Doubt(
            "changed",
            f"The readings differ by {most_deg:+.2f}° from those of {against}; noise and remounting explain "
            f"{remount_limit_deg + COVERS * std_deg:.2f}° at most (remount_limit_deg).".replace("-", "−"),
        )
    ]


def residual_doubts(before: Result, now: Result, against: str) -> list[Doubt]:
    """Return whether a run's residual is far larger than that of the run in force.

    Compare the standard deviations about each run's own line, with the reading noise and `COUNT_DEG` as the
    smallest one expected. Their ratio must exceed `RESIDUAL_FACTOR` and, squared, the quantile of F at
    `RESIDUAL_P` (Draper & Smith, Applied Regression Analysis, 1998, section 2.1).

    `against` names the calibration in force, for the sentence.
    """
    then, new = _residual(before), _residual(now)
    if then is None or new is None:
        return []
    expected_deg = max(then.std_deg, before.noise_deg or 0.0, now.noise_deg or 0.0, COUNT_DEG)
    if new.std_deg <= RESIDUAL_FACTOR * expected_deg:
        return []
    from scipy.special import fdtrc

    if fdtrc(new.freedom, then.freedom, (new.std_deg / expected_deg) ** 2) > RESIDUAL_P:
        return []
    return [
        Doubt(
            "residual",
            f"The residual RMS is {deg(new.rms_deg)}; that of {against} is "
            f"{deg(then.rms_deg)}. Neither chance nor reading noise explains the difference: "
            "the unit may have slipped in its clamp, or the stage may have lost steps.",
        )
    ]


class _Residual(NamedTuple):
    """RMS and standard deviation of the poses about a run's line, and its degrees of freedom."""

    rms_deg: float
    std_deg: float
    freedom: int


def _residual(result: Result) -> _Residual | None:
    """Of a run's bias and scale without effects; None where no pose is left over to tell."""
    rms_deg, fitted = result.rms_calibrated_deg, 1 if result.scale is None else 2
    freedom = result.n_poses - fitted
    if rms_deg is None or freedom < 1:
        return None
    return _Residual(rms_deg, rms_deg * math.sqrt(result.n_poses / freedom), freedom)


def repeat_doubts(difference: str, against: str) -> list[Doubt]:
    """Return the doubt about a difference that the repeats of all units do not explain, in its words."""
    return [
        Doubt(
            "changed",
            f"{difference} That is against {against}, and more than repeatability and remounting explain.",
        )
    ]


def position_doubts(changed: Collection[Doubt], *, homes: bool) -> list[Doubt]:
    """Return that a stage without homing may stand elsewhere, where bias or scale have changed."""
    if homes or not changed:
        return []
    return [
        Doubt(
            "unmeasured_position",
            "The stage has no homing: its position is stored or was entered by a person. If the table was "
            "rotated since, the bias is wrong by that angle.",
        )
    ]


def displacement_doubts(
    before: Document, now: Document, still_accepted: Collection[str], against: str
) -> list[Doubt]:
    """Return what would be lost if a calibration replaced the one in force.

    Args:
        before: the document in force, CONTRACT section 6.
        now: the content of the new one.
        still_accepted: names of the unit's effects whose acceptance was not revoked.
        against: names the revision in force, for the sentence.
    """
    then_deg, now_deg = before["expanded_uncertainty_deg"], now["expanded_uncertainty_deg"]
    if then_deg is None or (now_deg is not None and now_deg <= then_deg):
        return []
    larger = f"U was {deg(then_deg)} and would be {'not known' if now_deg is None else deg(now_deg)}"
    found = []
    if _is_solved(before) and not _is_solved(now):
        found.append(
            Doubt(
                "solution_in_force", f"A plain run would replace the joint solution of {against}: {larger}."
            )
        )
    corrected = {one["name"] for one in now["effects"]}
    lost = [
        e["name"] for e in before["effects"] if e["name"] in still_accepted and e["name"] not in corrected
    ]
    if lost:
        from calrig.calibration.effects import title_inside  # not loaded before it is needed

        # a unit's document has errors of the angle only where the reference is good
        names = ", ".join(title_inside(name, reference_is_good=True) for name in sorted(lost))
        found.append(Doubt("effects_lost", f"It does not correct {names}, as {against} does: {larger}."))
    return found


def _is_solved(document: Document) -> bool:
    return (document.get("provenance") or {}).get("solution") is not None
