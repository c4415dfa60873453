"""Joint solutions as solved. A stage map is put in force from one, and compared with later ones."""

import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy
from pydantic import TypeAdapter

from calrig.model.solution import ListedSolution
from calrig.store.database import Repository, row_of
from calrig.store.records import Basis, Solved
from calrig.store.tables import SolutionTable

_COLUMN = sqlalchemy.inspect(SolutionTable).local_table.c
_BASIS = TypeAdapter(Basis)
_NEWEST_FIRST = _COLUMN.created_at.desc(), _COLUMN.id.desc()


@dataclass(frozen=True, slots=True)
class StoredSolution:
    """A joint solution by its id; `by` is None where nobody is known by name."""

    id: str
    created_at: datetime
    by: str | None
    found: Solved


_LISTED = (
    _COLUMN.id,
    _COLUMN.created_at,
    _COLUMN.solved_by,
    _COLUMN.rig,
    _COLUMN.basis,
    _COLUMN.document["separable"].as_boolean(),
    _COLUMN.document[("before", "held_out_rms_deg")].as_float(),
    _COLUMN.document[("final", "held_out_rms_deg")].as_float(),
)


class Solutions(Repository):
    """Every joint solution that was kept; none ever changes."""

    def save(self, found: Solved, *, by: str | None = None) -> StoredSolution:
        """Keeps one under a new id."""
        kept = StoredSolution(str(uuid.uuid4()), datetime.now(UTC), by, found)
        row = SolutionTable(
            id=kept.id,
            created_at=kept.created_at,
            solved_by=by,
            rig=found.rig,
            basis=asdict(found.basis),
            document=found.document,
            calibrations=found.calibrations,
            stage_map=found.stage_map,
            poses=found.poses,
        )
        with self._database.writing() as session:
            session.add(row)
        return kept

    def get(self, solution_id: str) -> StoredSolution:
        """One by its id.

        Raises:
            NotFound: there is none.
        """
        with self._database.reading() as session:
            row = row_of(session, SolutionTable, solution_id, f"there is no solution {solution_id!r}")
            basis = _BASIS.validate_python(row.basis)
            found = Solved(row.rig, basis, row.document, row.calibrations, row.stage_map, row.poses)
            return StoredSolution(row.id, row.created_at, row.solved_by, found)

    def newest(self, rig: str | None = None, limit: int | None = None) -> list[ListedSolution]:
        """Those of a rig, or all, the newest first."""
        query = sqlalchemy.select(*_LISTED).order_by(*_NEWEST_FIRST).limit(limit)
        if rig is not None:
            query = query.where(_COLUMN.rig == rig)
        with self._database.reading() as session:
            return [_listed(row) for row in session.connection().execute(query)]


def _listed(row: Sequence[Any]) -> ListedSolution:
    *known_by, basis, separable, before_rms_deg, final_rms_deg = row
    return ListedSolution.model_validate(
        {
            **dict(zip(("id", "created_at", "by", "rig"), known_by, strict=True)),
            **asdict(_BASIS.validate_python(basis)),
            "separable": separable,
            "before": {"held_out_rms_deg": before_rms_deg},
            "final": {"held_out_rms_deg": final_rms_deg},
        }
    )
