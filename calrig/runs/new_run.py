"""A run that somebody wants, before it is stored: from a person, a diagnosis, or a centre's order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from calrig.analysis.active_calibration import ActiveCalibration, active_calibration
from calrig.analysis.errors import Conflict
from calrig.analysis.origin import provenance
from calrig.analysis.stage_maps import provenance_part
from calrig.plan import Plan
from calrig.runs.follow_up import Designed, FollowUpQuestion, FollowUpRun
from calrig.store import Run, Store
from calrig.store.records import Document


@dataclass(frozen=True, slots=True, kw_only=True)
class NewRun:
    """What is wanted, and what it needs to know of other runs.

    Attributes:
        who: asked for it, as the trail keeps it.
        stage_at_deg: a person's word for the elevation at which a stage without homing stands.
        follows: the run that it follows up.
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

        Args:
            store: has them.
            rig: that it is to be on.
            maps: of stages, that files give, by rig.
        """
        wanted = self
        if self.plan.kind == "verification" and self.verifies is None:
            verifies = active_calibration(store, self.unit, rig, self.plan.revision)
            wanted = replace(wanted, verifies=verifies)
        if "stage_map" not in self.origin:  # a centre's order has brought the one in force there
            wanted = replace(wanted, origin={**self.origin, **provenance_part(store, rig, maps)})
        return wanted

    def columns(self, n_poses: int) -> dict[str, Any]:
        """As `Store.create_run` and `Store.order_run` take it; n_poses are those that it has to measure."""
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
        return store.create_run(rig=rig, status="queued", run_id=self.run_id, **self.columns(n_poses))


def rig_followed_up_on(run: Run) -> str:
    """The rig of a run, by name; Conflict where none is known."""
    if run.rig is None:
        raise Conflict(f"run {run.id} was imported: no rig is known to follow it up on")
    return run.rig
