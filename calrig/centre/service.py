"""Run service of a centre: its benches carry the runs out.

It sends commands to benches while a request waits, and refuses if a bench cannot be reached. One thread
unpacks deliveries (of several processes, the first one). The centre computes result and draft of a run that
a bench completed, from the effects and limits in force at the centre.
"""

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from calrig.analysis.calibration_in_force import active_calibration
from calrig.analysis.errors import Conflict, RunsError, Unknown
from calrig.analysis.results import ending_of, fitted, gyro_of
from calrig.analysis.revisions import Fitted, Issuer
from calrig.centre.bench_rigs import BenchCounts, BenchRigs
from calrig.instruments.clock import WALL, Clock
from calrig.model.plan import MountAxis
from calrig.model.run import AT_REST, TERMINAL, UNFINISHED
from calrig.model.service import RigState
from calrig.runs.assignment import NewRun, order_part
from calrig.runs.plan_estimates import planned_poses, require_reachable
from calrig.runs.presence import BoardCheck
from calrig.runs.recorder import Bus, ServiceMetrics
from calrig.runs.rig import check_stage_at
from calrig.runs.services import Service
from calrig.runs.single_flight import SharedTask, SingleFlight
from calrig.runs.stopping import STOPPED
from calrig.settings import RigSettings
from calrig.store import Run, StoredPose, StoreError
from calrig.store.benches import Bench, Kind
from calrig.store.postgresql.listening import Listening
from calrig.store.postgresql.set_up import ANSWERS, EVENTS, PARCELS
from calrig.store.store import Store
from calrig.store.trail import Act, What
from calrig.store.unpacking import Conclude, Conclusion, Kept

ANSWER_S = 3.0
"""How long an answer is waited for."""
ANSWER_POLL_S = 0.5
"""How often it is looked for though nobody said that it has come."""
CUT = {"stop", "abort"}
STANDS = "that the stage stands"
STAYS = "; the stop stays: the bench obeys it before anything else, unless somebody withdraws it"


class Asking:
    """Commands of one process and the answers to them. Thread-safe."""

    def __init__(self, store: Store, clock: Clock = WALL) -> None:
        self._store, self._clock = store, clock
        self._awaited: set[str] = set()
        self._told = clock.condition()

    def heard(self, command: str) -> None:
        """An answer has come, to whoever's command."""
        with self._told:
            self._awaited.discard(command)
            self._told.notify_all()

    def ask(self, bench: Bench, kind: Kind, *, rig: str | None = None, run_uid: str | None = None) -> None:
        """Has a bench do something; returns once it has said that it is done.

        Raises:
            Unknown: the bench knows no such run or rig.
            Conflict: it says why not; or it cannot be told, or does not say what came of it.
        """
        command = self._store.commands.send(bench.name, kind, rig=rig, run_uid=run_uid)
        give_up_s = self._clock.now_s() + ANSWER_S
        awaited = str(command)
        with self._told:
            self._awaited.add(awaited)
        answer = self._store.commands.answer(command)
        while answer is None and (left_s := give_up_s - self._clock.now_s()) > 0:
            with self._told:
                self._told.wait_for(lambda: awaited not in self._awaited, min(ANSWER_POLL_S, left_s))
                self._awaited.add(awaited)  # anybody may notify: it is looked for anew
            answer = self._store.commands.answer(command)
        with self._told:
            self._awaited.discard(awaited)
        if answer is None and kind != "stop" and self._store.commands.withdraw(command):
            raise Conflict(f"bench {bench.name} {seen(bench)} and cannot be told{_advice(kind)}")
        answer = answer or self._store.commands.answer(command)
        if answer is None and kind == "stop":
            raise Conflict(
                f"bench {bench.name} {seen(bench)} and has not said {STANDS}{_advice(kind)}{STAYS}"
            )
        if answer is None:
            what = STANDS if kind in CUT else "what came of it"
            raise Conflict(f"bench {bench.name} has the {kind} and has not said {what}{_advice(kind)}")
        if answer.get("status") != 200:
            said = str(answer.get("detail") or f"bench {bench.name} did not say why")
            raise Unknown(said) if answer.get("status") == 404 else Conflict(said)


def seen(bench: Bench) -> str:
    """When a bench was last seen, in words."""
    if bench.seen_ago_s is None:
        return "has never been seen"
    return f"was last seen {bench.seen_ago_s:.0f} s ago"


def _advice(kind: Kind) -> str:
    return ": go there, or cut its motor power" if kind in CUT else ": ask again once it is there"


log = logging.getLogger(__name__)

LOOK_S = 1.0
"""How often it looks though nobody said that something has come."""
AGAIN_S = 60.0
"""How often a run is tried again that could not be unpacked: what was in the way may have been mended."""


