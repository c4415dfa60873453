"""A run that somebody wants, before it is stored: from a person, a diagnosis, or a centre's order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from calrig.analysis.active_calibration import ActiveCalibration
from calrig.analysis.origin import provenance
from calrig.plan import Plan
from calrig.runs.follow_up import FollowUpRun
from calrig.store import Run, Store


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

    def keep(self, store: Store, rig: str, n_poses: int) -> Run:
        """Stores it as `queued`; n_poses are those that it has to measure."""
        return store.create_run(
            unit=self.unit,
            rig=rig,
            plan=self.plan.model_dump(mode="json"),
            status="queued",
            operator=self.operator,
            who=self.who,
            note=self.note,
            follows=self.follows,
            provenance={
                **self.origin,
                **provenance(self.operator),
                "seed": self.plan.seed,
                **({} if self.verifies is None else self.verifies.provenance()),
                **({} if self.follow_up is None else {"follow_up": self.follow_up.provenance()}),
            },
            poses_total=0 if self.plan.kind == "static" else n_poses,
            run_id=self.run_id,
        )
