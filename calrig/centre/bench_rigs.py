"""Rigs of a centre as their benches last reported them, metrics of the benches, and the overview of all rigs.

A report of a bench is accepted as far as it has the right form; other values count as unknown.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, TypeVar

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from pydantic import AwareDatetime, BaseModel, Field, TypeAdapter, ValidationError

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.revisions import Releases
from calrig.model.clock_skew import said_skew_s, skew_in_words
from calrig.model.service import RigState, RigWork
from calrig.runs.presence import BoardCheck
from calrig.runs.rig_status import look_of, settings_of
from calrig.settings import RigSettings
from calrig.store import Store, StoreError
from calrig.store.benches import Backlog, Bench, Waiting
from calrig.store.records import Document
from calrig.store.rigs import BriefRun, Standing

log = logging.getLogger(__name__)

OFFLINE_S = 10.0
"""A bench says every two seconds that it is there."""


@dataclass(frozen=True, slots=True)
class BenchRig:
    """A rig, the bench that has it, and what that says of it."""

    bench: Bench
    settings: RigSettings
    said: dict[str, Any]

    @property
    def key(self) -> tuple[str, str]:
        """Names of bench and rig."""
        return self.bench.name, self.settings.name

    @property
    def is_offline(self) -> bool:
        """Whether its bench has not been seen lately."""
        return self.bench.seen_ago_s is None or self.bench.seen_ago_s > OFFLINE_S

    @property
    def seen(self) -> BoardCheck | None:
        """What the last look at its board gave; None where nobody looks, or that is not known."""
        try:
            return None if self.is_offline else look_of(self.said)
        except ValidationError:
            return None

    def state(self, run_id: str | None, stop_asked_at: datetime | None) -> RigState:
        """As `GET /api/rigs` shows it; `run_id` is the unfinished run that the centre knows on it."""
        said_run = self.said.get("run_id") if self.said.get("state") == "busy" else None
        on_it = run_id or (said_run if isinstance(said_run, str) else None)
        return RigState(
            name=self.settings.name,
            stage=str(self.said.get("stage") or ""),
            imu=str(self.said.get("imu") or ""),
            simulated=bool(self.said.get("simulated")),
            state=self._state(is_busy=on_it is not None),
            run_id=on_it,
            bench=self.bench.name,
            hall=self.bench.hall,
            last_seen_at=self.bench.last_seen_at,
            stop_asked_at=stop_asked_at,
        )

    def _state(self, *, is_busy: bool) -> RigWork:
        if self.is_offline:
            return "offline"
        if is_busy:
            return "busy"
        return "unreachable" if self.said.get("state") == "unreachable" else "idle"


class BenchRigs:
    """Looked up anew each time: benches come and go, and other processes hear of it no later."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._unreadable: set[str] = set()

    def all(self, name: str | None = None) -> list[BenchRig]:
        """Every rig (of this name), by its bench's name and then as that has it configured."""
        return [rig for bench in self._store.benches.all() for rig in self._of(bench, name)]

    def states(self, name: str | None = None) -> list[RigState]:
        """How each (of this name) stands."""
        busy, stops = self._store.orders.busy_rigs(), self._store.commands.unobeyed()
        return [rig.state(busy.get(rig.key), stops.get(rig.key)) for rig in self.all(name)]

    def looks(self) -> dict[str, BoardCheck]:
        """What was seen of the units on rigs that are looked at, by name; of benches that take orders."""
        rigs = [rig for rig in self.all() if rig.bench.refused is None]
        return {rig.settings.name: seen for rig in rigs if (seen := rig.seen) is not None}

    def known(self, name: str | None) -> BenchRig:
        """The rig of a name; without one the first there is. Of a bench that takes orders, where one does.

        Raises:
            Unknown: no bench has such a rig.
            Conflict: several have that take orders, or none of several does.
        """
        named = self.named(name)
        found = [rig for rig in named if rig.bench.refused is None] or named
        if name is not None and len(found) > 1:
            benches = ", ".join(rig.bench.name for rig in found)
            raise Conflict(f"benches {benches} each have a rig {name!r}: give their rigs names of their own")
        return found[0]

    def named(self, name: str | None) -> list[BenchRig]:
        """The rigs of a name, one unless benches were set up wrongly; all without.

        Raises:
            Unknown: no bench has such a rig.
        """
        found = self.all(name)
        if not found:
            names = sorted({rig.settings.name for rig in self.all()})
            known = ", ".join(names) or "none, for no bench has joined"
            raise Unknown(f"no bench has a rig {name!r}; there are: {known}")
        return found

    def releases(self) -> Releases:
        """Who puts drafts in force, as the benches' configurations say."""
        return Releases.of([rig.settings for rig in self.all()])

    def _of(self, bench: Bench, name: str | None) -> list[BenchRig]:
        said = bench.said.get("rigs", [])
        try:
            return [BenchRig(bench, settings_of(one), one) for one in said if name in (None, one["name"])]
        except (ValidationError, TypeError, KeyError, AttributeError) as error:
            if bench.name not in self._unreadable:
                log.error("what bench %s says of its rigs cannot be read: %s", bench.name, error)
            self._unreadable.add(bench.name)
            return []


