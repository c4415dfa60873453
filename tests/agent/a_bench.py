"""A bench with rigs in virtual time and its agent, and a centre's database with orders written by hand."""

from __future__ import annotations

import io
import socket
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
from empty_store import lay_empty_store
from psycopg.types.json import Json
from sqlalchemy import make_url
from support import QUICK, fast, known_as, wait_for
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.agent.agent import Agent
from calrig.agent.link import NOW
from calrig.analysis.revisions import NoDrafts
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.store import Store
from calrig.store.postgresql.set_up import ORDERS

BENCH = "hall-2"
STANDS_DPS = 1e-6
ENDLESS = {**QUICK, "sweeps": 300}


class Rig:
    """A simulated rig whose table the tests look at, and the settings that a service knows it by."""

    def __init__(self, name: str, clock: VirtualClock, **options: Any) -> None:
        self.simulated = virtual_rig(fast(options), clock)
        self.settings = known_as(name, self.simulated).model_copy(update={"simulated": {}})

    def has_moved(self) -> bool:
        """Whether the table has turned since it was switched on."""
        with self.simulated.bench.lock:
            rates_dps = self.simulated.bench.mechanics.table(
                np.arange(0.0, self.now_s() + 0.01, 0.01)
            ).rate_dps
        return bool(np.abs(rates_dps).max() > STANDS_DPS)

    def stands(self) -> bool:
        """Whether nothing that was commanded will move the table."""
        later_s = self.now_s() + np.arange(0.0, 200.0, 0.05)
        with self.simulated.bench.lock:
            return bool(np.abs(self.simulated.bench.mechanics.table(later_s).rate_dps).max() <= STANDS_DPS)

    def now_s(self) -> float:
        """Simulated time."""
        return self.simulated.clock()


@contextmanager
def agent_at(
    url: str, spool: Path, *rigs: Rig, now_s: Callable[[], float] | None = None, is_accepted: bool = True
) -> Iterator[Agent]:
    """An agent at work, as `calrig agent` makes it, once it takes orders of its centre, if it is to."""
    lay_empty_store(spool)
    with (
        Store.open(f"sqlite:///{spool}", writer="tests") as store,
        closing(RunService(store, [rig.settings for rig in rigs], issuer=NoDrafts(store))) as service,
        closing(Agent(service, libpq(url), *(() if now_s is None else (now_s,)))) as agent,
    ):
        agent.start()
        if is_accepted:
            wait_for(agent.lease.is_held, "lease")
        yield agent


def libpq(url: str) -> str:
    """A URL as libpq takes it."""
    return make_url(url).set(drivername="postgresql").render_as_string(hide_password=False)


@dataclass
class HandWritten:
    """A centre's database with one bench in it, in which a test writes what a centre would."""

    url: str
    connection: psycopg.Connection[Any]
    bench_url: str

    def order(
        self,
        rig: str = "bench-1",
        *,
        plan: dict[str, Any] | None = None,
        unit: str = "AS-1",
        **columns: Any,
    ) -> str:
        """Orders a run; returns its id."""
        run_id = str(uuid.uuid4())
        document = {
            "unit": unit,
            "plan": Plan.model_validate(plan or QUICK).model_dump(mode="json"),
            "operator": "mara",
            "note": None,
            "follows": None,
            "poses_total": 6,
            "provenance": {"seed": 0},
        }
        row = {"epoch": 1, "wish": "begin", "taken_epoch": 0, **columns}
        self.connection.execute(
            "INSERT INTO run_order (run_uid, bench, rig, epoch, wish, document, taken_epoch, ordered_at) "
            f"VALUES (%s, %s, %s, %s, %s, %s, %s, {NOW})",
            (run_id, BENCH, rig, row["epoch"], row["wish"], Json(document), row["taken_epoch"]),
        )
        return run_id

    def held_epoch(self, run_id: str) -> int:
        """The newest epoch that the bench holds back until somebody orders the run anew."""
        return self._one("SELECT held_epoch FROM run_order WHERE run_uid = %s", run_id)

    def in_touch(self) -> None:
        """Waits until a bench that was begun just now takes orders.

        It holds back what was ordered before; where it was sooner than this order, a later heartbeat tells.
        """
        before = self.order(rig="bench-9")
        is_there = (
            "SELECT held_epoch > 0 OR EXISTS (SELECT FROM bench WHERE last_seen_at > ordered_at) "
            "FROM run_order WHERE run_uid = %s"
        )
        wait_for(lambda: self._one(is_there, before), "bench")

    def tell(self) -> None:
        """Says to the bench that there may be an order."""
        self.connection.execute("SELECT pg_notify(%s, %s)", (ORDERS, BENCH))

    def taken_epoch(self, run_id: str) -> int:
        """The newest epoch that was taken."""
        return self._one("SELECT taken_epoch FROM run_order WHERE run_uid = %s", run_id)

    def said(self) -> dict[str, Any]:
        """What the bench last said of itself."""
        return self._one("SELECT said FROM bench WHERE name = %s", BENCH)

    def command(self, kind: str, *, age_s: float = 0.0, withdrawn: bool = False, **of: str) -> int:
        """Asks something of the bench; returns the command's number."""
        asked = NOW.replace("clock_timestamp()", f"(clock_timestamp() - interval '{age_s} s')")
        return self._one(
            "INSERT INTO bench_command (bench, kind, rig, run_uid, asked_at, withdrawn_at) "
            f"VALUES (%s, %s, %s, %s, {asked}, {NOW if withdrawn else 'NULL'}) RETURNING id",
            BENCH,
            kind,
            of.get("rig"),
            of.get("run_uid"),
        )

    def answer(self, command: int) -> dict[str, Any] | None:
        """What the bench answered."""
        return self._one("SELECT answer FROM bench_command WHERE id = %s", command)

    def answered_at(self, command: int) -> str:
        """When the bench answered it."""
        return self._one("SELECT answered_at FROM bench_command WHERE id = %s", command)

    def taken_at(self, command: int) -> str | None:
        """When the bench took a command."""
        return self._one("SELECT taken_at FROM bench_command WHERE id = %s", command)

    def delivered(self, run_id: str) -> Delivery:
        """All that was delivered of a run."""
        rows = self.connection.execute(
            "SELECT document, data FROM parcel WHERE run_uid = %s ORDER BY id", (run_id,)
        ).fetchall()
        blocks = {document["samples"]["number"]: data for document, data in rows if data is not None}
        return Delivery([document for document, _ in rows], blocks)

    def ended(self, run_id: str) -> Delivery:
        """The same, once the run has ended."""
        return wait_for(lambda: (d := self.delivered(run_id)) and d.status in ENDED and d, "end of the run")

    def _one(self, statement: str, *values: Any) -> Any:
        found = self.connection.execute(statement, values).fetchone()
        assert found is not None
        return found[0]


