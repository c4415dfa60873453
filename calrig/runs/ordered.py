"""Runs that a centre orders of a bench, as documents: with what the bench cannot look up in its own spool."""

from __future__ import annotations

from functools import cache
from typing import Any

from pydantic import TypeAdapter

from calrig.analysis.active_calibration import ActiveCalibration
from calrig.analysis.unresolved import Unresolved
from calrig.calibration.poses import Pose
from calrig.plan import Plan
from calrig.runs.follow_up import FollowUpRun
from calrig.runs.new_run import NewRun
from calrig.settings import RigSettings
from calrig.store.records import Document


def order_part(wanted: NewRun) -> Document:
    """What an order says of a run beside what is stored of it: `more` of `Store.order_run`."""
    verifies, follow_up = wanted.verifies, wanted.follow_up
    return {
        "stage_at_deg": wanted.stage_at_deg,
        "verifies": None if verifies is None else _calibrations().dump_python(verifies, mode="json"),
        "follow_up": None if follow_up is None else _follow_up_document(follow_up),
    }


def ordered_run(run_id: str, document: Document, settings: RigSettings) -> NewRun:
    """The run that an order's document is about, for the rig that is to carry it out.

    Raises:
        ValueError: it is no such document (pydantic's ValidationError, a KeyError among them).
    """
    plan = Plan.model_validate(document["plan"])
    return NewRun(
        run_id=run_id,
        unit=document["unit"],
        plan=plan,
        operator=document["operator"],
        who=document["operator"],
        note=document["note"],
        stage_at_deg=document.get("stage_at_deg"),
        origin=document["provenance"],
        verifies=verified(document),
        follow_up=follow_up_of(document, plan, settings),
    )


def verified(document: Document) -> ActiveCalibration | None:
    """What a verification that was ordered applies; None of another run."""
    known = document.get("verifies")
    return None if known is None else _calibrations().validate_python(known)


def follow_up_of(document: Document, plan: Plan, settings: RigSettings) -> FollowUpRun | None:
    """What a follow-up that was ordered rests on; None of another run.

    What was found in the earlier runs is found again: the same poses tell the same.
    """
    known = document.get("follow_up")
    if known is None:
        return None
    earlier = Unresolved.of(known["run_ids"], _poses().validate_python(known["poses"]))
    return FollowUpRun(earlier, known["separates"], known["deciding"], plan, settings.limits_deg)


def _follow_up_document(follow_up: FollowUpRun) -> Document:
    return {
        "separates": list(follow_up.separates),
        "deciding": follow_up.deciding,
        "run_ids": follow_up.earlier.run_ids,
        "poses": _poses().dump_python(follow_up.earlier.poses, mode="json"),
    }


@cache
def _calibrations() -> TypeAdapter[ActiveCalibration]:
    return TypeAdapter(ActiveCalibration)


@cache
def _poses() -> TypeAdapter[Any]:
    return TypeAdapter(list[list[Pose]])
