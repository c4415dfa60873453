"""The agent of a bench: heartbeat with the status of its rigs, commands of the centre, delivery of runs.

Each link has its own threads. They wait for the network, and hold no lock that a run could need.

Commands: one statement claims a command, and finds none that was withdrawn or is older than `STALE_S` by the
server's clock. By then the centre has reported that the bench cannot be reached. A stop never grows old: its
rig takes no order until it is answered or withdrawn.

Deliveries: if a receipt is lost, the parcel is delivered again. The centre identifies events by run and
number, poses by run and index, sample blocks by run and number.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import psycopg
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

import calrig
from calrig.agent.link import NOW, Centre, Lease, Link, LinkDown, json_of
from calrig.agent.orders import RigOrders
from calrig.analysis.errors import RunsError, Unknown
from calrig.model.clock_skew import is_refused, skew_in_words
from calrig.runs.presence import BoardCheck
from calrig.runs.rig_status import said_of
from calrig.runs.service import RunService
from calrig.store import Store, StoreError
from calrig.store.benches import versions_here
from calrig.store.convert import iso_utc
from calrig.store.errors import StoreDamagedError
from calrig.store.parcels import Parcel
from calrig.store.postgresql.set_up import COMMANDS, ORDERS

log = logging.getLogger(__name__)

STALE_S = 5
COMMANDS_LOOK_S = 0.5
"""How often the centre is asked though no notification came."""
ANSWER_AGAIN_S = 0.25
LONGEST_ANSWER_S = 60.0
"""An answer that cannot be sent for so long interests nobody any more, unless it is that of a stop."""
_OLDEST = NOW.replace("clock_timestamp()", f"(clock_timestamp() - interval '{STALE_S} s')")
_CLAIM = f"""
WITH claimed AS (
    UPDATE bench_command SET taken_at = {NOW}
    WHERE bench = %s AND taken_at IS NULL AND withdrawn_at IS NULL
      AND (kind = 'stop' OR asked_at >= {_OLDEST})
    RETURNING id, kind, rig, run_uid
)
SELECT id, kind, rig, run_uid FROM claimed ORDER BY kind <> 'stop', kind <> 'abort', id
"""  # noqa: S608 (no text of anybody's)
_CLAIM_AGAIN = """
UPDATE bench_command SET taken_at = NULL
WHERE bench = %s AND kind = 'stop' AND taken_at IS NOT NULL AND answered_at IS NULL AND withdrawn_at IS NULL
  AND id <> ALL(%s)
"""
"""Stops that an agent took which died, or lost its connection, before it had them in hand."""
_ANSWER = f"UPDATE bench_command SET answered_at = {NOW}, answer = %s WHERE id = %s AND bench = %s"  # noqa: S608


@dataclass(frozen=True, slots=True)
class Command:
    """What is asked: of a rig, or of a run."""

    id: int
    kind: str
    rig: str | None
    run_uid: str | None


class Commands:
    """In a thread of its own, until `closing` is set; each command is carried out in another.

    Args:
        heard: a link that does nothing but wait for commands, and for news of orders.
        answers: a link for nothing but answers.
        look: is called where there may be an order.
    """

    def __init__(
        self,
        heard: Link,
        answers: Link,
        service: RunService,
        closing: threading.Event,
        look: Callable[[], None],
    ) -> None:
        self._heard, self._answers = heard, answers
        self._service, self._closing, self._look = service, closing, look
        self._in_hand: set[int] = set()

    def run(self) -> None:
        """Listens until the agent is closed."""
        while not self._closing.is_set():
            try:
                with self._heard.centre() as centre:
                    self._listen(centre)
            except LinkDown:
                self._closing.wait(COMMANDS_LOOK_S)

    def _listen(self, centre: Centre) -> None:
        centre.connection.execute(f"LISTEN {COMMANDS}; LISTEN {ORDERS}")
        centre.connection.execute(_CLAIM_AGAIN, (centre.bench, list(self._in_hand)))
        self._look()  # what was told before was not heard
        while not self._closing.is_set():
            for row in centre.connection.execute(_CLAIM, (centre.bench,)).fetchall():
                self._carry_out(Command(*row))
            for told in centre.connection.notifies(timeout=COMMANDS_LOOK_S, stop_after=1):
                if told.channel == ORDERS and told.payload == centre.bench:
                    self._look()

    def _carry_out(self, command: Command) -> None:
        level = logging.DEBUG if command.kind == "look" else logging.INFO
        log.log(level, "command %d: %s of %s", command.id, command.kind, command.rig or command.run_uid)
        self._in_hand.add(command.id)
        work = threading.Thread(target=self._work, args=(command,), name=f"command {command.id}", daemon=True)
        work.start()

    def _work(self, command: Command) -> None:
        try:
            self._answer(command)
        finally:
            self._in_hand.discard(command.id)

    def _answer(self, command: Command) -> None:
        answer = json_of(self.answer_to(command))
        give_up_s = time.monotonic() + LONGEST_ANSWER_S
        while command.kind == "stop" or time.monotonic() < give_up_s:
            try:
                with self._answers.centre() as centre:
                    centre.connection.execute(_ANSWER, (answer, command.id, centre.bench))
                return
            except LinkDown:
                if self._closing.wait(ANSWER_AGAIN_S):
                    return

    def answer_to(self, command: Command) -> dict[str, Any]:
        """Does what is asked; says what came of it, in HTTP's terms."""
        try:
            return {"status": 200, "detail": self._do(command)}
        except Unknown as error:
            return {"status": 404, "detail": str(error)}
        except (RunsError, StoreError) as error:
            return {"status": 409, "detail": str(error)}
        except Exception as error:
            log.exception("command %d failed inside calrig", command.id)
            return {"status": 409, "detail": f"the bench failed inside ({error!r}); its log says where"}

    def _do(self, command: Command) -> str:
        service, run_id = self._service, command.run_uid or ""
        match command.kind:
            case "stop":
                state = service.begin_stop(command.rig or "").result()
                return f"the stage of rig {state.name} stands"
            case "abort":
                return service.abort(run_id).status
            case "pause":
                return service.pause(run_id).status
            case "resume":
                return service.resume(run_id).status
            case "look":
                service.look(command.rig or "")
                return "what is seen comes with the heartbeat"
        raise Unknown(f"this bench knows no command {command.kind!r}")


