"""State what a diagnosis concludes, and whether it is good news.

A name is good news only if the error on held-out poses falls with it. Held-out poses lie between the
others, and in contiguous blocks: the claim rests on the folds that the effects help less. A residual is
called noise only if the pure error allows it. The verdict on a run's result is made elsewhere:
`calrig.calibration.uncertainty.verdict`.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from calrig.calibration.diagnosis.lack_of_fit import LEVEL, SEVERAL
from calrig.calibration.effects import EFFECTS, UNNAMED, covariate_of, title_inside
from calrig.calibration.regression.effect import ELEVATION
from calrig.calibration.uncertainty.verdict import (
    between_runs,
    candidate_titles,
    not_repeated_better,
)
from calrig.estimation.angle_text import angle_text

Document = Mapping[str, Any]
FAR_LARGER = 5.0
"""The residual, times the standard uncertainty of the reference: more than a stage as stated can do."""
BY_REFERENCE = "The reference is taken as good: periodic and smooth errors of the angle are the sensor's."


@dataclass(frozen=True, slots=True)
class Conclusion:
    """What a diagnosis says of itself.

    Attributes:
        grade: `good`: the effects are named, the error on poses not used for the decision has fallen, and the
            residual is not several times the pure error; `unknown`: no effect was found; else `fair`.
        says: the conclusion in sentences, the answer first.
    """

    grade: Literal["good", "fair", "unknown"]
    says: tuple[str, ...]


def conclude(
    diagnosis: Document, decided: int | None = None, reference_std_deg: float | None = None
) -> Conclusion:
    """Grade a diagnosis by its errors before and after, on held-out and on confirming poses.

    Args:
        diagnosis: CONTRACT section 5.
        decided: number of poses of the confirming run that served to decide; None without such a run.
        reference_std_deg: stated standard uncertainty of the reference; None where nothing is stated.
    """
    fresh = diagnosis["confirmed_by"]
    confirmed = fresh is None or fresh["after_rms_deg"] < fresh["before_rms_deg"]
    between, apart = (_errors(diagnosis, key) for key in ("held_out_rms_deg", "blocked_rms_deg"))
    says = [_answer(diagnosis)]
    if diagnosis["effects"]:
        says += _rest(diagnosis)
    if diagnosis["final"]["held_out_rms_deg"] is None:
        says.append("Without cross-validation: the error on held-out poses is not known.")
    elif between is None:
        says.append(
            "With bias and scale alone the readings do not follow the stage: no error before is stated."
        )
    elif diagnosis["effects"]:
        says.append(_held_out(between, apart))
    if diagnosis.get("reference") == "good" and any(map(_is_by_reference, diagnosis["effects"])):
        says.append(BY_REFERENCE)
    says += _reference_may_be_good(diagnosis, reference_std_deg)
    fell = all(after < before for before, after in filter(None, (between, apart)))
    if fresh is not None:
        says.append(_confirmation(fresh, decided, confirmed=confirmed))
    if diagnosis["verdict"] == "nothing":
        return Conclusion("unknown", tuple(says))
    explained = (_times_pure_error(diagnosis) or 0.0) < SEVERAL
    good = diagnosis["verdict"] == "named" and fell and confirmed and explained
    return Conclusion("good" if good else "fair", tuple(says))


def _reference_may_be_good(diagnosis: Document, std_deg: float | None) -> list[str]:
    """Say that the sensor may err, if the residual is far larger than the reference's uncertainty."""
    of_stage = (e for e in diagnosis["effects"] if _is_term_of_angle(e) and e["origin"] != "sensor")
    if not std_deg or next(of_stage, None) is None:
        return []
    before_deg = diagnosis["base"]["fit_rms_deg"]
    if before_deg is None or before_deg < FAR_LARGER * std_deg:
        return []
    return [
        f"The residual of bias and scale, {angle_text(before_deg)}, is {before_deg / std_deg:.0f} times the "
        f"stated uncertainty of the reference, {angle_text(std_deg)}: if that holds, the sensor errs, not "
        "the stage. Then diagnose with reference `good`."
    ]


def _is_term_of_angle(effect: Document) -> bool:
    known = EFFECTS.get(effect["name"])
    return known is not None and known.as_sensor is not None and effect["covariate"] == ELEVATION.name


def _is_by_reference(effect: Document) -> bool:
    return effect.get("origin", "") == "sensor" and EFFECTS[effect["name"]].origin != "sensor"


def _answer(diagnosis: Document) -> str:
    effects = diagnosis["effects"]
    if not effects:
        return _nothing(diagnosis)
    is_good = diagnosis.get("reference") == "good"
    suspects, title = (partial(words, reference_is_good=is_good) for words in (_suspects, _title))
    parts = [
        ("Indistinguishable by these poses", "; ".join(_each_once(suspects, _of(effects, "ambiguous")))),
        ("Not in the catalogue", ", ".join(_each_once(title, _of(effects, "unnamed")))),
        ("Identified", ", ".join(_each_once(title, _of(effects, "named")))),
    ]
    return ". ".join(f"{what}: {which}" for what, which in parts if which)


