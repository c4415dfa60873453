"""A unit's calibration in force, and the doubts about a new one that is compared with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from calrig.analysis.histories import change_between, difference_in_words
from calrig.calibration.results import ReadingTurns
from calrig.calibration.uncertainty import (
    Line,
    clamping_doubts,
    displacement_doubts,
    pose_doubts,
    position_doubts,
    remount_doubts,
    repeat_doubts,
    residual_doubts,
)
from calrig.model.result import Doubt, Result
from calrig.store.issued import Revision
from calrig.store.records import ComparisonRow, Document, Run

if TYPE_CHECKING:
    from calrig.store import Store


@dataclass(frozen=True, slots=True)
class Candidate:
    """The run of a new calibration, as far as it can be doubted.

    Attributes:
        run_id: None before it is stored.
        finished_at: aware; now, while it is being completed.
        mismatches: moves in which unit and stage disagree.
    """

    unit: str
    rig: str | None
    run_id: str | None = None
    finished_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    mismatches: int = 0
    homes: bool = True

    @classmethod
    def of(cls, run: Run) -> Candidate:
        """Of a run that is stored."""
        return cls(
            unit=run.unit,
            rig=run.rig,
            run_id=run.id,
            finished_at=run.finished_at or datetime.now(UTC),
            mismatches=run.faults.get("move_mismatch", 0),
            homes=(run.provenance.get("stage") or {}).get("homes") is not False,
        )


@dataclass(frozen=True, slots=True)
class KnownCalibration:
    """A revision that was released, with the run that it is of."""

    revision: Revision
    run: Run

    @property
    def result(self) -> Result:
        """The run's own bias and scale, without effects: what the unit reads clamped as it was then."""
        assert self.run.result is not None  # noqa: S101 (as `known_calibration` looks for it)
        return self.run.result

    @property
    def name(self) -> str:
        """For sentences."""
        if self.revision.status == "in_force":
            return f"revision {self.revision.revision} in force"
        return f"revision {self.revision.revision}, in force before"


def known_calibration(store: Store, unit: str) -> KnownCalibration | None:
    """Return the unit's calibration in force, or the newest that was superseded; None without either.

    Drafts that were not released do not count, nor do revisions of a run that was voided or moved to another
    unit.
    """
    released = [one for one in store.revisions.of(unit) if one.status in ("in_force", "superseded")]
    released.sort(key=lambda one: one.status != "in_force")
    for one in released:
        run = store.runs.get(one.run_id)
        if run is None or run.voided is not None or run.unit != unit:
            continue
        if run.result is not None and run.result.scale is not None:
            return KnownCalibration(one, run)
    return None


def doubts_about(
    store: Store, new: Candidate, result: Result, content: Document, remount_limit_deg: float
) -> list[Doubt]:
    """Return why a run's calibration may not be released by itself.

    `store` has the unit's revisions and the runs of all units. `result` is CONTRACT section 2's, `content`
    what its revision would say, CONTRACT section 6; `remount_limit_deg` is of its rig.
    """
    known = known_calibration(store, new.unit)
    own = [*pose_doubts(result, new.mismatches), *reading_doubts(content)]
    lost = _lost_doubts(store, new.unit, content)
    if known is None:
        return [*own, *clamping_doubts(result.bias_deg, None, remount_limit_deg), *lost]
    if known.run.id == new.run_id:  # the same poses once more: other effects, or some excluded
        return [*own, *lost]
    changed = _change_doubts(store, known, new, result, content, remount_limit_deg)
    return [
        *own,
        *changed,
        *position_doubts(changed, homes=new.homes),
        *residual_doubts(known.result, result, known.name),
        *clamping_doubts(result.bias_deg, known.result.bias_deg, remount_limit_deg),
        *lost,
    ]


def solution_doubts(store: Store, runs: Sequence[Run], content: Document) -> list[Doubt]:
    """Return the same of a unit's calibration by a joint solution of some of its runs.

    It finds the angles of the mounts by itself, so that no clamping is compared.
    """
    own = {
        doubt.says: doubt
        for run in runs
        if run.result is not None
        for doubt in pose_doubts(run.result, run.faults.get("move_mismatch", 0))
    }
    return [*own.values(), *_lost_doubts(store, content["unit"], content)]


def reading_doubts(content: Document) -> list[Doubt]:
    """Return whether readings of the calibrated range stand for two elevations.

    `content` is of CONTRACT section 6.
    """
    turns = ReadingTurns.of_document(content)
    if content["effects"] and content["rms_with_effects_deg"] is None:
        says = (
            "The curve of bias, scale and accepted effects turns round within the range: there one reading "
            "stands for several elevations, and none is given."
        )
        return [Doubt("ambiguous_readings", says)]
    if turns.single_deg is None:
        return []
    first_deg, last_deg = turns.single_deg
    apart_deg = abs(turns.turn_of_reading_deg - 360.0)
    blank = (
        "none is given"
        if first_deg > last_deg
        else f"only from {first_deg:.4g}° to {last_deg:.4g}° is one given"
    )
    says = (
        f"Readings start anew after 360°, and at a scale of {turns.scale:.4g} the range of "
        f"{turns.width_deg:.4g}° is more than that: the same reading stands for elevations {apart_deg:.3g}° "
        f"apart (modulo 360°), and {blank}. Calibrate less than a turn, or give readings that go on "
        "beyond 360°."
    )
    return [Doubt("ambiguous_readings", says.replace("-", "−"))]


def _lost_doubts(store: Store, unit: str, content: Document) -> list[Doubt]:
    """Return what would be lost with the revision in force."""
    in_force = store.revisions.in_force(unit)
    if in_force is None:
        return []
    accepted = [effect.name for effect in store.effects.in_force(unit, None)]
    name = f"revision {in_force.revision}"
    return displacement_doubts(in_force.document, content, accepted, name)


def _change_doubts(
    store: Store,
    known: KnownCalibration,
    new: Candidate,
    result: Result,
    content: Document,
    remount_limit_deg: float,
) -> list[Doubt]:
    before, now = _row(Candidate.of(known.run), known.result), _row(new, result)
    found, k = change_between(store, before, now)
    if any(one is None for one in found.pooled):
        other_stage = known.run.rig != new.rig
        then, line = (Line.of(one, other_stage=other_stage) for one in (known.result, result))
        return remount_doubts(then, line, content["range_deg"], remount_limit_deg, known.name)
    if not found.changed[k]:
        return []
    return repeat_doubts(difference_in_words(found.figures, k, "changed"), known.name)


def _row(one: Candidate, result: Result) -> ComparisonRow:
    """A run as comparisons have it, whether it is stored as completed already or not."""
    return ComparisonRow(one.unit, one.run_id or "", one.rig, one.finished_at, result.model_dump(mode="json"))
