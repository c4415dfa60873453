"""Units calibrated one after the other, from a list that the service keeps: all pages show the same."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from threading import Lock

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.plan import Plan
from calrig.processes.pool import Apart
from calrig.runs.batch_serials import MOST_UNITS, checked
from calrig.runs.batch_turns import Settled, settled
from calrig.runs.mounting import Mount
from calrig.runs.planned import planned_poses
from calrig.runs.services import Service
from calrig.store import Run
from calrig.store.batches import Batch, Turn
from calrig.store.errors import ChangedMeanwhile, Refused, StoreError

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
    now: Settled
    runs: Mapping[str, Run]

    @property
    def mount(self) -> Mount:
        """How a unit is to be clamped when its turn begins."""
        plan = Plan.model_validate(self.batch.document["plan"])
        return Mount(plan.mounts_deg[0], plan.mount_axis)

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
        serials, standing = checked(units), self.standing(batch_id)
        if len(standing.now.turns) + len(serials) > MOST_UNITS:
            raise Invalid(f"a list has at most {MOST_UNITS} units: make another one", ["units"])
        if standing.batch.closed_at is None and not standing.takes_units(self._now()):
            raise Conflict("this list is another day's: measure a unit of it first, or make another list")
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
        for batch in self._store.batches():
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
                self._store.write_turns(batch_id, standing.batch.turns, standing.now.written, closed_at)
            standing = self._read(batch_id)
        return standing

    def _read(self, batch_id: str) -> Standing:
        batch = self._store.batch(batch_id)
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
                self._store.write_turns(batch_id, standing.batch.turns, by_position.values(), closed_at)
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