OUTBOX_LOOK_S = 1.0
"""How often the spool is looked into though nobody says that it has grown, or though the centre is away."""
PACE_S = 0.4
"""Between two deliveries: what a run tells meanwhile goes together, which costs the centre a third."""
FEW = 20
TOGETHER_BYTES = 1_000_000
_NEWEST = "SELECT coalesce(max(seq), 0) FROM parcel WHERE bench = %s"
_INSERT = f"""
INSERT INTO parcel (bench, seq, run_uid, document, data, delivered_at) VALUES (%s, %s, %s, %s, %s, {NOW})
"""  # noqa: S608 (no text of anybody's)


class Outbox:
    """In a thread of its own, until `closing` is set, and once more after that.

    Args:
        link: to the centre, which nobody else waits for.
        store: the spool.
    """

    def __init__(self, link: Link, store: Store, closing: threading.Event) -> None:
        self._link, self._store, self._closing = link, store, closing
        self._grown = threading.Event()
        self._unreadable: set[str] = set()

    def wake(self) -> None:
        """The spool has grown, or nobody is to wait any more."""
        self._grown.set()

    def run(self) -> None:
        """Delivers until the agent is closed, then what was said last."""
        is_last = False
        while not is_last:
            self._grown.wait(OUTBOX_LOOK_S)
            self._grown.clear()
            is_last = self._closing.is_set()
            try:
                while (n := self.deliver_some()) and not is_last:
                    if n < FEW:  # what waited for days goes out without waiting any more
                        self._closing.wait(PACE_S)
            except LinkDown:
                self._closing.wait(OUTBOX_LOOK_S)  # the heartbeat tells of it
            except StoreError as error:
                log.error("the spool cannot be delivered from: %s", error)
                self._closing.wait(OUTBOX_LOOK_S)

    def deliver_some(self) -> int:
        """Delivers the next pieces of every run that has any; returns how many there were.

        A run of today goes on being told while days of others are delivered beside it.

        Raises:
            LinkDown: the centre is away, or may not have got them.
        """
        n = 0
        for parcels in self._loads():
            with self._link.centre() as centre, centre.connection.transaction():
                (newest,) = centre.connection.execute(_NEWEST, (centre.bench,)).fetchone() or (0,)
                rows = [
                    (centre.bench, seq, one.run_id, json_of(one.document), one.data)
                    for seq, one in enumerate(parcels, start=newest + 1)
                ]
                centre.connection.cursor().executemany(_INSERT, rows)
            self._store.spool.mark_delivered(parcels)
            n += len(parcels)
        return n

    def _loads(self) -> Iterator[Sequence[Parcel]]:
        """The next pieces of all runs, as many together as are sent in one transaction."""
        load: list[Parcel] = []
        n_bytes = 0
        for run_id in self._store.spool.undelivered():
            parcels = self._next_of(run_id)
            load += parcels
            n_bytes += sum(len(one.data or b"") for one in parcels)
            if n_bytes >= TOGETHER_BYTES:
                yield load
                load, n_bytes = [], 0
        if load:
            yield load

    def _next_of(self, run_id: str) -> Sequence[Parcel]:
        """A run that cannot be read any more keeps no other one from being delivered."""
        try:
            return self._store.spool.next_parcels(run_id)
        except StoreDamagedError as error:
            if run_id not in self._unreadable:
                log.error("run %s cannot be delivered: %s", run_id, error)
            self._unreadable.add(run_id)
            return ()


