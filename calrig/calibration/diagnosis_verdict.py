"""Whether a diagnosis is good news: names count only where the error on held-out poses falls with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from calrig.calibration.effects import EFFECTS, UNNAMED
from calrig.calibration.verdict import between_runs

Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class DiagnosisVerdict:
    """What a person should make of a diagnosis.

    Attributes:
        grade: `good`, the effects are named and the error on poses that decided nothing has fallen;
            `unknown`, no effect was found; else `fair`.
        says: the same in sentences, the answer first.
    """

    grade: Literal["good", "fair", "unknown"]
    says: tuple[str, ...]


def diagnosis_verdict(diagnosis: Document, decided: int | None = None) -> DiagnosisVerdict:
    """Judges a diagnosis by its errors before and after on held-out and on confirming poses.

    Args:
        diagnosis: CONTRACT section 5.
        decided: how many poses of the confirming run served to decide; None without one.
    """
    fresh = diagnosis["confirmed_by"]
    confirmed = fresh is None or fresh["after_rms_deg"] < fresh["before_rms_deg"]
    before_deg, after_deg = (diagnosis[model]["held_out_rms_deg"] for model in ("base", "final"))
    fell = after_deg is None or after_deg < before_deg
    says = [_answer(diagnosis)]
    if after_deg is None:
        says.append("Without cross-validation: the error on held-out poses is not known.")
    elif diagnosis["effects"] and not fell:
        says.append(
            "The error on held-out poses has not decreased: with so few poses the search does not find the "
            "same effects in every fold."
        )
    if fresh is not None:
        says.append(_confirmation(fresh, decided, confirmed=confirmed))
    if diagnosis["verdict"] == "nothing":
        return DiagnosisVerdict("unknown", tuple(says))
    good = diagnosis["verdict"] == "named" and fell and confirmed
    return DiagnosisVerdict("good" if good else "fair", tuple(says))


def _answer(diagnosis: Document) -> str:
    effects = diagnosis["effects"]
    if not effects:
        return "No effect found: the residual is consistent with noise"
    parts = [
        ("Indistinguishable by these poses", "; ".join(map(_suspects, _of(effects, "ambiguous")))),
        ("Not in the catalogue", ", ".join(map(_title, _of(effects, "unnamed")))),
        ("Identified", ", ".join(map(_title, _of(effects, "named")))),
    ]
    return ". ".join(f"{what}: {which}" for what, which in parts if which)


def _of(effects: Sequence[Document], verdict: str) -> list[Document]:
    return [effect for effect in effects if effect["verdict"] == verdict]


def _title(effect: Document) -> str:
    """Of the catalogue, as it stands inside a sentence."""
    if effect["name"] == UNNAMED:
        followed = (e.covariate for e in EFFECTS.values() if e.covariate.name == effect["covariate"])
        covariate = next(followed, None)
        column = covariate.title if covariate else effect["covariate"]
        return f"something that follows {column}{between_runs(effect)}"
    title = EFFECTS[effect["name"]].title
    return title[0].lower() + title[1:] + between_runs(effect)


def _suspects(effect: Document) -> str:
    names = " or ".join(name.replace("_", " ") for name in (effect["name"], *effect["confusable_with"]))
    return names + between_runs(effect)


def _confirmation(fresh: Document, decided: int | None, *, confirmed: bool) -> str:
    poses = f" ({decided} {'pose' if decided == 1 else 'poses'} decided)" if decided else ""
    return (
        f"{'Confirmed' if confirmed else 'Not confirmed'} on poses of run {fresh['run_id']} that were not "
        f"used for the decision{poses}: RMS {_deg(fresh['before_rms_deg'])} before and "
        f"{_deg(fresh['after_rms_deg'])} after."
    )


def _deg(value: float) -> str:
    return f"{value:#.3g}°"