class Unpacker:
    """Unpacks until it is closed.

    Args:
        conclude: makes results and drafts of what was completed.
    """

    def __init__(self, store: Store, conclude: Conclude) -> None:
        self._store, self._conclude = store, conclude
        self._news, self._closing = threading.Event(), False
        self._kept = Kept()
        self._said: dict[str, str] = {}
        self._again_s = time.monotonic() + AGAIN_S
        self._is_up = True
        self._thread = threading.Thread(target=self._run, name="unpacking", daemon=True)

    @property
    def stuck(self) -> Mapping[str, str]:
        """Why runs are not unpacked any further, by run."""
        return self._kept.stuck

    def start(self) -> None:
        """Begins, in its thread."""
        self._thread.start()

    def wake(self, _told: str = "") -> None:
        """Something has come."""
        self._news.set()

    def close(self) -> None:
        """Has it end, and waits until it has."""
        self._closing = True
        self._news.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._closing:
            self._news.clear()
            try:
                while not self._closing and self._some():
                    pass
                self._is_up = True
            except StoreError as error:
                if self._is_up:
                    log.error("nothing is unpacked: %s", error)
                self._is_up = False
            self._news.wait(LOOK_S)

    def _some(self) -> bool:
        """Unpacks some; returns whether there may be more."""
        if time.monotonic() >= self._again_s:
            self._again_s = time.monotonic() + AGAIN_S
            self._kept = Kept()
            self._store.orders.settle_withdrawn()
            self._store.commands.prune()
        self._store.orders.settle_waiting()
        if not self._store.parcels.are_waiting(self._kept):
            return False
        self._kept = self._store.parcels.unpack(self._conclude, self._kept)
        for run_id, why in self._kept.stuck.items():
            if self._said.get(run_id) != why:
                log.error("run %s: a delivery is kept and cannot be unpacked: %s", run_id, why)
        self._said.update(self._kept.stuck)
        return True


def concluded(store: Store, issuer: Issuer, run: Run, stored: Sequence[StoredPose]) -> Conclusion:
    """The result of a completed run and its unit's next revision.

    A bench knows neither which effects are in force nor the units' revisions: its own result serves for what
    it says of the gyro, which is from samples.
    """
    poses, gyro = [one.pose for one in stored if one.excluded is None], gyro_of(run)
    if not poses:
        return None, None
    if run.kind == "verification":
        try:
            applied = active_calibration(store, run.unit, run.rig, run.provenance.get("verifies_revision"))
        except Conflict:  # it was verified by a revision that this store has never had
            return None if run.result is None else run.result.to_dict(), None
        return applied.result(poses, gyro).to_dict(), None
    accepted = store.effects.in_force(run.unit, run.rig)
    result = fitted(poses, accepted, run.provenance, gyro, ending_of(run))
    excluded = [one.index for one in stored if one.excluded is not None]
    return result.to_dict(), issuer.completing(run, Fitted(poses, result, accepted, excluded))


ENDS_S = 2.0
"""How long an abort waits, once the stage stands, for the run's end to be delivered."""


