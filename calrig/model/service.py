"""What a service reports of itself: its rigs, jobs, users and benches."""

from datetime import datetime
from typing import Literal

from pydantic import Field

from calrig.model.base import Model

RigWork = Literal["idle", "busy", "unreachable", "offline"]


class RigState(Model):
    """A rig and what it is doing; `stage`, `imu` and `clamp` are its drivers, null where hands turn the unit.

    At a centre with the bench that has it; `offline`, with the last known state, once the bench is silent.
    `stop_asked_at` is since when a stop waits that the bench has not answered.
    """

    name: str
    stage: str
    imu: str
    simulated: bool
    state: RigWork
    run_id: str | None
    bench: str | None = None
    hall: str | None = None
    last_seen_at: datetime | None = None
    clamp: str | None = None
    stop_asked_at: datetime | None = None


class JobState(Model):
    """A job, running or ended."""

    id: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    fraction: float | None = Field(description="Share that is done; null where the work does not report it.")
    result: str | None = Field(description="Path of the result, once it is done.")
    error: str | None
    error_status: int | None = Field(
        default=None, description="Status with which its call would have answered the error."
    )


Role = Literal["viewer", "operator", "releaser", "admin"]
"""Each may do what those before it may."""


class KnownUser(Model):
    """A user, enabled or disabled."""

    name: str
    role: Role
    has_token: bool
    created_at: datetime
    disabled_at: datetime | None


class Membership(Model):
    """A bench that may join, has joined or was revoked; times are null until then.

    `refused` says why it takes no orders: its version, another bench's rig of the same name, a full disk.
    `clock` says what is wrong with its clock, null within 2 s of the centre's.
    """

    name: str
    hall: str | None
    code_until: datetime | None = Field(
        description="Until when a code waits to be used; null where none does."
    )
    enrolled_at: datetime | None
    revoked_at: datetime | None
    last_seen_at: datetime | None
    refused: str | None = None
    clock_skew_s: float | None = Field(
        default=None, description="Its time less the centre's, as it measured last; null if not known."
    )
    clock: str | None = None
    version: str | None = Field(default=None, description="Of its calrig, as it reported last.")
    schema_revision: str | None = Field(
        default=None, description="Of the tables that its calrig delivers for, as it reported last."
    )
