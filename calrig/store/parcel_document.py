"""What is in a parcel, one delivery of a bench about one of its runs: checked before any of it is stored."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from calrig.calibration.poses import Pose
from calrig.store.records import Document, Status

Text = Annotated[str, Field(max_length=10_000)]


class _Delivered(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)  # what a newer bench says more is left unread


class DeliveredWait(_Delivered):
    """How the unit is to be clamped before it goes on."""

    mount_deg: float
    mount_axis: Annotated[str, Field(max_length=2)]


class DeliveredProgress(_Delivered):
    """How far it was, as CONTRACT section 2 has it."""

    poses_done: Annotated[int, Field(ge=0)]
    poses_total: Annotated[int, Field(ge=0)]
    fraction: float
    remaining_s: float | None
    waiting_for: DeliveredWait | None = None


class DeliveredRun(_Delivered):
    """The run as its bench knew it when it packed, without its id."""

    unit: Annotated[str, Field(min_length=1, max_length=100)]
    rig: Annotated[str, Field(min_length=1, max_length=64)]
    status: Status
    plan: Document
    progress: DeliveredProgress
    result: Document | None
    diagnosis: Document | None = None
    """Of a follow-up alone, which diagnoses itself."""
    faults: dict[str, int]
    follows: str | None
    provenance: Document
    operator: Text | None
    note: Text | None
    created_at: AwareDatetime
    started_at: AwareDatetime | None
    finished_at: AwareDatetime | None
    error: Text | None


class DeliveredEvent(_Delivered):
    """An event under the number that the bench gave it."""

    seq: Annotated[int, Field(ge=1, le=2**31 - 1)]
    type: Annotated[str, Field(min_length=1, max_length=64)]
    data: Document
    at: AwareDatetime


class DeliveredPose(_Delivered):
    """A pose: beside these, the columns of `Pose.row()`."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    __pydantic_extra__: dict[str, float | int | None]

    index: Annotated[int, Field(ge=0, le=2**31 - 1)]
    excluded: Text | None = None

    def pose(self) -> Pose:
        """The pose itself."""
        return Pose.from_row(self.__pydantic_extra__)


class DeliveredSamples(_Delivered):
    """What the packed block beside the document holds; `number` rises from block to block of a run."""

    number: Annotated[int, Field(ge=1)]
    pose_index: Annotated[int, Field(ge=0, le=2**31 - 1)]
    phase: Literal["move", "dwell"]
    n_samples: Annotated[int, Field(ge=0)]


class ParcelDocument(_Delivered):
    """A parcel's document: the run, and what happened of it that the centre does not know yet."""

    v: Literal[1]
    epoch: Annotated[int, Field(ge=1)]
    run: DeliveredRun
    events: list[DeliveredEvent] = []
    poses: list[DeliveredPose] = []
    transcripts: dict[str, str] | None = None
    samples: DeliveredSamples | None = None


def packed_row(index: int, pose: Pose, excluded: str | None) -> dict[str, Any]:
    """A pose as an entry of a parcel's `poses`."""
    return {"index": index, **pose.row(), "excluded": excluded}
