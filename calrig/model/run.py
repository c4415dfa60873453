"""A run: its status, how far it is, and everything known of it but its plan and its verdict."""

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, Field, computed_field

from calrig.model.base import Model
from calrig.model.result import Result

Status = Literal["queued", "running", "paused", "completed", "failed", "aborted", "interrupted"]

UNFINISHED: tuple[Status, ...] = ("queued", "running", "paused")
"""A thread of a running program executes the run."""

TERMINAL: tuple[Status, ...] = ("completed", "failed", "aborted")
"""Nothing more happens to the run; its finished_at is set."""

AT_REST: tuple[Status, ...] = (*TERMINAL, "interrupted")
"""No process executes the run: it has ended, or was interrupted and can be resumed."""

UNTIL_GO = "it begins once somebody says Go (resume)"
"""How the reason of a queued run ends that waits for a person, where nothing starts by itself."""


class Mount(Model):
    """How the unit is to be clamped before a paused run is resumed."""

    mount_deg: float
    mount_axis: str = Field(description="Which of the unit's axes lies along the stage's.")


class Progress(Model):
    """How far a run is, and what a paused one waits for."""

    poses_done: int
    poses_total: int
    fraction: float
    remaining_s: float | None
    waiting_for: Mount | None = None  # of runs stored before there was any: null


class Voided(Model):
    """Why and when a run was voided."""

    reason: str
    at: datetime


class Suspect(Model):
    """The rig was in doubt when the run was made: its check standard failed since it had last passed."""

    reason: str
    check_run_id: str


class Run(Model):
    """A run (CONTRACT section 2). The store, the API and the client each add its plan and its verdict."""

    id: str
    unit: str
    rig: str | None
    status: Status
    progress: Progress
    result: Result | None
    diagnosis: dict[str, Any] | None
    faults: dict[str, int]
    follows: str | None
    provenance: dict[str, Any]
    operator: str | None
    note: str | None
    voided: Voided | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    error: str | None
    suspect: Suspect | None = None

    @computed_field  # type: ignore[prop-decorator]
    @property
    def held(self) -> bool:
        """Whether the queued run begins only once a person resumes it."""
        return self.status == "queued" and (self.error or "").endswith(UNTIL_GO)


def mount_axis(plan: dict[str, Any] | None, provenance: dict[str, Any]) -> str:
    """Which of the unit's axes lay along the stage's in a run: as planned, or as an imported file says."""
    return str((plan or provenance).get("mount_axis", "x"))


class PoseColumns(BaseModel):
    """Columns of a pose as stored and as answered (CONTRACT section 4), but for its sweep and approach."""

    target_deg: float
    reading_deg: float
    time_s: float | None
    temperature_c: float | None
    stage_deg: float | None
    reading_std_deg: float | None
    reading_stderr_deg: float | None
    n_samples: int | None
    accel_x_g: float | None
    accel_y_g: float | None
    accel_z_g: float | None
    gyro_move_deg: float | None
    settle_s: float | None