LONGEST_TRIP_S = 2.0
"""A round trip that takes longer says too little of the moment in it at which the server read its clock."""


def utc_now() -> datetime:
    """The time by this machine's clock."""
    return datetime.now(UTC)


class ClockSkew:
    """How far this machine's clock is ahead of the server's, as it was measured last.

    Attributes:
        skew_s: None before it was measured.
    """

    def __init__(self) -> None:
        self.skew_s: float | None = None

    @property
    def is_refused(self) -> bool:
        """Whether the bench may act on no orders because of it."""
        return is_refused(self.skew_s)

    def measure(self, connection: psycopg.Connection[Any]) -> None:
        """Ask the server for its time, and compare it with the middle of the question."""
        before = utc_now()
        ((there,),) = connection.execute("SELECT clock_timestamp()").fetchall()
        took = utc_now() - before
        if took.total_seconds() > LONGEST_TRIP_S:
            return
        was_refused = self.is_refused
        self.skew_s = (before + took / 2 - there).total_seconds()
        if self.is_refused is not was_refused:
            said = skew_in_words(self.skew_s) or "its clock agrees with the centre's again"
            log.warning("this bench: %s", said)


BEAT_S = 2.0
SEES_S = 0.2
"""How soon what is seen of a unit is told."""
_BEAT = f"""
UPDATE bench SET last_seen_at = {NOW}, said = %s WHERE name = %s
RETURNING to_jsonb(bench) ? 'refused', to_jsonb(bench) ->> 'refused'
"""  # noqa: S608 (no text of anybody's)
AWAY = "away"
TOO_OLD = "the centre is older than this agent: upgrade all processes of the centre, then the agents"
_HOLD = """
UPDATE run_order SET held_epoch = epoch
WHERE bench = %s AND epoch > taken_epoch AND wish IN ('begin', 'resume')
"""
"""What was ordered while the bench was away, or went away, waits until somebody orders it anew."""


class Heartbeat:
    """In a thread of its own, until `closing` is set.

    Args:
        lease: is renewed by each beat that was answered.
        renewed: is called once a lost lease is held again.
        trouble: why the bench takes no orders, None where it does.
    """

    def __init__(
        self,
        link: Link,
        lease: Lease,
        service: RunService,
        closing: threading.Event,
        renewed: Callable[[], None],
        trouble: Callable[[], str | None],
    ) -> None:
        self._link, self._lease, self._service = link, lease, service
        self._closing, self._renewed, self._trouble = closing, renewed, trouble
        self._clock = ClockSkew()
        self._state: str | None = ""

    def run(self) -> None:
        """Beats until the agent is closed."""
        while not self._closing.is_set():
            told = self._service.looks()
            try:
                self.beat()
            except (LinkDown, StoreError) as error:
                self._tell(state=AWAY, said=f"the centre cannot be reached: {error}")
            self._lease.is_held()  # a loss is counted when it happens, and not when somebody asks
            self._rest(told)

    def beat(self) -> None:
        """Says how the bench stands; the centre says whether it takes orders.

        Raises:
            LinkDown: nobody answered.
        """
        said = self.said()
        asked_at_s, is_anew = self._lease.now_s(), not self._lease.is_held()
        with self._link.centre() as centre, centre.connection.transaction():
            self._clock.measure(centre.connection)
            said["clock_skew_s"] = self._clock.skew_s
            beat = centre.connection.execute(_BEAT, (json_of(said), centre.bench)).fetchone()
            judges, refused = beat or (True, None)
            refused = refused if judges else TOO_OLD
            if refused is None and self._clock.is_refused:
                refused = skew_in_words(self._clock.skew_s)
            if is_anew and refused is None:  # in one: whoever sees the bench back may order what is taken
                centre.connection.execute(_HOLD, (centre.bench,))
        if refused is not None:
            self._tell(state=refused, said=f"bench {centre.bench} takes no orders: {refused}")
            return
        self._tell(state=None, said=f"bench {centre.bench} is in touch with its centre")
        if self._lease.renew(asked_at_s, is_anew=is_anew):
            self._renewed()

    def said(self) -> dict[str, Any]:
        """What the bench says of itself."""
        service, outbox = self._service, self._service.store.spool.outbox()
        looks = service.looks()
        return {
            "rigs": [
                said_of(state, service.known_rig(state.name), looks.get(state.name))
                for state in service.rigs()
            ],
            "outbox": {
                "parcels": outbox.n_parcels,
                "oldest_at": None if outbox.oldest_at is None else iso_utc(outbox.oldest_at),
            },
            "lease_losses": self._lease.losses,
            "version": calrig.__version__,
            **versions_here(),
            "trouble": self._trouble(),
        }

    def _rest(self, told: Mapping[str, BoardCheck]) -> None:
        """Until the next beat is due: sooner where something else is seen, for somebody stands there."""
        due_s = time.monotonic() + BEAT_S
        while time.monotonic() < due_s and self._service.looks() == told:
            if self._closing.wait(SEES_S):
                return

    def _tell(self, *, state: str | None, said: str) -> None:
        """Logs what has changed, and not what stays as it is; the state is None where all is well."""
        if state != self._state:
            log.log(logging.INFO if state is None else logging.WARNING, "%s", said)
        self._state = state


