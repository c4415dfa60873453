"""Convert between rows of the tables and records."""

import dataclasses
import io
import math
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, TypeVar, cast, get_args

import numpy as np
from pydantic import ValidationError
from sqlalchemy.orm import object_session
from sqlmodel import Session, select

from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.uncertainty import limit_for
from calrig.model.base import Model
from calrig.model.result import Result
from calrig.model.run import Progress, Status, Voided
from calrig.model.verdict import Limit
from calrig.run_ids import is_run_id
from calrig.store import checksums
from calrig.store.errors import NotFound, Unreadable
from calrig.store.limits import limits_of
from calrig.store.records import Document, RawSamples, Run, SampleBlock, StoredPose
from calrig.store.tables import CalibrationTable, PoseTable, RunTable, SampleBlockTable

_NO_COLUMNS = {"filtering", "map_deg"}
_POSE_FIELDS = tuple(field.name for field in dataclasses.fields(Pose) if field.name not in _NO_COLUMNS)
POSE_NUMBERS = tuple(name for name in _POSE_FIELDS if name != "covariates")
FIGURES = tuple(name for name in CalibrationTable.model_fields if name not in {"run_id", "crc32"})
"""The columns of a result in comparisons."""
_ARRAYS = ("time_s", "accel_g", "gyro_dps", "temperature_c")
_ANGLE = "angle_deg"
"""Packed only where the board sends it."""
M = TypeVar("M", bound=Model)
LARGEST_BLOCK = 500_000_000
"""Bytes of it unpacked: a quarter of an hour at 8 kHz."""


def iso_utc(time: datetime) -> str:
    """ISO 8601 in UTC with a `Z`, as the API writes times."""
    return time.astimezone(UTC).isoformat().replace("+00:00", "Z")


def find_run(session: Session, run_id: str) -> RunTable | None:
    """The row of a run, or None; what could be no id is not asked for."""
    if not is_run_id(run_id):
        return None
    return session.exec(select(RunTable).where(RunTable.uid == run_id)).first()


def run_row(session: Session, run_id: str) -> RunTable:
    """The row of a run that must be there.

    Raises:
        NotFound: it is not.
    """
    row = find_run(session, run_id)
    if row is None:
        raise NotFound(f"there is no run {run_id}")
    return row


_TEXTS = ("uid", "unit", "rig", "kind", "status", "operator", "note", "voided_reason", "error")
_UNCHANGED = (
    *("unit", "rig", "plan", "diagnosis", "faults", "provenance", "operator", "note"),
    *("created_at", "started_at", "finished_at", "error"),
)
"""Columns that a run shows as they are."""


def check_texts(values: Iterable[object], what: str) -> None:
    """Raises Unreadable where bytes stand in the place of text: SQLite keeps anything in any column."""
    if not all(value is None or isinstance(value, str) for value in values):
        raise Unreadable(f"{what} is not what was stored: there is no text where some belongs")


def run_of(row: RunTable) -> Run:
    """The run of a row."""
    check_texts((getattr(row, name) for name in _TEXTS), f"run {row.uid}")
    if row.status not in get_args(Status):
        raise Unreadable(f"run {row.uid} is not what was stored: there is no status {row.status[:40]!r}")
    voided: Voided | None = None
    if row.voided_reason is not None and row.voided_at is not None:
        voided = Voided(reason=row.voided_reason, at=row.voided_at)
    return Run.model_construct(
        **{name: getattr(row, name) for name in _UNCHANGED},
        id=row.uid,
        status=cast(Status, row.status),
        progress=_read(Progress, row.progress),
        result=None if row.result is None else _read(Result, row.result),
        follows=None if row.follows is None else _followed_by(row),
        voided=voided,
        limit=None if row.result is None else _limit_of(row),
    )


def _read(kind: type[M], document: Document) -> M:
    """Read a document of a run; one that lacks what every run of calrig has is taken as it stands."""
    try:
        return kind.model_validate(document)
    except ValidationError:
        return cast(M, kind.model_construct(**document))


def _followed_by(row: RunTable) -> str:
    """The id of the run that a run follows; few follow any."""
    session = cast(Session, object_session(row))
    followed = session.exec(select(RunTable.uid).where(RunTable.id == row.follows)).first()
    if followed is None:
        raise Unreadable(f"the run that run {row.uid} follows is missing")
    return followed


def _limit_of(row: RunTable) -> Limit | None:
    session = object_session(row)
    return None if session is None else limit_for(limits_of(cast(Session, session)), row.unit, row.rig)


def figures_of(run_id: int, result: dict[str, Any]) -> CalibrationTable:
    """The row that stands for a result in comparisons."""
    temperature = result.get("temperature_c") or {}
    part = result | {f"temperature_{end}_c": temperature.get(end) for end in ("min", "max")}
    columns: dict[str, Any] = {name: part.get(name) for name in FIGURES}
    figures = CalibrationTable(run_id=run_id, **columns)
    figures.crc32 = checksums.of_numbers(getattr(figures, name) for name in FIGURES)
    return figures


