"""A centre's database with many benches in it, which say and do what a test has them do, without agents."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import Engine, create_engine, text
from sqlmodel import Session, col, select, update
from support import QUICK

from calrig.centre.service import CentreService
from calrig.plan import Plan
from calrig.store import Run, Store
from calrig.store.bench_tables import BenchCommandTable, BenchTable, RunOrderTable
from calrig.store.benches import versions_here
from calrig.store.tables import RunTable

HALLS = {"hall 1": 3, "hall 2": 3, "hall 10": 2}
"""Benches in each."""
RIGS_EACH = 5
STAYS_S = 3600.0
"""For so long nobody takes a bench for silent that has spoken, however slow the machine is that tests it."""


class ManyBenches:
    """Eight benches in three halls, `bench-1` to `bench-8`, with five rigs each, `rig-01` to `rig-40`.

    Args:
        url: of a centre's store that is empty.
    """

    def __init__(self, url: str) -> None:
        self.store = Store.open(url, writer="tests")
        self._engine: Engine = create_engine(url)
        self.rigs: dict[str, str] = {}
        self.states: dict[str, dict[str, Any]] = {}
        halls = [hall for hall, n_benches in HALLS.items() for _ in range(n_benches)]
        with Session(self._engine) as session:
            for number, hall in enumerate(halls, start=1):
                session.add(BenchTable(name=f"bench-{number}", hall=hall, said={}))
                for k in range(RIGS_EACH):
                    self.rigs[f"rig-{RIGS_EACH * (number - 1) + k + 1:02d}"] = f"bench-{number}"
            session.commit()
        for bench in self.benches:
            self.beat(bench)

    @property
    def benches(self) -> list[str]:
        """Their names."""
        return list(dict.fromkeys(self.rigs.values()))

    def close(self) -> None:
        self._engine.dispose()
        self.store.close()

    def beat(self, bench: str, ago_s: float = -STAYS_S, **more: Any) -> None:
        """Says how its rigs stand, as if that had been so many seconds ago; else in an hour from now."""
        usual = {"stage": "smc100", "imu": "calrig", "simulated": False, "limits_deg": [-90, 90]}
        rigs = [
            {"name": rig, "state": "idle", "run_id": None, **usual, **self.states.get(rig, {})}
            for rig, on in self.rigs.items()
            if on == bench
        ]
        outbox = {"parcels": 0, "oldest_at": None}
        with Session(self._engine) as session:
            now = session.connection().execute(text("SELECT clock_timestamp()")).scalar_one()
            row = session.get_one(BenchTable, bench)
            row.last_seen_at = now - timedelta(seconds=ago_s)
            row.said = {"rigs": rigs, "outbox": outbox, "lease_losses": 0, **versions_here(), **more}
            session.commit()

    def says(self, rig: str, state: str) -> None:
        """A bench says that of its rig."""
        self.states[rig] = {"state": state}
        self.beat(self.rigs[rig])

    def order(self, rig: str, unit: str, **plan: Any) -> Run:
        """A run that waits for the rig."""
        return self.store.orders.create(
            bench=self.rigs[rig],
            rig=rig,
            unit=unit,
            plan=Plan.model_validate({**QUICK, **plan}).model_dump(mode="json"),
            provenance={},
            poses_total=52,
            waits=True,
        )

    def hold(self, run: Run) -> None:
        """Its bench holds it back, as one that was away when it was ordered."""
        order = update(RunOrderTable).where(col(RunOrderTable.run_uid) == run.id)
        with Session(self._engine) as session:
            session.execute(order.values(held_epoch=RunOrderTable.epoch))
            session.commit()

    def begin(self, run: Run, poses_done: int = 0, remaining_s: float | None = None, **more: Any) -> None:
        """Its bench takes it, and has come so far with it."""
        with Session(self._engine) as session:
            order = update(RunOrderTable).where(col(RunOrderTable.run_uid) == run.id)
            session.execute(order.values(taken_epoch=RunOrderTable.epoch))
            session.commit()
        progress = {
            "poses_done": poses_done,
            "poses_total": 52,
            "fraction": poses_done / 52,
            "remaining_s": remaining_s,
            **more,
        }
        self.store.runs.update(run.id, status="running", progress=progress)  # type: ignore[arg-type]

    def busy(self, rig: str, unit: str, poses_done: int = 0, remaining_s: float | None = None) -> Run:
        """A run that goes on."""
        run = self.order(rig, unit)
        self.begin(run, poses_done, remaining_s)
        return run

    def waits_for_a_mount(self, rig: str, unit: str, mount_deg: float) -> Run:
        """A run that is paused until the unit was clamped anew."""
        run = self.order(rig, unit)
        self.begin(run, 26, 90.0, waiting_for={"mount_deg": mount_deg, "mount_axis": "x"})
        return self.store.runs.update(run.id, status="paused")

    def ended(self, rig: str, unit: str, status: str, error: str | None = None) -> Run:
        """A run that is over."""
        run = self.busy(rig, unit, 12)
        return self.store.runs.update(run.id, status=status, error=error)  # type: ignore[arg-type]

    def since(self, run: Run, days: float) -> None:
        """Has a run that is over be so many days old."""
        then = datetime.now(UTC) - timedelta(days=days)
        with Session(self._engine) as session:
            row = session.exec(select(RunTable).where(RunTable.uid == run.id)).one()
            row.created_at = row.started_at = row.finished_at = then
            session.commit()

    def check_units_named(self, days: float) -> None:
        """Every check unit was named so many days ago."""
        then = (datetime.now(UTC) - timedelta(days=days)).isoformat(timespec="microseconds")
        with self._engine.begin() as connection:
            connection.execute(text("UPDATE check_unit SET named_at = :then"), {"then": then})

    def answer_commands(self) -> int:
        """Every bench does what it is asked; returns how many commands there were."""
        with Session(self._engine) as session:
            asked = session.exec(
                select(BenchCommandTable).where(
                    col(BenchCommandTable.taken_at).is_(None), col(BenchCommandTable.withdrawn_at).is_(None)
                )
            ).all()
            for row in asked:
                row.taken_at = row.answered_at = datetime.now(UTC)
                row.answer = {"status": 200, "detail": None}
            session.commit()
            return len(asked)

    def unanswered(self, kind: str, rig: str, ago_s: float) -> None:
        """A command lies there that its bench has not answered."""
        with Session(self._engine) as session:
            asked_at = datetime.now(UTC) - timedelta(seconds=ago_s)
            session.add(BenchCommandTable(bench=self.rigs[rig], kind=kind, rig=rig, asked_at=asked_at))
            session.commit()


def a_day_in_the_halls(benches: ManyBenches) -> None:
    """Of everything something: runs that go on and wait, failures, a mount to be changed, benches away."""
    for k in range(1, 16):
        benches.busy(f"rig-{k:02d}", f"AS-{1000 + k}", poses_done=3 * k, remaining_s=600.0 - 35 * k)
    for unit in ("AS-2001", "AS-2002", "AS-2003", "AS-2004"):
        benches.order("rig-03", unit)
    benches.order("rig-07", "AS-2005")
    benches.waits_for_a_mount("rig-16", "AS-1016", 90.0)
    error = "the stage did not reach 40.00° within 8 s: it stands at 38.71°, and its error code is 27"
    benches.ended("rig-18", "AS-1018", "failed", error)
    benches.ended("rig-22", "AS-1022", "interrupted", "the service ended while the run went on")
    benches.ended("rig-23", "AS-1023", "failed", "the board sent nothing for 3 s")
    benches.ended("rig-23", "AS-1023", "completed")
    benches.says("rig-24", "unreachable")
    checked = benches.ended("rig-25", "CHECK-1", "completed")
    benches.since(checked, 45)
    benches.store.check_standards.name("rig-25", "CHECK-1", 30)
    benches.check_units_named(40)
    benches.store.check_standards.name("rig-26", "CHECK-1", 30)
    benches.busy("rig-31", "AS-1031", poses_done=20, remaining_s=240.0)
    oldest = (datetime.now(UTC) - timedelta(hours=2.5)).isoformat()
    benches.beat("bench-7", ago_s=9000, outbox={"parcels": 18, "oldest_at": oldest})


@contextmanager
def centre_with_benches(url: str) -> Iterator[tuple[CentreService, ManyBenches]]:
    """A centre's service over the database, with the benches."""
    with (
        closing(ManyBenches(url)) as benches,
        Store.open(url, writer="tests") as store,
        closing(CentreService(store, url)) as service,
    ):
        yield service, benches