ENDED = ("completed", "failed", "aborted", "interrupted")


@dataclass
class Delivery:
    """A run's parcels in the order that they came in."""

    documents: list[dict[str, Any]]
    blocks: dict[int, bytes]

    @property
    def events(self) -> list[dict[str, Any]]:
        """Every event, as often as it came."""
        return [event for document in self.documents for event in document["events"]]

    @property
    def states(self) -> list[str]:
        """The states that were announced."""
        return [event["data"]["status"] for event in self.events if event["type"] == "state"]

    @property
    def status(self) -> str | None:
        """The last one of them."""
        return self.states[-1] if self.states else None

    @property
    def poses(self) -> list[int]:
        """Indices of the poses, as often as they came."""
        return [pose["index"] for document in self.documents for pose in document["poses"]]

    @property
    def n_samples(self) -> int:
        """Samples in all blocks, whose numbers tell one that came twice."""
        return sum(len(np.load(io.BytesIO(block))["time_s"]) for block in self.blocks.values())


@contextmanager
def hand_written(url: str) -> Iterator[HandWritten]:
    """The database with the bench in it, whose role is no superuser."""
    with Store.open(url, writer="tests") as store:
        _, code = store.enrolment.add(BENCH)
        bench_url = store.enrolment.enroll(code)[1]
    with psycopg.connect(libpq(url), autocommit=True) as connection:
        yield HandWritten(url, connection, bench_url)
        (role,) = connection.execute("SELECT role FROM bench").fetchone() or ("",)
        ends = "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity WHERE usename = %s"
        connection.execute(ends, (role,))
        connection.execute(f'DROP OWNED BY "{role}"')
        connection.execute(f'DROP ROLE "{role}"')


class Cable:
    """A TCP connection to the server that a test cuts and mends, or that passes nothing on any more."""

    def __init__(self, url: str) -> None:
        self._server = str(make_url(url).query["host"]) + "/.s.PGSQL.5432"
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._ends: list[socket.socket] = []
        self._silent: set[socket.socket] = set()
        self._is_cut = False
        self.url = (
            make_url(url)
            .set(host="127.0.0.1", port=self._listener.getsockname()[1], query={})
            .render_as_string(hide_password=False)
        )
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Nothing comes through any more."""
        self._is_cut = True
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self._ends.clear()

    def silence(self, *, answers_alone: bool = False) -> None:
        """The connections that are open stay so and pass nothing on, for ever; new ones are whole."""
        self._silent |= set(self._ends[1::2] if answers_alone else self._ends)

    def mend(self) -> None:
        """New connections come through."""
        self._is_cut = False

    def close(self) -> None:
        """Takes it away."""
        self.cut()
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if self._is_cut:
                    near.close()
                    continue
                far = socket.socket(socket.AF_UNIX)
                far.connect(self._server)
                self._ends += near, far
                for one, other in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=(one, other), daemon=True).start()

    def _pass_on(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(65536):
                if one not in self._silent:
                    other.sendall(data)
        if one in self._silent:  # of its end the other one hears nothing either
            return
        for end in (one, other):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@contextmanager
def rigs_of(*names: str, **options: Any) -> Iterator[list[Rig]]:
    """Rigs in one virtual time; the options are the simulator's."""
    clock = VirtualClock(10.0)
    with ExitStack() as stack:
        stack.callback(clock.stop)
        rigs = [Rig(name, clock, **options) for name in names]
        for rig in rigs:
            stack.enter_context(rig.simulated)
        yield rigs