def result_part(figures: Sequence[float | None]) -> dict[str, Any]:
    """The part of a result that such a row holds, from its columns in the order of `FIGURES`."""
    part: dict[str, Any] = dict(zip(FIGURES, figures, strict=True))
    extremes = {end: part.pop(f"temperature_{end}_c") for end in ("min", "max")}
    return part | {"temperature_c": extremes}


def pose_values(run_id: int, index: int, pose: Pose) -> dict[str, Any]:
    """A pose as the columns of its table."""
    values = {name: getattr(pose, name) for name in _POSE_FIELDS}
    for name in POSE_NUMBERS:  # SQLite takes what is no number for null, PostgreSQL keeps it
        if isinstance(values[name], float) and math.isnan(values[name]):
            values[name] = None
    crc32 = checksums.of_numbers((run_id, index, *(values[name] for name in POSE_NUMBERS)))
    return {"run_id": run_id, "pose_index": index, **values, "crc32": crc32}


def pose_of(row: PoseTable, run_id: str, filtering: Filtering | None) -> StoredPose:
    """The pose of a row, of the run with that id, read through the run's filter."""
    what = f"pose {row.pose_index} of run {run_id}"
    numbers = (getattr(row, name) for name in POSE_NUMBERS)
    checksums.check_numbers(row.crc32, (row.run_id, row.pose_index, *numbers), what)
    pose = Pose(**{name: getattr(row, name) for name in _POSE_FIELDS}, filtering=filtering)
    return StoredPose(index=row.pose_index, pose=pose, excluded=row.excluded_reason)


def packed_arrays(block: SampleBlock) -> bytes:
    """A block's arrays as a compressed npz of float64: every bit of them comes back."""
    buffer = io.BytesIO()
    names = _ARRAYS if block.angle_deg is None else (*_ARRAYS, _ANGLE)
    arrays = {name: np.asarray(getattr(block, name), dtype=np.float64) for name in names}
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def joined_arrays(blobs: Iterable[bytes]) -> RawSamples:
    """The samples of several blocks one after the other; none where there are no blocks."""
    parts: dict[str, list[np.ndarray[Any, Any]]] = {
        name: [np.empty((0, 3) if name in {"accel_g", "gyro_dps"} else 0)] for name in _ARRAYS
    }
    angles: list[np.ndarray[Any, Any]] = []
    for blob in blobs:
        arrays = _unpacked(blob)
        for name in _ARRAYS:
            parts[name].append(arrays[name])
        angles.append(arrays.get(_ANGLE, np.full(len(arrays["time_s"]), np.nan)))
    samples = RawSamples(**{name: np.concatenate(arrays) for name, arrays in parts.items()})
    angle_deg = np.concatenate([np.empty(0), *angles])
    return samples if np.isnan(angle_deg).all() else replace(samples, angle_deg=angle_deg)


def unpacked_block(blob: bytes) -> RawSamples:
    """The samples of one block, with the board's angle wherever it was packed."""
    return RawSamples(**_unpacked(blob))


def labelled_block(row: SampleBlockTable) -> SampleBlock:
    """The samples of one block with what they are of."""
    if row.phase not in ("move", "dwell"):
        raise Unreadable(f"raw samples are not what was stored: there is no phase {row.phase[:40]!r}")
    return SampleBlock(row.pose_index, cast(Any, row.phase), **_unpacked(row.data))


def _unpacked(blob: bytes) -> dict[str, np.ndarray[Any, Any]]:
    """The arrays of one block; the npz has a CRC-32 for each."""
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as archive:
            n_bytes = sum(member.file_size for member in archive.infolist())
        if n_bytes > LARGEST_BLOCK:
            raise ValueError(f"they would be {n_bytes} bytes, more than any move or dwell has")
        with np.load(io.BytesIO(blob), allow_pickle=False) as packed:
            arrays = {name: packed[name] for name in (*_ARRAYS, *({_ANGLE} & set(packed.files)))}
        _check_shapes(arrays)
        return arrays
    except (
        TypeError,
        MemoryError,
        zipfile.BadZipFile,
        zlib.error,
        ValueError,
        KeyError,
        EOFError,
        OSError,
        RuntimeError,  # a password, a method of compression that Python does not know
    ) as error:
        raise Unreadable(f"raw samples cannot be unpacked any more: {error}") from error


def _check_shapes(arrays: dict[str, np.ndarray[Any, Any]]) -> None:
    n = arrays["time_s"].size
    for name, array in arrays.items():
        shape = (n, 3) if name in {"accel_g", "gyro_dps"} else (n,)
        if array.shape != shape or array.dtype.kind != "f":
            raise ValueError(f"{name} has the shape {array.shape} and the type {array.dtype.kind}")