Count = Annotated[int, Field(ge=0, le=2**53)]
T = TypeVar("T")
Labels = TypeVar("Labels", bound=tuple[str, ...])


class SaidOutbox(BaseModel):
    """What it has not delivered yet, and since when the oldest of it waits."""

    parcels: Count
    oldest_at: AwareDatetime | None


_OUTBOX, _COUNT = TypeAdapter(SaidOutbox), TypeAdapter[int](Count)


def said_outbox(bench: Bench) -> SaidOutbox | None:
    """What a bench has yet to deliver; None where it does not say."""
    return _read(_OUTBOX, bench.said.get("outbox"))


def _read(form: TypeAdapter[T], said: Any) -> T | None:
    try:
        return form.validate_python(said)
    except ValidationError:
        return None


NOTHING = Waiting(0, 0.0)


class BenchCounts(Collector):
    """Looked up as it is asked for; of a store that cannot be read, nothing.

    Args:
        stuck: the runs of which this process cannot unpack a delivery.
    """

    def __init__(self, store: Store, stuck: Callable[[], Mapping[str, str]]) -> None:
        self._store, self._rigs, self._stuck = store, BenchRigs(store), stuck

    def collect(self) -> Iterator[Metric]:
        """Every family."""
        try:
            benches, rigs, backlog = (
                self._store.benches.all(),
                self._rigs.all(),
                self._store.benches.backlog(),
            )
        except StoreError:
            return
        yield from _orders([rig.key for rig in rigs], backlog)
        yield from _deliveries([bench.name for bench in benches], backlog)
        yield GaugeMetricFamily(
            "calrig_runs_stuck", "Runs with a delivery that cannot be unpacked.", len(self._stuck())
        )
        yield from _as_benches_say(benches)


def _gauge(name: str, says: str, values: Mapping[Labels, float], *more: str) -> Metric:
    """A family by bench and, where it has more labels, by these."""
    family = GaugeMetricFamily(name, says, labels=["bench", *more])
    for labels, value in values.items():
        family.add_metric(labels, value)
    return family


def _orders(rigs: list[tuple[str, str]], backlog: Backlog) -> Iterator[Metric]:
    """By rig, those without any as well: a rate or an alarm needs the zero."""
    waiting = {key: backlog.orders.get(key, NOTHING) for key in [*rigs, *backlog.orders]}
    number = {key: one.number for key, one in waiting.items()}
    age = {key: one.age_s for key, one in waiting.items()}
    yield _gauge("calrig_orders_waiting", "Runs that no bench has taken yet.", number, "rig")
    yield _gauge("calrig_orders_age_seconds", "Age of the oldest of them.", age, "rig")


def _deliveries(benches: list[str], backlog: Backlog) -> Iterator[Metric]:
    names = dict.fromkeys([*benches, *backlog.parcels, *backlog.unanswered])
    waiting = {(name,): backlog.parcels.get(name, NOTHING) for name in names}
    number = {key: one.number for key, one in waiting.items()}
    age = {key: one.age_s for key, one in waiting.items()}
    unanswered = {(name,): backlog.unanswered.get(name, 0) for name in names}
    yield _gauge("calrig_parcels_waiting", "Parcels delivered and not unpacked.", number)
    yield _gauge("calrig_parcels_age_seconds", "Age of the oldest of them.", age)
    says = "Commands of the last hour that a bench did not answer in time."
    yield _gauge("calrig_commands_unanswered", says, unanswered)


