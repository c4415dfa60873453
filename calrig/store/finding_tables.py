"""Tables of what is found of many runs: fleet findings, joint solutions, stage maps, studies of logs."""

# No `from __future__ import annotations`: SQLModel reads the annotations of the classes.

from datetime import datetime
from typing import Any

from sqlalchemy import text
from sqlmodel import Field, Index, SQLModel

from calrig.store.checksums import CheckedJson
from calrig.store.column_types import Sha256, UtcText


class FleetFindingTable(SQLModel, table=True):
    """What a fleet's re-analysis found in a run last, by which poses and which catalogue.

    No key of the store's own: the runs may be of another store.
    """

    __tablename__ = "fleet_finding"

    run_uid: str = Field(primary_key=True)
    poses_sha256: str = Field(sa_type=Sha256)
    catalogue: str = Field(sa_type=Sha256)
    diagnosis: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)
    error: str | None = None
    at: datetime = Field(sa_type=UtcText)


class SolutionTable(SQLModel, table=True):
    """Stage, mounts and units solved together: rows are added and never changed."""

    __tablename__ = "solution"
    __table_args__ = (Index("ix_solution_rig_created_at", "rig", "created_at"),)

    id: str = Field(primary_key=True)
    created_at: datetime = Field(sa_type=UtcText)
    solved_by: str | None = None
    rig: str | None = None
    basis: dict[str, Any] = Field(sa_type=CheckedJson)
    document: dict[str, Any] = Field(sa_type=CheckedJson)
    calibrations: dict[str, Any] = Field(sa_type=CheckedJson)
    stage_map: dict[str, Any] = Field(sa_type=CheckedJson)
    poses: dict[str, Any] = Field(sa_type=CheckedJson)


class StageMapTable(SQLModel, table=True):
    """A stage's map that was put in force as the reference of a rig, and until when; at most one is.

    Runs keep what they need of it themselves.
    """

    __tablename__ = "stage_map"
    __table_args__ = (
        Index(
            "ix_stage_map_in_force",
            "rig",
            unique=True,
            sqlite_where=text("withdrawn_at IS NULL"),
            postgresql_where=text("withdrawn_at IS NULL"),
        ),
    )

    id: int = Field(default=None, primary_key=True)
    rig: str
    solution_id: str = Field(foreign_key="solution.id")
    document: dict[str, Any] = Field(sa_type=CheckedJson)
    sha256: str = Field(sa_type=Sha256)
    put_at: datetime = Field(sa_type=UtcText)
    put_by: str | None = None
    withdrawn_at: datetime | None = Field(default=None, sa_type=UtcText)


class LogStudyTable(SQLModel, table=True):
    """What was found in a log that somebody brought: the report and its pictures, not the log."""

    __tablename__ = "log_study"
    __table_args__ = (Index("ix_log_study_created_at_id", "created_at", "id"),)

    id: str = Field(primary_key=True)
    created_at: datetime = Field(sa_type=UtcText)
    studied_by: str | None = None
    kind: str
    file_name: str
    document: dict[str, Any] = Field(sa_type=CheckedJson)
