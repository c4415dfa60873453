"""Describe a run before it is carried out: requested, assigned to a worker, or ordered by a centre."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Self

from pydantic import TypeAdapter

from calrig.analysis.calibration_in_force import ActiveCalibration, active_calibration, require_not_withdrawn
from calrig.analysis.errors import Conflict
from calrig.analysis.imports import provenance
from calrig.analysis.stage_maps import provenance_part
from calrig.analysis.stored_runs import AmbiguousRuns
from calrig.calibration.poses import Pose
from calrig.calibration.regression import DiagnosisRequest
from calrig.estimation.gyro import GyroBias
from calrig.instruments.transcript import Tape, Tapes
from calrig.instruments.types import Board
from calrig.model.plan import Plan, PlannedPose
from calrig.runs.follow_up import Designed, FollowUpQuestion, FollowUpRun
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document


@dataclass(frozen=True, slots=True)
class Earlier:
    """What a run measured before it was interrupted; empty of one that begins.

    Attributes:
        poses: all, in order.
        biases: of the gyro, from each pose's dwell whose samples are still there.
        logged_s: of a static log, how much of it there is.
        clock_s: where the run's time goes on, s since it began.
    """

    poses: list[Pose] = field(default_factory=list)
    biases: list[GyroBias] = field(default_factory=list)
    logged_s: float = 0.0
    clock_s: float = 0.0
    faults: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RunAssignment:
    """A run with its rig, its plan, and what it needs to know of other runs.

    Attributes:
        run: as it was stored last.
        planned: every pose of the plan.
        follow_up: of a run that follows others.
        verifies: of a verification.
        earlier: what was measured before an interruption.
        interruption: what the run's provenance is to say of it; None where there was none.
        stage_at_deg: a person's word for the elevation at which a stage without homing stands.
    """

    run: Run
    rig: RigSettings
    plan: Plan
    planned: list[PlannedPose]
    follow_up: FollowUpRun | None = None
    verifies: ActiveCalibration | None = None
    earlier: Earlier = field(default_factory=Earlier)
    interruption: dict[str, Any] | None = None
    stage_at_deg: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NewRun:
    """What is wanted, and what it needs to know of other runs.

    Attributes:
        who: asked for it, as the trail keeps it.
        stage_at_deg: a person's word for the elevation at which a stage without homing stands.
        follow_up: of a run that follows others.
        verifies: of a verification.
        origin: what its provenance says beside this machine's own.
        run_id: of a run that has its id already.
    """

    unit: str
    plan: Plan
    operator: str | None = None
    who: str | None = None
    note: str | None = None
    stage_at_deg: float | None = None
    follows: str | None = None
    follow_up: FollowUpRun | None = None
    verifies: ActiveCalibration | None = None
    origin: Mapping[str, Any] = field(default_factory=dict)
    run_id: str | None = None

    @classmethod
    def following(cls, asked: FollowUpQuestion, found: Designed, who: str | None) -> Self:
        """The run that best separates what the diagnosis of a run (and those before it) could not.

        Raises:
            Conflict: nothing can be separated on this rig, and why.
        """
        follow_up, run = asked.follow_up(found), asked.last
        return cls(
            unit=run.unit,
            plan=follow_up.plan,
            operator=who or run.operator,
            who=who,
            follows=run.id,
            follow_up=follow_up,
        )

    def as_of_now(self, store: Store, rig: str, maps: Mapping[str, Document]) -> Self:
        """The same with the calibration that it verifies, and the stage's map in force, where nobody said.

        `maps` are those of stages that files give, by rig.
        """
        wanted = self
        if self.plan.kind == "verification" and self.verifies is None:
            require_not_withdrawn(store, self.unit, self.plan.revision)
            verifies = active_calibration(store, self.unit, rig, self.plan.revision)
            wanted = replace(wanted, verifies=verifies)
        if "stage_map" not in self.origin:  # a centre's order has brought the one in force there
            wanted = replace(wanted, origin={**self.origin, **provenance_part(store, rig, maps)})
        return wanted

    def columns(self, n_poses: int) -> dict[str, Any]:
        """Arguments of `Runs.create` and `Orders.create`; n_poses: number of poses to measure."""
        return {
            "unit": self.unit,
            "plan": self.plan.model_dump(mode="json"),
            "operator": self.operator,
            "who": self.who,
            "note": self.note,
            "follows": self.follows,
            "provenance": {
                **self.origin,
                **provenance(self.operator),
                "seed": self.plan.seed,
                **({} if self.verifies is None else self.verifies.provenance()),
                **({} if self.follow_up is None else {"follow_up": self.follow_up.provenance()}),
            },
            "poses_total": 0 if self.plan.kind == "static" else n_poses,
        }

    def keep(self, store: Store, rig: str, n_poses: int) -> Run:
        """Stores it as `queued`."""
        return store.runs.create(rig=rig, status="queued", run_id=self.run_id, **self.columns(n_poses))


def rig_followed_up_on(run: Run) -> str:
    """The rig of a run, by name; Conflict where none is known."""
    if run.rig is None:
        raise Conflict(f"run {run.id} was imported: no rig is known to follow it up on")
    return run.rig


def order_part(wanted: NewRun) -> Document:
    """What an order says of a run beside what is stored of it: `more` of `Store.orders.create`."""
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
    earlier = AmbiguousRuns.of(
        known["run_ids"],
        _poses().validate_python(known["poses"]),
        DiagnosisRequest.of_document(known),
    )
    return FollowUpRun(earlier, known["separates"], known["deciding"], plan, settings.limits_deg)


def _follow_up_document(follow_up: FollowUpRun) -> Document:
    request = follow_up.earlier.findings.responses.request
    return {
        "separates": list(follow_up.separates),
        "deciding": follow_up.deciding,
        "run_ids": follow_up.earlier.run_ids,
        "reference": request.reference,
        "known_periods_deg": list(request.periods_deg),
        "poses": _poses().dump_python(follow_up.earlier.poses, mode="json"),
    }


@cache
def _calibrations() -> TypeAdapter[ActiveCalibration]:
    return TypeAdapter(ActiveCalibration)


@cache
def _poses() -> TypeAdapter[Any]:
    return TypeAdapter(list[list[Pose]])


@dataclass(frozen=True, slots=True)
class OpenBoardHandover:
    """What a look leaves to the run after it, which closes it: the board, and the tapes of its port."""

    board: Board
    tapes: Sequence[Tape]

    def taken_over(self, tapes: Tapes) -> Board:
        """The board, for a run: what came over its wire before, and what was wrong then, is not the run's."""
        for tape in self.tapes:
            tapes.take_over(tape)
        self.board.faults.clear()
        return self.board
