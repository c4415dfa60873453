"""Tables of the store and the types of their columns.

A change here needs a migration in migrations/versions; a test compares the two.
"""

import re
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import BigInteger, Dialect, ForeignKeyConstraint, Integer, String, TypeDecorator, text
from sqlalchemy.orm import declared_attr
from sqlmodel import Column, Field, ForeignKey, Index, LargeBinary, SQLModel

from calrig.model.run import PoseColumns
from calrig.model.verdict import Figures
from calrig.store.checksums import CheckedJson
from calrig.store.errors import Unreadable


class UtcText(TypeDecorator[datetime]):
    """An aware time as ISO 8601 text in UTC of fixed width, so that text order is the order of time."""

    impl = String(32)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> str | None:  # noqa: ARG002
        """Python to database."""
        return None if value is None else value.astimezone(UTC).isoformat(timespec="microseconds")

    def process_result_value(self, value: Any | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Database to Python."""
        try:
            return None if value is None else datetime.fromisoformat(value)
        except (TypeError, ValueError) as error:
            raise Unreadable(f"a time is no time any more: {value!r}") from error


Sha256 = String(64)
"""A hash in hexadecimal."""
Crc32 = BigInteger().with_variant(Integer(), "sqlite")
"""Unsigned 32 bits, one more than PostgreSQL's integer holds."""


def _where(condition: str) -> dict[str, Any]:
    """Of an index over the rows that a condition holds of, on either engine."""
    return {"sqlite_where": text(condition), "postgresql_where": text(condition)}


class Table(SQLModel):
    """Base of all tables, each named after its class: `RunOrderTable` is `run_order`.

    A class that is renamed needs a migration, or a name of its own, as `LimitTable` has.
    """

    @declared_attr.directive
    def __tablename__(cls) -> str:  # noqa: N805 (of the class)
        return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__.removesuffix("Table")).lower()


class UnitTable(Table, table=True):
    """A sensor by its serial number."""

    serial: str = Field(primary_key=True)
    created_at: datetime = Field(sa_type=UtcText)


class RunTable(Table, table=True):
    """A run. Documents that are only ever shown whole are JSON.

    `id` is the store's own key, which the other tables refer to; everybody else knows the run by `uid`.
    """

    __table_args__ = (
        Index("ix_run_uid", "uid", unique=True),
        # a page of the list, newest first, reads no others: of all runs, of a unit, of a rig, of a status
        Index("ix_run_created_at_id", "created_at", "id"),
        Index("ix_run_unit_created_at_id", "unit", "created_at", "id"),
        Index("ix_run_rig_created_at_id", "rig", "created_at", "id"),
        Index("ix_run_status_created_at_id", "status", "created_at", "id"),
        Index("ix_run_kind_created_at_id", "kind", "created_at", "id"),
        Index("ix_run_follows", "follows", **_where("follows IS NOT NULL")),
        Index("ix_run_imported", "created_at", "id", **_where("plan IS NULL")),
        # all that a text is looked for in; a note may be longer than PostgreSQL has in an index
        Index("ix_run_search", "created_at", "id", "unit", "rig", "status", "kind", "note").ddl_if(
            dialect="sqlite"
        ),
    )

    id: int = Field(default=None, primary_key=True)
    uid: str
    unit: str = Field(foreign_key="unit.serial")
    rig: str | None
    kind: str
    status: str
    plan: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)
    progress: dict[str, Any] = Field(sa_type=CheckedJson)
    result: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)
    diagnosis: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)
    faults: dict[str, int] = Field(sa_type=CheckedJson)
    follows: int | None = Field(default=None, foreign_key="run.id")
    provenance: dict[str, Any] = Field(sa_type=CheckedJson)
    operator: str | None = None
    note: str | None = None
    voided_reason: str | None = None
    voided_at: datetime | None = Field(default=None, sa_type=UtcText)
    created_at: datetime = Field(sa_type=UtcText)
    started_at: datetime | None = Field(default=None, sa_type=UtcText)
    finished_at: datetime | None = Field(default=None, sa_type=UtcText)
    error: str | None = None


class CalibrationTable(Table, table=True):
    """The figures of a run's result once more, narrow, so that a comparison reads no JSON."""

    run_id: int = Field(primary_key=True, foreign_key="run.id")
    bias_deg: float
    bias_std_deg: float | None
    scale: float | None
    scale_std: float | None
    rms_raw_deg: float
    rms_calibrated_deg: float | None
    rms_with_effects_deg: float | None
    temperature_min_c: float | None
    temperature_max_c: float | None
    crc32: int | None = Field(default=None, sa_type=Crc32)


class VerdictFiguresTable(Figures, Table, table=True):
    """A run's `calrig.model.verdict.VerdictFigures`, and the hash of the program text that computed them.

    Written with the run's row by `calrig.store.verdicts`. Rows that are not computed yet have no figures.
    """

    run_id: int = Field(primary_key=True, foreign_key="run.id")
    program: str
    left: str | None = None
    without: str | None = None
    relied_on: bool | None = None