class LinkCounts(Collector):
    """Looked up as it is asked for; of a spool that cannot be read, nothing."""

    def __init__(self, lease: Lease, store: Store) -> None:
        self._lease, self._store = lease, store

    def collect(self) -> Iterator[Metric]:
        """Every family."""
        held = float(self._lease.is_held())
        yield GaugeMetricFamily("calrig_lease_held", "1 while orders of the centre are acted on.", held)
        yield CounterMetricFamily(
            "calrig_lease_losses", "How often the centre did not answer in time.", self._lease.losses
        )
        try:
            outbox = self._store.spool.outbox()
        except StoreError:
            return
        oldest_at = outbox.oldest_at
        age_s = 0.0 if oldest_at is None else (datetime.now(UTC) - oldest_at).total_seconds()
        yield GaugeMetricFamily(
            "calrig_outbox_parcels", "Pieces of runs not delivered yet.", outbox.n_parcels
        )
        yield GaugeMetricFamily(
            "calrig_outbox_age_seconds", "Age of the oldest event not delivered yet.", max(0.0, age_s)
        )


AFTER_A_DEFECT_S = 5.0
GOODBYE_S = 2.0
"""How long what a bench has to say last may take, and the ends of its threads."""


class Agent:
    """The threads between a bench and its centre.

    Args:
        service: carries runs out, over the bench's spool, and drafts nothing.
        url: of the centre's database, as libpq takes it.
        now_s: seconds that never go back, by which the lease is counted.
    """

    def __init__(self, service: RunService, url: str, now_s: Callable[[], float] = time.monotonic) -> None:
        self.service = service
        self.lease = Lease(now_s)
        self._closing, self._all_is_said = threading.Event(), threading.Event()
        short, heard, answers, parcels = (Link(url) for _ in range(4))
        self._links = short, heard, answers, parcels
        rigs = [service.known_rig(state.name) for state in service.rigs()]
        self._orders = [RigOrders(rig, short, self.lease, service, self._closing) for rig in rigs]
        self._heartbeat = Heartbeat(short, self.lease, service, self._closing, self.look, self._trouble)
        self._outbox = Outbox(parcels, service.store, self._all_is_said)
        commands = Commands(heard, answers, service, self._closing, self.look)
        work = {
            "heartbeat": self._heartbeat.run,
            "outbox": self._outbox.run,
            "commands": commands.run,
            **{one.name: one.run for one in self._orders},
        }
        self._threads = [
            threading.Thread(target=self._keep_going, args=(name, run), name=name, daemon=True)
            for name, run in work.items()
        ]
        service.bus.hear(lambda _run_id: self._outbox.wake())
        service.meter.registry.register(LinkCounts(self.lease, service.store))

    def start(self) -> None:
        """Begins all of it."""
        for thread in self._threads:
            thread.start()

    def look(self) -> None:
        """There may be orders."""
        for orders in self._orders:
            orders.wake()

    def _trouble(self) -> str | None:
        return next((one.trouble for one in self._orders if one.trouble is not None), None)

    def close(self) -> None:
        """Ends runs and threads; what is left to be said is said where the centre is there to hear it."""
        self._closing.set()
        self.service.close()
        self._all_is_said.set()
        self._outbox.wake()
        for thread in self._threads:
            thread.join(GOODBYE_S)
        for link in self._links:
            link.close()

    def _keep_going(self, name: str, run: Callable[[], None]) -> None:
        """A defect in one thread is told, and ends no other one; nor that one for good."""
        while True:
            try:
                run()
                return
            except Exception:
                log.exception("%s failed inside calrig, and begins anew", name)
                if self._closing.wait(AFTER_A_DEFECT_S):
                    return