def _each_once(words: Callable[[Document], str], effects: Sequence[Document]) -> list[str]:
    """Return the words for each of the effects; of several with the same words, how many there are."""
    return [f"{one} ({n} of them)" if n > 1 else one for one, n in Counter(map(words, effects)).items()]


def _nothing(diagnosis: Document) -> str:
    from scipy.special import fdtri

    noise = diagnosis["noise"]
    if noise.get("pure_error_deg") is None:
        return "No effect found. How large the noise is, neither dwells nor revisited poses tell"
    if noise["lack_of_fit"]["rejected"]:
        return f"No effect found, and yet {_more_than_noise(diagnosis)}"
    if not_repeated_better(diagnosis):
        times = f"{noise['std_deg'] / noise['floor_deg']:.1f} times the noise within a dwell"
        return (
            f"No effect found: the residual is what poses repeat to, {angle_text(noise['std_deg'])}, {times}"
        )
    # The test of lack of fit gives tails less weight: a few poses that are far off are not noise either.
    pure_deg, left_deg = noise["pure_error_deg"], diagnosis["final"]["fit_rms_deg"]
    freedom = max(diagnosis["n_poses"] - 2, 1), noise["lack_of_fit"]["freedom"][1]
    if left_deg > pure_deg * math.sqrt(fdtri(*freedom, 1.0 - LEVEL)):
        return (
            f"No effect found, and yet the residual of all poses, {angle_text(left_deg)}, is "
            f"{left_deg / pure_deg:.1f} times the pure error: a few poses are far off"
        )
    return "No effect found: the residual is consistent with noise"


def _rest(diagnosis: Document) -> list[str]:
    """Say what the effects do not explain, if it exceeds noise."""
    tested = diagnosis["noise"].get("lack_of_fit")
    if not tested or not tested["rejected"]:
        return []
    said = _more_than_noise(diagnosis)
    return [f"{said[0].upper()}{said[1:]}."]


def _more_than_noise(diagnosis: Document) -> str:
    noise = diagnosis["noise"]
    times = f"{_times_pure_error(diagnosis):.1f} times the pure error"
    return (
        f"more is left than the noise of a pose: {angle_text(noise['std_deg'])}, {times}, "
        f"with a lag-1 correlation of {noise['lag1_correlation']:.2f}"
    )


def _times_pure_error(diagnosis: Document) -> float | None:
    """Return the residual over the pure error; None if that is unknown."""
    noise = diagnosis["noise"]
    pure_deg = noise.get("pure_error_deg")
    return noise["std_deg"] / pure_deg if pure_deg else None


def _errors(diagnosis: Document, key: str) -> tuple[float, float] | None:
    """Return the RMS before and after, degrees; None if they were not measured."""
    before, after = (diagnosis[model].get(key) for model in ("base", "final"))
    return None if before is None or after is None else (before, after)


def _held_out(between: tuple[float, float], apart: tuple[float, float] | None) -> str:
    """Say the error on held-out poses, by the folds that the effects help less."""
    if between[1] >= between[0]:
        return (
            "The error on held-out poses has not decreased: with so few poses the search does not find the "
            "same effects in every fold."
        )
    if apart is not None and apart[1] >= apart[0]:
        return (
            f"What was found interpolates: RMS {_fall(between)} on held-out poses between the others, but "
            f"{_fall(apart)} on contiguous blocks of them."
        )
    if apart is not None and apart[1] / apart[0] > between[1] / between[0]:
        return f"RMS on held-out poses: {_fall(apart)} on contiguous blocks, the harder test."
    return f"RMS on held-out poses: {_fall(between)}."


def _fall(errors: tuple[float, float]) -> str:
    return f"{angle_text(errors[0])} before and {angle_text(errors[1])} after"


def _of(effects: Sequence[Document], verdict: str) -> list[Document]:
    return [effect for effect in effects if effect["verdict"] == verdict]


def _title(effect: Document, *, reference_is_good: bool) -> str:
    """Return the title of an effect for the middle of a sentence."""
    if effect["name"] == UNNAMED:
        return f"something that follows {covariate_of(effect['covariate']).title}{between_runs(effect)}"
    return title_inside(effect["name"], reference_is_good=reference_is_good) + between_runs(effect)


def _suspects(effect: Document, *, reference_is_good: bool) -> str:
    return " or ".join(candidate_titles(effect, reference_is_good=reference_is_good)) + between_runs(effect)


def _confirmation(fresh: Document, decided: int | None, *, confirmed: bool) -> str:
    poses = f" ({decided} {'pose' if decided == 1 else 'poses'} decided)" if decided else ""
    return (
        f"{'Confirmed' if confirmed else 'Not confirmed'} on poses of run {fresh['run_id']} that were not "
        f"used for the decision{poses}: RMS {angle_text(fresh['before_rms_deg'])} before and "
        f"{angle_text(fresh['after_rms_deg'])} after."
    )
