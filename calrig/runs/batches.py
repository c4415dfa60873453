"""Batches: units that are calibrated one after the other, which one is next, and how each ended.

Every page shows the same batch, because the service stores it.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from threading import Lock
from typing import Literal

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.analysis.imports import check_serial
from calrig.analysis.stage_maps import kept_of
from calrig.model.plan import Plan
from calrig.model.run import TERMINAL
from calrig.processes.pool import OffloadedCall
from calrig.runs.mounting import Mounting
from calrig.runs.plan_estimates import planned_poses, require_reachable
from calrig.runs.services import Service
from calrig.store import Run
from calrig.store.batches import Batch, Turn
from calrig.store.errors import ChangedMeanwhile, Refused, StoreError

Failed = Literal["end", "follow_up"]
"""What becomes of a unit that failed: another turn at the end of the list, or the run that tells why."""
Word = Literal["pass", "fail", "done"]
TRIES = 2
"""Turns that a unit which fails has in a list, follow-ups not counted."""
POOR = ("fail", "conditional_fail")
OVER = ("done", "failed", "removed")


@dataclass(frozen=True, slots=True)
class BatchState:
    """A list as it stands now.

    Attributes:
        turns: every turn; one whose run measured nothing waits again.
        written: those of `turns` that the store has otherwise, and for good.
        on: the turn of each rig: under way, else the one to be mounted; None where the list has none left.
        then: the turn that is kept for each rig after that.
    """

    turns: list[Turn]
    written: list[Turn]
    on: dict[str, Turn | None]
    then: dict[str, Turn | None]

    @property
    def is_finished(self) -> bool:
        """Whether every unit has had all its turns."""
        return all(turn.state in OVER for turn in self.turns)


def settled(
    turns: Sequence[Turn], runs: Mapping[str, Run], rigs: Sequence[str], failed: Failed
) -> BatchState:
    """How a list stands.

    `turns` are as stored, by position; `runs` those of the turns that have one, by id.
    """
    now, more = [], []
    for turn in turns:
        run = runs.get(turn.run_id or "")
        ended = _ended(turn, run) if turn.state == "running" and run is not None else turn
        now.append(ended)
        if ended.state == "failed" and turn.state == "running" and run is not None:
            more.append((turn, run))
    tries = Counter(turn.unit for turn in now if turn.state == "failed")
    for turn, run in sorted(more, key=lambda one: str(one[1].finished_at)):
        position = len(now)
        if failed == "follow_up" and run.status == "completed" and run.follows is None:
            now.append(Turn(position, turn.unit, "follow_up", turn.rig, run.id))
        elif (failed == "end" or run.status == "failed") and not run.follows and tries[turn.unit] < TRIES:
            now.append(Turn(position, turn.unit, why="it failed before in this list"))
    stored = dict(enumerate(turns))
    written = [
        t for t in now if t.position >= len(turns) or (t != stored[t.position] and t.state != "waiting")
    ]
    on = _on(now, rigs)
    taken = {turn.position for turn in on.values() if turn is not None}
    return BatchState(now, written, on, _kept_by_rig([t for t in now if t.position not in taken], rigs))


def word_of(run: Run) -> Word | None:
    """What a run came to, in one word; None where it has not ended or nothing was measured.

    A conditional pass is no more than `done`, nor is what is undecided.
    """
    if run.status == "failed" and run.progress.poses_done:
        return "fail"
    if run.status != "completed":
        return None
    answer = None if run.verdict is None else run.verdict.answer
    return "fail" if answer in POOR else "pass" if answer == "pass" else "done"


def _ended(turn: Turn, run: Run) -> Turn:
    word = word_of(run)
    if word is not None:
        return replace(turn, state="failed" if word == "fail" else "done", why=run.error)
    if (
        run.status in TERMINAL or run.status == "interrupted"
    ):  # nothing came of it: the unit stays where it is
        return replace(turn, state="waiting", why=run.error or f"its run was {run.status}")
    return turn


def _on(turns: Sequence[Turn], rigs: Sequence[str]) -> dict[str, Turn | None]:
    """Each rig's turn: under way, come to nothing before, a follow-up, kept for it, else the next.

    A rig that is left without any has what is kept for another one that has something else before it.
    """
    on: dict[str, Turn | None] = {}
    for rig in rigs:
        mine = [
            turn for turn in turns if turn.rig == rig and turn.state in ("running", "waiting", "follow_up")
        ]
        on[rig] = min(mine, key=_urgency, default=None)
    on = _filled(on, turns)
    taken = {turn.position for turn in on.values() if turn is not None}
    return _filled(on, [replace(turn, rig=None) for turn in turns if turn.position not in taken])


def _kept_by_rig(turns: Sequence[Turn], rigs: Sequence[str]) -> dict[str, Turn | None]:
    kept: dict[str, Turn | None] = {
        rig: next((turn for turn in turns if turn.rig == rig and turn.state == "waiting"), None)
        for rig in rigs
    }
    return _filled(kept, turns)


def _filled(places: dict[str, Turn | None], turns: Sequence[Turn]) -> dict[str, Turn | None]:
    """Rigs without a turn get those that are kept for nobody, in order."""
    free = (turn for turn in turns if turn.state == "waiting" and turn.rig is None)
    return {rig: turn if turn is not None else next(free, None) for rig, turn in places.items()}


def _urgency(turn: Turn) -> tuple[int, int]:
    rank = {"running": 0, "follow_up": 2}.get(turn.state, 1 if turn.run_id is not None else 3)
    return rank, turn.position


MOST_UNITS = 2000
NAMES = ("unit", "serial", "serial number", "serial_number", "sn")
"""Headings over the serials of a table."""


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


AT_ONCE = 20
"""How often a list is read again where others write it at the same moment."""
FINISHED = timedelta(hours=1)
"""How long a list stays open after its last unit: for what is found at the bottom of the box."""
QUIET = timedelta(hours=8)
"""After so long without a run a list that has units left takes no further ones: it is another day's."""
REMEMBERED = 4096
"""Runs that have ended, which a look at a list need not read again."""


