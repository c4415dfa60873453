"""A bench that is nothing but rows of the centre's tables: it says, takes, answers, delivers as it's told."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import Engine, create_engine, text
from sqlmodel import Session, col, select, update

from calrig.centre.service import CentreService
from calrig.runs.service import RunService
from calrig.store import Event, RawSamples, Run, Store, StoredPose
from calrig.store.bench_tables import BenchCommandTable, BenchTable, ParcelTable, RunOrderTable
from calrig.store.benches import versions_here
from calrig.store.tables import SampleBlockTable

Packed = tuple[dict[str, Any], bytes | None]
"""A parcel's document and the block beside it."""
MakeCentre = Callable[..., CentreService]
STAYS_S = 3600.0
"""For so long nobody takes a bench for silent that has spoken, however slow the machine is that tests it."""
KNOWN = (
    "unit", "rig", "status", "plan", "progress", "result", "faults", "follows", "provenance", "operator",
    "note", "error",
)  # fmt: skip
TIMES = ("created_at", "started_at", "finished_at")


@dataclass(frozen=True)
class Measured:
    """A run as the bench that carried it out has it."""

    run: Run
    events: list[Event]
    poses: list[StoredPose]
    samples: RawSamples
    parcels: list[Packed]


class TableBench:
    """A bench that has joined, with one rig.

    Args:
        url: of the centre's store.
        name: of the bench.
        rig: the name of its rig.
    """

    def __init__(self, url: str, name: str = "hall-2", rig: str = "bench-1") -> None:
        self.name, self.rig, self.versions = name, rig, versions_here()
        self._engine: Engine = create_engine(url)
        with Session(self._engine) as session:
            session.add(BenchTable(name=name, hall="north", said={}))
            session.commit()
        self.beat()

    def close(self) -> None:
        self._engine.dispose()

    def beat(self, ago_s: float = -STAYS_S, **said: Any) -> None:
        """Says how its rig stands, as if that had been so many seconds ago; else in an hour from now."""
        rig = {
            "name": self.rig,
            "stage": "smc100",
            "imu": "calrig",
            "simulated": False,
            "state": "idle",
            "run_id": None,
            "limits_deg": [-90, 90],
            "release": "auto",
            "reference": {"std_deg": 0.29},
            **said,
        }
        with Session(self._engine) as session:
            now = session.connection().execute(text("SELECT clock_timestamp()")).scalar_one()
            row = session.get_one(BenchTable, self.name)
            row.last_seen_at = now - timedelta(seconds=ago_s)
            row.said = {"rigs": [rig], **self.versions}
            session.commit()

    def is_gone(self) -> None:
        """It was revoked."""
        with Session(self._engine) as session:
            session.get_one(BenchTable, self.name).revoked_at = datetime.now(UTC)
            session.commit()

    def orders(self) -> list[str]:
        """The runs that there are orders of, oldest first."""
        with Session(self._engine) as session:
            wanted = select(RunOrderTable.run_uid).order_by(col(RunOrderTable.ordered_at))
            return list(session.exec(wanted))

    def order(self, run_id: str) -> RunOrderTable:
        """What it is to do with a run."""
        with Session(self._engine, expire_on_commit=False) as session:
            return session.get_one(RunOrderTable, run_id)

    def take(self, run_id: str, epoch: int) -> str | None:
        """Takes an order of that epoch; its wish, or None where it is not to be taken."""
        taking = (
            update(RunOrderTable)
            .where(
                col(RunOrderTable.run_uid) == run_id,
                col(RunOrderTable.epoch) == epoch,
                col(RunOrderTable.taken_epoch) < epoch,
            )
            .values(taken_epoch=epoch)
            .returning(col(RunOrderTable.wish))
        )
        with Session(self._engine) as session:
            wish = session.scalar(taking)
            session.commit()
            return None if wish == "none" else wish

    def hold(self, run_id: str) -> None:
        """Holds an order back, as who was away when it was made."""
        holding = update(RunOrderTable).where(col(RunOrderTable.run_uid) == run_id)
        with Session(self._engine) as session:
            session.execute(holding.values(held_epoch=RunOrderTable.epoch))
            session.commit()

    def command(self) -> BenchCommandTable | None:
        """Takes the oldest command that nobody has taken."""
        with Session(self._engine, expire_on_commit=False) as session:
            wanted = select(BenchCommandTable).where(
                BenchCommandTable.bench == self.name,
                col(BenchCommandTable.taken_at).is_(None),
                col(BenchCommandTable.withdrawn_at).is_(None),
            )
            row = session.exec(wanted.order_by(col(BenchCommandTable.id)).with_for_update()).first()
            if row is not None:
                row.taken_at = datetime.now(UTC)
                session.commit()
            return row

    def answer(self, command: BenchCommandTable, status: int = 200, detail: str | None = None) -> None:
        """Says what came of a command."""
        with Session(self._engine) as session:
            row = session.get_one(BenchCommandTable, command.id)
            row.answered_at, row.answer = datetime.now(UTC), {"status": status, "detail": detail}
            session.commit()

    def commands(self) -> list[BenchCommandTable]:
        """All there ever were."""
        with Session(self._engine, expire_on_commit=False) as session:
            return list(session.exec(select(BenchCommandTable).order_by(col(BenchCommandTable.id))))

    def ages(self, days: float) -> None:
        """Its commands were asked so many days earlier."""
        with Session(self._engine) as session:
            for row in session.exec(select(BenchCommandTable)):
                row.asked_at -= timedelta(days=days)
            session.commit()

    def deliver(self, run_id: str, parcels: Sequence[Packed]) -> None:
        """Delivers parcels in this order, all at once."""
        with Session(self._engine) as session:
            newest = text("SELECT coalesce(max(seq), 0) FROM parcel WHERE bench = :bench")
            first = session.connection().execute(newest, {"bench": self.name}).scalar_one() + 1
            for seq, (document, data) in enumerate(parcels, start=first):
                row = ParcelTable(
                    bench=self.name,
                    seq=seq,
                    run_uid=run_id,
                    document=document,
                    data=data,
                    delivered_at=datetime.now(UTC),
                )
                session.add(row)
                session.flush()
            session.commit()

    def spoil(self, run_id: str) -> None:
        """Damages the oldest parcel of a run that is still there."""
        damage = (
            "UPDATE parcel SET document = replace(document::text, 'smc100', 'smc101')::json "
            "WHERE id = (SELECT min(id) FROM parcel WHERE run_uid = :run)"
        )
        with self._engine.begin() as connection:
            connection.execute(text(damage), {"run": run_id})

    def waiting(self) -> int:
        """How many of its parcels lie there."""
        with self._engine.connect() as connection:
            return connection.execute(text("SELECT count(*) FROM parcel")).scalar_one()