def _as_benches_say(benches: list[Bench]) -> Iterator[Metric]:
    """What each last said of itself; of a bench that never spoke there is nothing to tell."""
    now = datetime.now(UTC)
    silence = {(one.name,): max(0.0, one.seen_ago_s) for one in benches if one.seen_ago_s is not None}
    outboxes = {(one.name,): said for one in benches if (said := said_outbox(one)) is not None}
    age = {key: max(0.0, (now - (said.oldest_at or now)).total_seconds()) for key, said in outboxes.items()}
    parcels = {key: said.parcels for key, said in outboxes.items()}
    yield _gauge("calrig_bench_silence_seconds", "Age of a bench's last word.", silence)
    yield _gauge("calrig_bench_outbox_parcels", "Pieces of runs a bench had yet to deliver.", parcels)
    yield _gauge("calrig_bench_outbox_age_seconds", "Age of the oldest event of these.", age)
    losses = CounterMetricFamily(
        "calrig_bench_lease_losses",
        "How often a bench lost its lease since its agent began.",
        labels=["bench"],
    )
    for bench in benches:
        if (lost := _read(_COUNT, bench.said.get("lease_losses"))) is not None:
            losses.add_metric([bench.name], lost)
    yield losses


NOT_RESOLVED = {"failed", "interrupted"}
_STEPS_S = ((60.0, 10.0), (3600.0, 60.0))
"""Ages below the first are told in steps of the second, those above in hours: an answer stays the same, byte
for byte, while there is nothing new."""


def overview(store: Store, rigs: Sequence[RigState]) -> list[Document]:
    """Benches by name, each with its rigs as configured; this machine's own rigs on one without a name."""
    now = datetime.now(UTC)
    standings = store.rigs.summaries([rig.name for rig in rigs])

    def on(bench: str | None) -> list[Document]:
        return [_rig(rig, standings[rig.name], now) for rig in rigs if rig.bench == bench]

    here = on(None)
    benches = [{**_bench(bench), "rigs": on(bench.name)} for bench in store.benches.all()]
    return [*([{**_HERE, "rigs": here}] if here else []), *benches]


_HERE: Document = {
    "name": None,
    "hall": None,
    "state": "in_touch",
    "silent_since": None,
    "silent_for_s": None,
    "undelivered": None,
    "refused": None,
    "clock": None,
}


def _bench(bench: Bench) -> Document:
    ago_s = bench.seen_ago_s
    is_silent = ago_s is not None and ago_s > OFFLINE_S
    outbox = said_outbox(bench)
    return {
        "name": bench.name,
        "hall": bench.hall,
        "state": "never_seen" if ago_s is None else "silent" if is_silent else "in_touch",
        "silent_since": bench.last_seen_at if is_silent else None,
        "silent_for_s": _coarse(ago_s) if ago_s is not None and is_silent else None,
        "undelivered": outbox.model_dump() if outbox is not None and outbox.parcels else None,
        "refused": bench.refused,
        "clock": skew_in_words(said_skew_s(bench.said.get("clock_skew_s"))),
    }


def _coarse(seconds: float) -> float:
    step_s = next((step for below, step in _STEPS_S if seconds < below), 3600.0)
    return seconds // step_s * step_s


def _rig(rig: RigState, standing: Standing, now: datetime) -> Document:
    begun = [run for run in standing.unfinished if run.id == rig.run_id]
    check, last = standing.check, standing.last
    has_failed = last is not None and last.status in NOT_RESOLVED and not last.is_voided
    return {
        **rig.model_dump(exclude={"bench", "hall", "last_seen_at", "clamp"}),
        "run": _run(begun[0]) if begun else None,
        "queued": [_run(run) for run in standing.unfinished if run.id != rig.run_id],
        "unresolved": _run(last) if has_failed and last is not None else None,
        "check": None if check is None else {**asdict(check), "overdue": check.due_at < now},
    }


def _run(run: BriefRun) -> Document:
    told: Document = asdict(run)
    del told["is_voided"]
    return {**told, "waiting_for": run.progress.get("waiting_for")}