@dataclass(frozen=True, slots=True)
class Standing:
    """A list as it stands, with the runs of its turns by id."""

    batch: Batch
    now: BatchState
    runs: Mapping[str, Run]

    @property
    def mount(self) -> Mounting:
        """How a unit is to be clamped when its turn begins."""
        plan = Plan.model_validate(self.batch.document["plan"])
        return Mounting(plan.mounts_deg[0], plan.mount_axis)

    @property
    def active_at(self) -> datetime:
        """When the list was made, or a run of it began or ended last."""
        ran = [run.finished_at or run.created_at for run in self.runs.values()]
        return max([self.batch.created_at, *ran])

    def takes_units(self, now: datetime) -> bool:
        """Whether units may be added."""
        is_running = any(turn.state == "running" for turn in self.now.turns)
        return self.batch.closed_at is None and (is_running or now - self.active_at < QUIET)


class RunBatches:
    """The lists of a service. Thread-safe."""

    def __init__(self, service: Service, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._service, self._store, self._now = service, service.store, now
        self._ended_run = lru_cache(REMEMBERED)(service.run)
        self._lock = Lock()
        self._in_design: set[tuple[str, str]] = set()

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
            Invalid: no serials, too many, or what is none; a rig cannot carry out or end the plan.
            Unknown: there is no such rig.
        """
        serials = checked(units)
        if not rigs:
            raise Invalid("a list is for one rig at least", ["rigs"])
        for name in rigs:
            settings, in_force = self._service.known_rig(name), kept_of(self._store, name, self._service.maps)
            planned_poses(plan, settings)
            require_reachable(plan, settings, "", self._store, in_force)
        document = {
            "rigs": list(dict.fromkeys(rigs)),
            "plan": plan.model_dump(mode="json"),
            "failed": failed,
            "operator": operator,
            "note": note,
        }
        return self._store.batches.create(document, serials)

    def add(self, batch_id: str, units: Sequence[str]) -> list[str]:
        """Adds units at the end; gives those that the list has already. Errors as of `make` and the store."""
        serials, standing = checked(units), self.standing(batch_id)
        if len(standing.now.turns) + len(serials) > MOST_UNITS:
            raise Invalid(f"a batch has at most {MOST_UNITS} units: create another one", ["units"])
        if standing.batch.closed_at is None and not standing.takes_units(self._now()):
            raise Conflict(
                "this batch has had no run for 8 h and takes no more units: run one of its units first, "
                "or create a new batch"
            )
        self._write(batch_id)
        return self._store.batches.add_units(batch_id, serials)

    def remove(self, batch_id: str, unit: str) -> None:
        """Takes a unit out that waits, or Conflict."""
        self._write(batch_id, lambda standing: [replace(_waiting(standing, unit), state="removed", rig=None)])

    def start(
        self,
        batch_id: str,
        rig: str,
        unit: str,
        apart: OffloadedCall,
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
            raise Conflict("this batch is closed: create another one")
        document = standing.batch.document
        if rig not in document["rigs"]:
            raise Conflict(f"this batch does not use rig {rig!r}")
        turn = _waiting(standing, unit)
        if turn.state == "follow_up":
            with self._designing(batch_id, unit):
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
            shown, own = dict(now.now.on), now.now.on[rig]
            if own is None or own.position == under_way.position:
                shown[rig] = now.now.then[rig]
            return [*_kept(shown), under_way]

        try:
            self._write(batch_id, begun)
        except Exception:
            self._service.abort(run.id)  # nobody would know that it belongs to the list
            raise
        return run

    def is_in_design(self, batch_id: str, unit: str) -> bool:
        """Whether the run that tells why a unit fails is being designed by this program."""
        return (batch_id, unit) in self._in_design

    @contextmanager
    def _designing(self, batch_id: str, unit: str) -> Iterator[None]:
        with self._lock:
            if self.is_in_design(batch_id, unit):
                raise Conflict(f"{unit}: its next run is being designed")
            self._in_design.add((batch_id, unit))
        try:
            yield
        finally:
            self._in_design.discard((batch_id, unit))

    def _follow_up(self, standing: Standing, turn: Turn, apart: OffloadedCall, who: str | None) -> Run:
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
        """Has the boards of idle rigs looked at: whether the unit asked for is there. Moves nothing.

        Who looks is about to mount what he is shown: it is kept for that rig from now on.
        """
        standing = self.standing(batch_id)
        if standing.batch.closed_at is not None:
            return standing
        if _kept(standing.now.on):
            with suppress(Refused):  # somebody else writes: the next look does
                self._write(batch_id, lambda now: _kept(now.now.on))
        for rig, turn in standing.now.on.items():
            if turn is not None and turn.state != "running":
                with suppress(Unknown, Conflict):  # a rig that is no more shows as offline
                    self._service.look(rig)
        return standing

    def close(self, batch_id: str) -> None:
        """Ends a list; what is under way goes on."""
        self._write(batch_id, closed_at=self._now())

    def listed(self) -> list[tuple[Batch, bool]]:
        """The lists made last, the newest first; and of each whether units may be added."""
        lists = []
        for batch in self._store.batches.newest():
            standing = None if batch.closed_at is not None else self.standing(batch.id)
            now = (batch, False) if standing is None else (standing.batch, standing.takes_units(self._now()))
            lists.append(now)
        return lists

    def standing(self, batch_id: str) -> Standing:
        """How a list stands now. One that was finished a while ago is closed by whoever asks first."""
        standing = self._read(batch_id)
        closed_at = standing.active_at + FINISHED
        if standing.batch.closed_at is None and standing.now.is_finished and closed_at <= self._now():
            with suppress(StoreError):  # the next who asks does
                self._store.batches.update(batch_id, standing.batch.turns, standing.now.written, closed_at)
            standing = self._read(batch_id)
        return standing

    def _read(self, batch_id: str) -> Standing:
        batch = self._store.batches.get(batch_id)
        runs = {turn.run_id: self._run(turn) for turn in batch.turns if turn.run_id is not None}
        document = batch.document
        return Standing(batch, settled(batch.turns, runs, document["rigs"], document["failed"]), runs)

    def _run(self, turn: Turn) -> Run:
        """Its run; one that had ended for good when the turn was written is not read again."""
        assert turn.run_id is not None  # noqa: S101 (as asked for)
        return self._service.run(turn.run_id) if turn.state == "running" else self._ended_run(turn.run_id)

    def _write(
        self,
        batch_id: str,
        changed: Callable[[Standing], Iterable[Turn]] = lambda _: (),
        closed_at: datetime | None = None,
    ) -> None:
        """Writes what has become of the turns, and those that `changed` gives of how the list stands.

        Where somebody else writes at the same moment, at another rig or with a scanner, it is done anew.
        """
        for left in reversed(range(AT_ONCE)):
            standing = self.standing(batch_id)
            written = (*standing.now.written, *changed(standing))
            by_position = {turn.position: turn for turn in written}
            try:
                self._store.batches.update(batch_id, standing.batch.turns, by_position.values(), closed_at)
            except ChangedMeanwhile:
                if not left:
                    raise
            else:
                return


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


def _kept(shown: Mapping[str, Turn | None]) -> list[Turn]:
    """Turns to be kept for the rigs whose pages show them: what a person holds already stays theirs."""
    return [
        replace(turn, rig=name)
        for name, turn in shown.items()
        if turn is not None and turn.state == "waiting" and turn.rig != name
    ]