class CentreService(Service):
    """What `calrig.runs.service.RunService` is on one machine. Thread-safe; any number over one database.

    It has no `maps`: a file that a bench names is the bench's, which goes by it where the centre has put none
    in force.

    Args:
        url: of that store, for a connection that hears of news.
        clock: by which answers of benches are waited for.
    """

    def __init__(self, store: Store, url: str, clock: Clock = WALL) -> None:
        self.store = store
        self.bus = Bus()
        self.meter = ServiceMetrics()
        self._rigs = BenchRigs(store)
        self._clock = clock
        self._asking = Asking(store, clock)
        self._errands = SingleFlight()
        self._unpacker = Unpacker(store, lambda run, poses: concluded(store, self.issuer, run, poses))
        self.meter.registry.register(BenchCounts(store, lambda: self.stuck))
        heard: dict[str, Callable[[str], object]] = {
            EVENTS: self.bus.wake,
            PARCELS: self._unpacker.wake,
            ANSWERS: self._asking.heard,
        }
        self._listening = Listening(url, heard, self.bus.wake_all)
        self._unpacker.start()
        self._listening.start()

    @property
    def issuer(self) -> Issuer:
        """Drafts and releases, by what the benches' rigs say of `release` now."""
        return Issuer(self.store, self._rigs.releases())

    @property
    def stuck(self) -> Mapping[str, str]:
        """Runs of which a delivery is kept that this process cannot unpack, and why."""
        return self._unpacker.stuck

    def rigs(self) -> list[RigState]:
        """Every rig of every bench, as it last said that it stands."""
        return self._rigs.states()

    def start_on(self, rig: str | None, wanted: NewRun, *, waits: bool = False) -> Run:
        """Orders a run of the bench that has a rig (the first there is where none is named).

        With `waits` it waits where the rig is busy or its bench away.

        Raises:
            Unknown: no bench has such a rig.
            Conflict: its bench is away.
            Refused: the rig is busy.
        """
        on = self._rigs.known(rig)
        planned = planned_poses(wanted.plan, on.settings)
        wanted = wanted.as_of_now(self.store, on.settings.name, self.maps)
        in_force = wanted.origin.get("stage_map")
        require_reachable(wanted.plan, on.settings, wanted.unit, self.store, in_force)
        if on.is_offline and not waits:
            said = f"rig {on.settings.name!r}: bench {on.bench.name} {seen(on.bench)}"
            raise Conflict(f'{said}: ask with "queue": true to wait until it is there')
        if on.bench.refused is not None and not waits:
            raise Conflict(
                f"rig {on.settings.name!r}: bench {on.bench.name} takes no orders: {on.bench.refused}"
            )
        return self.store.orders.create(
            bench=on.bench.name,
            rig=on.settings.name,
            more=order_part(wanted),
            waits=waits,
            **wanted.columns(len(planned)),
        )

    def abort(self, run_id: str, who: str | None = None) -> Run:
        """Ends a run: takes its order back, or has its bench stop the stage and end it.

        Raises:
            Unknown: there is no such run.
            Conflict: it has ended; or its bench cannot be told, or its stage is not known to stand.
        """
        return self.begin_abort(run_id, who).result()

    def begin_abort(self, run_id: str, who: str | None = None) -> SharedTask[Run]:
        """As `abort`, in a thread of its own, which all share who ask for it meanwhile."""
        return self._errands.share(
            ("abort", run_id),
            self._clock,
            lambda: self._entered("aborted", self._abort_by_bench(run_id), who),
        )

    def _entered(self, what: What, run: Run, who: str | None) -> Run:
        """Enter in the trail what a bench was asked for and did; a store in trouble undoes nothing of it."""
        try:
            self.store.trail.add(Act(what, who=who, unit=run.unit, rig=run.rig, run_id=run.id))
        except StoreError as error:
            log.error("run %s: that it was %s is not in the audit trail: %s", run.id, what, error)
        return run

    def _abort_by_bench(self, run_id: str) -> Run:
        run = self.run(run_id)
        if run.status in TERMINAL:
            raise Conflict(f"run {run_id} is {run.status} and cannot be aborted")
        self.store.orders.withdraw(run_id)
        order = self.store.orders.of(run_id)
        if order is None:
            # no bench of this centre has it: it was moved here from another store
            return self.store.runs.update(run.id, status="aborted")
        if order.taken_epoch == 0:  # no bench had begun it
            self.store.orders.settle_withdrawn(None)
            return self.run(run_id)
        if order.is_revoked:
            return self.store.orders.end_orphan(run_id)
        try:
            self._ask(order.bench, "abort", run_uid=run_id)
        finally:
            self._settle_withdrawn(None)
        return self.wait(run_id, ENDS_S)

    def begin_stop(self, rig_name: str, who: str | None = None) -> SharedTask[RigState]:
        """Has every bench with such a rig stop its stage now, whatever runs; what waits there is aborted.

        In a thread of its own, which all share who ask for it meanwhile.

        Raises:
            Unknown: as the task's result; there is no such rig.
            Conflict: likewise; a bench cannot be told, or a stage is not known to stand.
        """
        return self._errands.share(("stop", rig_name), self._clock, partial(self._stop, rig_name, who))

    def _stop(self, rig_name: str, who: str | None) -> RigState:
        benches = [rig.bench for rig in self._rigs.named(rig_name)]
        try:
            self._stop_on(benches, rig_name)
            stopped = self._unfinished_on(rig_name)
        finally:
            self._settle_withdrawn(STOPPED)
        if stopped:  # the trail waits for other writers, whom the answer to a stop may not wait for
            key = ("entered", *(run.id for run in stopped))
            enter = partial(self._entered, "aborted", who=who)
            self._errands.share(key, self._clock, lambda: list(map(enter, stopped)))
        return self._rigs.states(rig_name)[0]

    def _stop_on(self, benches: Sequence[Bench], rig_name: str) -> None:
        """Has every bench with a rig of that name stop it, side by side; waits for all of them."""
        told = [
            self._errands.share(
                ("stop", rig_name, bench.name),
                self._clock,
                partial(self._asking.ask, bench, "stop", rig=rig_name),
            )
            for bench in benches
        ]
        said: dict[str, str] = {}
        failures = []
        for bench, one in zip(benches, told, strict=True):
            try:
                one.result()
                said[bench.name] = "the stage stands"
            except (RunsError, StoreError) as error:
                said[bench.name] = str(error)
                failures.append(error)
        if len(benches) == 1 and failures:
            raise failures[0]
        if failures:
            raise Conflict("; ".join(f"bench {name}: {what}" for name, what in said.items()))

    def _unfinished_on(self, rig_name: str) -> list[Run]:
        """Runs that a stop of the rig has aborted; their ends are on their way."""
        try:
            return self.store.runs.unfinished(rig_name)
        except StoreError as error:  # of a stop that was made, the store's trouble makes no failure
            log.error("rig %s: runs that its stop aborted are not in the audit trail: %s", rig_name, error)
            return []

    def _settle_withdrawn(self, reason: str | None) -> None:
        try:
            self.store.orders.settle_withdrawn(reason)
        except StoreError as error:  # of a stop that was made, the store's trouble makes no failure
            log.error("runs that waited are not told of as aborted yet: %s", error)

    def begin_clamp(self, rig_name: str, mount_deg: float, axis: MountAxis) -> SharedTask[RigState]:  # noqa: ARG002
        """Turns nothing: whoever does that stands at the bench, and has its page there."""
        bench = self._rigs.known(rig_name).bench
        raise Conflict(
            f"rig {rig_name!r} is on bench {bench.name}: turn its unit there, by hand or at its page"
        )

    def look(self, rig_name: str) -> None:
        """Has a rig's bench look at its board for a while; waits for no answer. Or Unknown."""
        rig = self._rigs.known(rig_name)
        if not rig.is_offline:
            self.store.commands.send(rig.bench.name, "look", rig=rig_name)

    def looks(self) -> dict[str, BoardCheck]:
        """What the last looks at boards gave, by rig, as their benches last said; of those looked at."""
        return self._rigs.looks()

    def pause(self, run_id: str, who: str | None = None) -> Run:
        """Has the run hold after the pose in hand."""
        return self._entered("paused", self._ask_of_run(run_id, "pause", "paused"), who)

    def resume(self, run_id: str, stage_at_deg: float | None = None, who: str | None = None) -> Run:
        """Has a paused run go on, or one that its bench holds back; has an interrupted one taken up again.

        `stage_at_deg` as of `RunService.resume`.

        Raises:
            Unknown: there is no such run.
            Invalid: its stage has homing, and an elevation was given.
            Conflict: it is neither paused, held back nor interrupted, or its bench is away.
            Refused: its rig is busy.
        """
        run = self.run(run_id)
        check_stage_at(run, stage_at_deg)
        if run.status == "queued" and self.store.orders.go(run_id):
            return self._entered("resumed", self.run(run_id), who)
        if run.status != "interrupted":
            return self._entered("resumed", self._ask_of_run(run_id, "resume", "resumed"), who)
        order = self.store.orders.of(run_id)
        if order is not None and self._rigs.known(order.rig).is_offline:
            bench = self._bench(order.bench)
            raise Conflict(f"run {run_id} cannot be resumed: bench {bench.name} {seen(bench)}")
        return self._entered("resumed", self.store.orders.resume(run_id, stage_at_deg), who)

    def _ask_of_run(self, run_id: str, kind: Kind, wish: str) -> Run:
        run, order = self.run(run_id), self.store.orders.of(run_id)
        if run.status not in UNFINISHED or order is None or order.taken_epoch < order.epoch:
            raise Conflict(f"run {run_id} is {run.status} and cannot be {wish}")
        self._ask(order.bench, kind, run_uid=run_id)
        return self.run(run_id)

    def _ask(self, bench: str, kind: Kind, run_uid: str) -> None:
        self._asking.ask(self._bench(bench), kind, run_uid=run_uid)

    def _bench(self, name: str) -> Bench:
        for bench in self.store.benches.all():
            if bench.name == name:
                return bench
        raise Unknown(f"there is no bench {name!r} any more")

    def wait(self, run_id: str, timeout_s: float | None = None) -> Run:
        """The run once it has ended, or as it is after timeout_s."""
        changed = self._clock.condition()
        news: list[bool] = []

        def wake() -> None:
            with changed:
                news.append(True)
                changed.notify_all()

        give_up_s = None if timeout_s is None else self._clock.now_s() + timeout_s
        leave = self.bus.subscribe(run_id, wake)
        try:
            while True:
                news.clear()
                run = self.run(run_id)
                left_s = LOOK_S if give_up_s is None else give_up_s - self._clock.now_s()
                if run.status in AT_REST or left_s <= 0:
                    return run
                with changed:
                    changed.wait_for(lambda: news, min(LOOK_S, left_s))
        finally:
            leave()

    def close(self) -> None:
        """Ends what this process does for the centre; benches go on."""
        self._listening.close()
        self._unpacker.close()

    def ports(self) -> list[str]:
        """None: the ports of its rigs are its benches'."""
        return []

    def known_rig(self, name: str | None) -> RigSettings:
        """A rig's settings as its bench tells them, those of the first one without a name."""
        return self._rigs.known(name).settings
