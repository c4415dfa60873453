"""Units calibrated one after the other, from a list that the service keeps: all pages show the same."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.analysis.origin import check_serial
from calrig.plan import Plan
from calrig.processes.pool import Apart
from calrig.runs.batch_turns import Settled, settled
from calrig.runs.mounting import Mount
from calrig.runs.planned import planned_poses
from calrig.runs.services import Service
from calrig.store import Run
from calrig.store.batches import Batch, Turn
from calrig.store.errors import ChangedMeanwhile

MOST_UNITS = 2000
AT_ONCE = 20
"""How often a list is read again where others write it at the same moment."""
NAMES = ("unit", "serial", "serial number", "serial_number", "sn")
"""Headings over the serials of a table."""
REMEMBERED = 4096
"""Runs that have ended, which a look at a list need not read again."""


@dataclass(frozen=True, slots=True)
class Standing:
    """A list as it stands, with the runs of its turns by id."""

    batch: Batch
    now: Settled
    runs: Mapping[str, Run]

    @property
    def mount(self) -> Mount:
        """How a unit is to be clamped when its turn begins."""
        plan = Plan.model_validate(self.batch.document["plan"])
        return Mount(plan.mounts_deg[0], plan.mount_axis)


class RunBatches:
    """The lists of a service. Thread-safe."""

    def __init__(self, service: Service) -> None:
        self._service, self._store = service, service.store
        self._ended_run = lru_cache(REMEMBERED)(service.run)

    def make(
        self,
        units: Sequence[str],
        *,
        rigs: Sequence[str],
        plan: Plan,
        failed: str,
        operator: str | None,
        note: str | None,
    ) -> Batch:
        """Keeps a new list; the same unit twice has one turn.

        Raises:
            Invalid: no serials, too many, or what is none; a pose is beyond the limits of a rig.
            Unknown: there is no such rig.
        """
        serials = checked(units)
        if not rigs:
            raise Invalid("a list is for one rig at least", ["rigs"])
        for name in rigs:
            planned_poses(plan, self._service.known_rig(name))
        document = {
            "rigs": list(dict.fromkeys(rigs)),
            "plan": plan.model_dump(mode="json"),
            "failed": failed,
            "operator": operator,
            "note": note,
        }
        return self._store.keep_batch(document, serials)

    def add(self, batch_id: str, units: Sequence[str]) -> list[str]:
        """Adds units at the end; gives those that the list has already. Errors as of `make` and the store."""
        serials = checked(units)
        if len(self.standing(batch_id).now.turns) + len(serials) > MOST_UNITS:
            raise Invalid(f"a list has at most {MOST_UNITS} units: make another one", ["units"])
        self._write(batch_id)
        return self._store.add_turns(batch_id, serials)

    def remove(self, batch_id: str, unit: str) -> None:
        """Takes a unit out that waits, or Conflict."""
        self._write(batch_id, lambda standing: [replace(_waiting(standing, unit), state="removed", rig=None)])

    def start(
        self,
        batch_id: str,
        rig: str,
        unit: str,
        apart: Apart,
        who: str | None,
        stage_at_deg: float | None = None,
    ) -> Run:
        """Begins the run of a unit that a person has mounted on a rig, and keeps the next unit for that rig.

        Raises:
            Unknown: there is no such rig.
            Conflict: the unit does not wait, or the rig is busy: of two who ask at once one is refused.
        """
        standing = self.standing(batch_id)
        if standing.batch.closed_at is not None:
            raise Conflict("this list is closed: make another one")
        document = standing.batch.document
        if rig not in document["rigs"]:
            raise Conflict(f"this list is not for rig {rig!r}")
        turn = _waiting(standing, unit)
        if turn.state == "follow_up":
            run = self._follow_up(standing, turn, apart, who)
        else:
            run = self._service.start(
                unit=unit,
                rig=rig,
                plan=Plan.model_validate(document["plan"]),
                operator=who or document["operator"],
                note=document["note"],
                stage_at_deg=stage_at_deg,
            )

        def begun(now: Standing) -> list[Turn]:
            under_way = replace(_waiting(now, unit), state="running", rig=run.rig, run_id=run.id, why=None)
            return [under_way, *_kept(now.now, rig, under_way)]

        try:
            self._write(batch_id, begun)
        except Exception:
            self._service.abort(run.id)  # nobody would know that it belongs to the list
            raise
        return run

    def _follow_up(self, standing: Standing, turn: Turn, apart: Apart, who: str | None) -> Run:
        assert turn.run_id is not None  # noqa: S101 (of a follow-up)
        try:
            asked = self._service.follow_up_question(turn.run_id)
            return self._service.follow_up(asked, apart(asked.work), who)
        except Conflict as error:
            if turn.rig in {state.name for state in self._service.rigs() if state.state == "busy"}:
                raise
            why = str(error).removeprefix(f"run {turn.run_id}: ")
            self._write(
                standing.batch.id, lambda now: [replace(_waiting(now, turn.unit), state="failed", why=why)]
            )
            raise Conflict(f"{turn.unit}: {why}") from error

    def look(self, batch_id: str) -> Standing:
        """Has the boards of idle rigs looked at: whether the unit asked for is there. Moves nothing."""
        standing = self.standing(batch_id)
        if standing.batch.closed_at is not None:
            return standing
        for rig, turn in standing.now.on.items():
            if turn is not None and turn.state != "running":
                with suppress(Unknown, Conflict):  # a rig that is no more shows as offline
                    self._service.look(rig)
        return standing

    def close(self, batch_id: str) -> None:
        """Ends a list; what is under way goes on."""
        self._write(batch_id)
        self._store.close_batch(batch_id)

    def standing(self, batch_id: str) -> Standing:
        """How a list stands now; changes nothing."""
        batch = self._store.batch(batch_id)
        runs = {turn.run_id: self._run(turn) for turn in batch.turns if turn.run_id is not None}
        document = batch.document
        return Standing(batch, settled(batch.turns, runs, document["rigs"], document["failed"]), runs)

    def _run(self, turn: Turn) -> Run:
        """Its run; one that had ended for good when the turn was written is not read again."""
        assert turn.run_id is not None  # noqa: S101 (as asked for)
        return self._service.run(turn.run_id) if turn.state == "running" else self._ended_run(turn.run_id)

    def _write(self, batch_id: str, changed: Callable[[Standing], Iterable[Turn]] = lambda _: ()) -> None:
        """Writes what has become of the turns, and those that `changed` gives of how the list stands.

        Where somebody else writes at the same moment, at another rig or with a scanner, it is done anew.
        """
        for left in reversed(range(AT_ONCE)):
            standing = self.standing(batch_id)
            written = (*standing.now.written, *changed(standing))
            by_position = {turn.position: turn for turn in written}
            try:
                self._store.write_turns(batch_id, standing.batch.turns, by_position.values())
            except ChangedMeanwhile:
                if not left:
                    raise
            else:
                return


def checked(units: Sequence[str]) -> list[str]:
    """Serials without blanks around them, each once, lines without any left out.

    Raises:
        Invalid: none is left, or too many; or one is no serial, and which.
    """
    serials = list(dict.fromkeys(unit.strip() for unit in units if unit.strip()))
    if not serials:
        raise Invalid("no serial number was given: scan or paste some, one a line", ["units"])
    if len(serials) > MOST_UNITS:
        raise Invalid(f"a list has at most {MOST_UNITS} units, not {len(serials)}", ["units"])
    for number, serial in enumerate(serials, start=1):
        _check(serial, f"serial {number}", "units")
    return serials


def serials_in(table: str) -> tuple[list[str], int]:
    """The serials of a CSV, and how many rows have none.

    They are in the column headed `unit` or `serial`, else in the first, whose first row counts. A line
    `sep=;` before all others, which spreadsheets write, names the delimiter.

    Raises:
        Invalid: it is no CSV, or one is no serial; says in which line.
    """
    text = table.removeprefix("\ufeff")
    if "\ufffd" in text:
        raise Invalid("the file is not UTF-8: save it as “CSV UTF-8”", ["csv"])
    lines = list(io.StringIO(text, newline="")) or [""]
    named = re.fullmatch(r"sep=(.)\s*", lines[0])
    n_skipped = 1 if named else 0
    delimiter = named[1] if named else max(",;\t", key=lines[0].count)
    reader = csv.reader(lines[n_skipped:], delimiter=delimiter)
    try:
        rows = [(n_skipped + reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise Invalid(f"the file is no CSV: {error}", ["csv"]) from error
    headings = [cell.strip().casefold() for cell in rows[0][1]] if rows else []
    column = next((headings.index(name) for name in NAMES if name in headings), None)
    if column is None:
        column = 0
    else:
        del rows[0]
    found = [(line, row[column].strip() if len(row) > column else "") for line, row in rows]
    for line, serial in found:
        if serial:
            _check(serial, f"line {line}", "csv")
    serials = [serial for _, serial in found if serial]
    return serials, len(found) - len(serials)


def _check(serial: str, where: str, field: str) -> None:
    try:
        check_serial(serial)
    except Invalid as error:
        raise Invalid(f"{where}, {serial[:40]!a}: {error}", [field]) from error


def _waiting(standing: Standing, unit: str) -> Turn:
    mine = [turn for turn in standing.now.turns if turn.unit == unit]
    for turn in mine:
        if turn.state in ("waiting", "follow_up"):
            return turn
    if not mine or mine[-1].state == "removed":
        raise Conflict(f"{unit} is not in this list: add it first")
    raise Conflict(
        f"{unit} is on rig {mine[-1].rig} already"
        if mine[-1].state == "running"
        else f"{unit} is done already"
    )


def _kept(now: Settled, rig: str, begun: Turn) -> list[Turn]:
    """Turns to be kept for the rigs whose pages show them: what a person holds already stays theirs."""
    shown = {name: turn for name, turn in now.on.items() if name != rig}
    own = now.on[rig]
    shown[rig] = now.then[rig] if own is None or own.position == begun.position else own
    return [
        replace(turn, rig=name)
        for name, turn in shown.items()
        if turn is not None
        and turn.state == "waiting"
        and turn.rig is None
        and turn.position != begun.position
    ]