def packed(service: RunService, run_id: str, *, events_each: int = 30, epoch: int = 1) -> list[Packed]:
    """All that a service's store has of a run, in parcels as a bench makes them; the end comes last."""
    return [*_packed(service.store, run_id, events_each, epoch)]


def _packed(store: Store, run_id: str, events_each: int, epoch: int) -> Iterator[Packed]:
    run = store.runs.get(run_id)
    assert run is not None
    told = {name: getattr(run, name) for name in KNOWN}
    told |= {
        "progress": run.progress.model_dump(mode="json"),
        "result": None if run.result is None else run.result.to_dict(),
    }
    told |= {name: None if (at := getattr(run, name)) is None else at.isoformat() for name in TIMES}
    poses = {
        one.index: {"index": one.index, **one.pose.row(), "excluded": one.excluded}
        for one in store.poses.of(run_id)
    }
    now = datetime.now(UTC).isoformat()
    *events, end = [
        {"seq": one.seq, "type": one.type, "data": one.data, "at": now} for one in store.events.after(run_id)
    ]
    head = {"v": 1, "epoch": epoch, "run": told}
    for first in range(0, len(events), events_each):
        some = events[first : first + events_each]
        indices = [event["data"]["index"] for event in some if event["type"] == "pose"]
        yield {**head, "events": some, "poses": [poses[index] for index in indices]}, None
    with store._database.reading() as session:
        blocks = session.exec(select(SampleBlockTable).order_by(col(SampleBlockTable.id))).all()
    for block in blocks:
        said = {"pose_index": block.pose_index, "phase": block.phase, "n_samples": block.n_samples}
        yield {**head, "events": [], "poses": [], "samples": {"number": block.id, **said}}, block.data
    yield {**head, "events": [end], "poses": []}, None