class PoseTable(PoseColumns, Table, table=True):
    """A pose: CONTRACT section 4's columns, `pass` as `sweep`."""

    run_id: int = Field(primary_key=True, foreign_key="run.id")
    pose_index: int = Field(primary_key=True)
    sweep: int | None
    approach: int | None
    covariates: dict[str, Any] = Field(sa_type=CheckedJson)
    excluded_reason: str | None = None
    excluded_at: datetime | None = Field(default=None, sa_type=UtcText)
    crc32: int | None = Field(default=None, sa_type=Crc32)


class EventTable(Table, table=True):
    """What was announced, in order; many small rows, hence clustered by their key."""

    __table_args__ = ({"sqlite_with_rowid": False},)

    run_id: int = Field(primary_key=True, foreign_key="run.id")
    seq: int = Field(primary_key=True)
    type: str
    data: dict[str, Any] = Field(sa_type=CheckedJson)
    at: datetime = Field(sa_type=UtcText)


class SampleBlockTable(Table, table=True):
    """Raw samples of one move or dwell: a compressed npz with the arrays of `records.SampleBlock`."""

    __table_args__ = (Index("ix_sample_block_run_id_pose_index", "run_id", "pose_index"),)

    id: int = Field(default=None, primary_key=True)
    run_id: int = Field(sa_column=Column(ForeignKey("run.id"), nullable=False))
    pose_index: int
    phase: str
    n_samples: int
    data: bytes = Field(sa_column=Column(LargeBinary, nullable=False))


class AcceptedEffectTable(Table, table=True):
    """An effect that a person accepted: of a unit (applied in flight) or of a rig (its error map)."""

    __table_args__ = (Index("ix_accepted_effect_unit", "unit"), Index("ix_accepted_effect_rig", "rig"))

    id: int = Field(default=None, primary_key=True)
    run_id: int = Field(foreign_key="run.id")
    unit: str | None = Field(default=None, foreign_key="unit.serial")
    rig: str | None = None
    name: str
    origin: str
    parameters: dict[str, Any] = Field(sa_type=CheckedJson)
    accepted_at: datetime = Field(sa_type=UtcText)
    withdrawn_at: datetime | None = Field(default=None, sa_type=UtcText)
    fit: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)


class TranscriptTable(Table, table=True):
    """What went over a wire in the last minute before a run failed: compressed text."""

    __table_args__ = (Index("ix_transcript_run_id", "run_id"),)

    id: int = Field(default=None, primary_key=True)
    run_id: int = Field(sa_column=Column(ForeignKey("run.id"), nullable=False))
    port: str
    data: bytes = Field(sa_column=Column(LargeBinary, nullable=False))


class StagePlaceTable(Table, table=True):
    """Where the stage of a rig stands that cannot look for its reference; null while it is not known."""

    rig: str = Field(primary_key=True)
    stage_deg: float | None
    at: datetime = Field(sa_type=UtcText)


class IssuedCalibrationTable(Table, table=True):
    """A revision of a unit's calibration: its bytes never change; its status is beside them."""

    __table_args__ = (
        Index("ix_issued_calibration_in_force", "unit", unique=True, **_where("status = 'in_force'")),
        Index("ix_issued_calibration_run_id", "run_id"),
    )

    unit: str = Field(primary_key=True, foreign_key="unit.serial")
    revision: int = Field(primary_key=True)
    run_id: int = Field(foreign_key="run.id")
    document: str
    sha256: str = Field(sa_type=Sha256)
    status: str
    basis: dict[str, Any] = Field(sa_type=CheckedJson)
    verdict: dict[str, Any] = Field(sa_type=CheckedJson)
    issued_at: datetime = Field(sa_type=UtcText)
    issued_by: str | None = None
    reason: str | None = None


class CertificateTable(Table, table=True):
    """A certificate as it was issued: its bytes never change.

    `trail_seq` and `trail_sha256` are the head of the trail when it was issued, 0 and `FIRST` of none; the
    certificate says them, so that entries up to it cannot be cut off unseen. `replaces` is the number of an
    earlier row, without a foreign key: moved rows come in the order of their numbers.
    """

    __table_args__ = (
        ForeignKeyConstraint(
            ["unit", "revision"], ["issued_calibration.unit", "issued_calibration.revision"]
        ),
        Index("ix_certificate_unit", "unit", "revision"),
    )

    number: str = Field(primary_key=True)
    unit: str
    revision: int
    issued_at: datetime = Field(sa_type=UtcText)
    issued_by: str | None = None
    replaces: str | None = Field(default=None, unique=True)
    reason: str | None = None
    settings: dict[str, Any] = Field(sa_type=CheckedJson)
    sha256: dict[str, Any] = Field(sa_type=CheckedJson)
    trail_seq: int
    trail_sha256: str
    pdf: bytes | None = Field(default=None, sa_column=Column(LargeBinary))
    dcc: bytes = Field(sa_column=Column(LargeBinary, nullable=False))


