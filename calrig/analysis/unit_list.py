"""The list of units: each with its revision in force, latest calibration, last change and due date."""

import csv
import io
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np
from pydantic import Field

from calrig.analysis.due_dates import DueDates
from calrig.analysis.histories import Histories
from calrig.model.base import Model
from calrig.model.verdict import Answer, Left
from calrig.store import Store
from calrig.store.errors import StoreError
from calrig.store.verdicts import Judged

UnitVerdict = Judged | Literal["none"]
UnitDue = Literal["overdue", "soon", "later", "none"]
UnitChange = Literal["changed", "unchanged", "not_known"]
SOON = timedelta(days=30)


class ListedUnit(Model):
    """A sensor: its runs, its revision in force, its latest calibration, and when it is due."""

    serial: str
    verdict: Answer | Literal["no_limits"] | None = Field(
        description="The answer of the revision in force, as issued; null without one."
    )
    left: Left | None = Field(description="The residual of the revision in force, as issued.")
    revision_in_force: int | None
    in_force_since: datetime | None = Field(description="When it was last released.")
    due_at: datetime | None = Field(description="When it is to be calibrated again; null before the first.")
    overdue: bool
    change: UnitChange | None = Field(
        description="Whether any of its valid calibrations differs from the one before; null before two."
    )
    changed_at: datetime | None = Field(description="When the run ended that showed the last change.")
    last_calibrated_at: datetime | None = Field(description="When its latest valid calibration run ended.")
    last_verdict: Answer | Literal["no_limits"] | None = Field(
        description="The answer of that run under today's limits, whether or not it was released."
    )
    last_left: Left | None
    n_runs: int
    last_run_at: datetime | None
    created_at: datetime
    due_method: Literal["interval", "drift"] | None
    due_says: str


@dataclass(frozen=True, slots=True)
class UnitFilter:
    """What the list is narrowed to; None where it does not matter.

    Attributes:
        text: part of the serial number, in any case.
        verdict: answer or residual of the revision in force; `none` without one.
        due: overdue, within `SOON`, later, or without a date.
    """

    text: str | None = None
    verdict: UnitVerdict | None = None
    due: UnitDue | None = None
    change: UnitChange | None = None

    def takes(self, unit: ListedUnit) -> bool:
        """Return whether a unit is in the list."""
        if self.text is not None and self.text.casefold() not in unit.serial.casefold():
            return False
        if self.verdict is not None and self.verdict not in {unit.verdict or "none", unit.left}:
            return False
        if self.change is not None and self.change != unit.change:
            return False
        return self.due is None or self.due == _due(unit)


def listed_units(
    store: Store, found: Histories, due: DueDates, serials: Sequence[str] | None = None
) -> list[ListedUnit]:
    """Return units by serial number, from a fixed number of queries.

    `found` are the histories of all units, or those of `serials` whole; None for all.
    """
    units = store.units.all(serials)
    in_force = store.revisions.summaries_in_force(serials)
    wanted = {unit.serial for unit in units}
    latest = {row.unit: row for row in found.rows if row.unit in wanted}  # the oldest of each unit first
    answers, judged_whole = store.verdicts.answers([row.run_id for row in latest.values()])
    if judged_whole:
        with suppress(StoreError):  # it only makes the next list faster
            store.verdicts.judge(judged_whole)
    changes = _changes(found)
    listed = []
    for unit in units:
        current, last = in_force.get(unit.serial), latest.get(unit.serial)
        answer = None if last is None else answers.get(last.run_id)
        change, changed_at = changes.get(unit.serial, (None, None))
        listed.append(
            ListedUnit(
                serial=unit.serial,
                verdict=None if current is None else current.verdict["answer"],
                left=None if current is None else current.verdict["left"],
                revision_in_force=None if current is None else current.revision,
                in_force_since=None if current is None else current.since,
                change=change,
                changed_at=changed_at,
                last_calibrated_at=None if last is None else last.finished_at,
                last_verdict=None if answer is None else answer.answer,
                last_left=None if answer is None else answer.left,
                n_runs=unit.n_runs,
                last_run_at=unit.last_run_at,
                created_at=unit.created_at,
                **asdict(due.of(unit.serial)),
            )
        )
    return listed


def units_csv(units: Sequence[ListedUnit]) -> str:
    """Return the list as CSV, with a column for each field; what is not known is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(ListedUnit.model_fields)
    writer.writerows([_cell(getattr(unit, name)) for name in ListedUnit.model_fields] for unit in units)
    return text.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return str(value).lower()
    return value.astimezone(UTC).isoformat() if isinstance(value, datetime) else value


def _due(unit: ListedUnit) -> UnitDue:
    if unit.due_at is None:
        return "none"
    if unit.overdue:
        return "overdue"
    return "soon" if unit.due_at < datetime.now(UTC) + SOON else "later"


def _changes(found: Histories) -> dict[str, tuple[UnitChange, datetime | None]]:
    """Return of each unit with two runs whether it ever changed, and when the last change was found."""
    changes = found.changes
    seen: dict[str, tuple[UnitChange, datetime | None]] = {}
    pairs = zip(changes.figures[0].second, changes.changed, np.isfinite(changes.p_value), strict=True)
    for second, has_changed, is_known in pairs:
        row = found.rows[int(second)]
        before = seen.get(row.unit)
        if has_changed:
            seen[row.unit] = "changed", row.finished_at
        elif before is None or before[0] != "changed":
            seen[row.unit] = "unchanged" if is_known else "not_known", None
    return seen