class TrailTable(Table, table=True):
    """Who did what, when and why: rows are added and never changed, each chained to the one before.

    `run_id` is what everybody knows the run by.
    """

    __table_args__ = (Index("ix_trail_unit", "unit"),)

    seq: int = Field(default=None, primary_key=True)
    at: datetime = Field(sa_type=UtcText)
    who: str | None
    what: str
    unit: str | None = None
    rig: str | None = None
    run_id: str | None = None
    revision: int | None = None
    reason: str | None = None
    detail: dict[str, Any] = Field(sa_type=CheckedJson)
    sha256: str = Field(sa_type=Sha256)


class LimitTable(Table, table=True):
    """A limit in the order that limits are tried in: the first that matches a unit counts."""

    __tablename__ = "limit_rule"

    position: int = Field(primary_key=True)
    name: str = Field(unique=True)
    document: dict[str, Any] = Field(sa_type=CheckedJson)


class UserTable(Table, table=True):
    """A person or program that is known: role, and the hash of its token (null: known by a proxy only)."""

    name: str = Field(primary_key=True)
    role: str
    token_sha256: str | None = Field(default=None, sa_type=Sha256, unique=True)
    created_at: datetime = Field(sa_type=UtcText)
    disabled_at: datetime | None = Field(default=None, sa_type=UtcText)


class CheckUnitTable(Table, table=True):
    """The unit by which a rig is checked, and how often."""

    rig: str = Field(primary_key=True)
    unit: str = Field(foreign_key="unit.serial")
    interval_days: float
    named_at: datetime = Field(sa_type=UtcText)


class ItemTable(Table, table=True):
    """What was said of a unit as it came: the last row counts."""

    __table_args__ = (Index("ix_item_unit", "unit"),)

    id: int = Field(default=None, primary_key=True)
    unit: str = Field(foreign_key="unit.serial")
    document: dict[str, Any] = Field(sa_type=CheckedJson)
    at: datetime = Field(sa_type=UtcText)


class BatchTable(Table, table=True):
    """A list of units that are calibrated one after the other; `document` is what holds of all of them."""

    __table_args__ = (Index("ix_batch_created_at", "created_at"),)

    id: str = Field(primary_key=True)
    created_at: datetime = Field(sa_type=UtcText)
    closed_at: datetime | None = Field(default=None, sa_type=UtcText)
    document: dict[str, Any] = Field(sa_type=CheckedJson)


class BatchUnitTable(Table, table=True):
    """A unit's turn in a list: the rig that it is kept for, and the run that it has got."""

    batch: str = Field(primary_key=True, foreign_key="batch.id")
    position: int = Field(primary_key=True)
    unit: str
    rig: str | None = None
    run_uid: str | None = None
    state: str
    why: str | None = None


class WebhookDeliveryTable(Table, table=True):
    """The end of a run that another program is to be told of; `due_at` is null once that is over."""

    __table_args__ = (Index("ix_webhook_delivery_due_at", "due_at"),)

    run_uid: str = Field(primary_key=True)
    ended_at: datetime = Field(sa_type=UtcText)
    due_at: datetime | None = Field(default=None, sa_type=UtcText)
    tries: int
    delivered_at: datetime | None = Field(default=None, sa_type=UtcText)
    error: str | None = None


class FleetFindingTable(Table, table=True):
    """What a fleet's re-analysis found in a run last, by which poses and which catalogue.

    No key of the store's own: the runs may be of another store.
    """

    run_uid: str = Field(primary_key=True)
    poses_sha256: str = Field(sa_type=Sha256)
    catalogue: str = Field(sa_type=Sha256)
    diagnosis: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)
    error: str | None = None
    at: datetime = Field(sa_type=UtcText)


class SolutionTable(Table, table=True):
    """Stage, mounts and units solved together: rows are added and never changed."""

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


class StageMapTable(Table, table=True):
    """A stage's map that was put in force as the reference of a rig, and until when; at most one is.

    Runs keep what they need of it themselves.
    """

    __table_args__ = (Index("ix_stage_map_in_force", "rig", unique=True, **_where("withdrawn_at IS NULL")),)

    id: int = Field(default=None, primary_key=True)
    rig: str
    solution_id: str = Field(foreign_key="solution.id")
    document: dict[str, Any] = Field(sa_type=CheckedJson)
    sha256: str = Field(sa_type=Sha256)
    put_at: datetime = Field(sa_type=UtcText)
    put_by: str | None = None
    withdrawn_at: datetime | None = Field(default=None, sa_type=UtcText)


class LogStudyTable(Table, table=True):
    """What was found in a log that somebody brought: the report and its pictures, not the log."""

    __table_args__ = (Index("ix_log_study_created_at_id", "created_at", "id"),)

    id: str = Field(primary_key=True)
    created_at: datetime = Field(sa_type=UtcText)
    studied_by: str | None = None
    kind: str
    file_name: str
    document: dict[str, Any] = Field(sa_type=CheckedJson)
