"""How long a list takes units: for an hour after its last one, and never on another day."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from postgresql_server import store_at

from calrig.analysis.errors import Conflict
from calrig.runs.batches import RunBatches
from calrig.runs.follow_up import Designed
from calrig.runs.service import RunService
from calrig.settings import RigSettings
from calrig.store import Store
from calrig.store.batches import Batch, Turn
from calrig.store.errors import Refused

DOCUMENT = {"rigs": ["bench-1"], "plan": {}, "failed": "end", "operator": "ada", "note": "tray 7"}


class Later:
    """The time of day, as far from now as a test says."""

    hours = 0.0

    def __call__(self) -> datetime:
        return datetime.now(UTC) + timedelta(hours=self.hours)


@pytest.fixture
def own_store(tmp_path: Path) -> Iterator[Store]:
    with Store.open(store_at(tmp_path / "calrig.db"), writer="tests") as opened:
        yield opened


def measured(store: Store, batches: RunBatches, batch: Batch, unit: str, *, well: bool) -> None:
    """A unit's run, from begin to end, as a rig's would be."""
    run = store.runs.create(unit=unit, rig="bench-1", plan={}, status="running", provenance={})
    now = batches.standing(batch.id)
    turns = [turn for turn in now.now.turns if turn.unit == unit and turn.state == "waiting"]
    begun = [replace(turn, state="running", rig="bench-1", run_id=run.id) for turn in turns]
    store.batches.update(batch.id, now.batch.turns, [*now.now.written, *begun])
    progress = {"poses_done": 2, "poses_total": 2, "fraction": 1.0, "remaining_s": 0.0}
    store.runs.update(run.id, status="completed" if well else "failed", progress=progress)


def test_a_finished_list_is_closed_an_hour_after_its_last_unit_and_what_failed_has_had_its_turns(
    own_store: Store,
) -> None:
    with closing(RunService(own_store, [])) as service:
        clock = Later()
        batches = RunBatches(service, now=clock)
        batch = own_store.batches.create(DOCUMENT, ["A", "B"])
        measured(own_store, batches, batch, "A", well=False)
        measured(own_store, batches, batch, "B", well=True)
        clock.hours = 7.9
        assert batches.add(batch.id, ["C"]) == [], "A is to be measured once more: the list goes on"
        clock.hours = 0.0
        measured(own_store, batches, batch, "C", well=True)
        measured(own_store, batches, batch, "A", well=False)
        assert batches.standing(batch.id).now.is_finished
        clock.hours = 0.9
        assert batches.add(batch.id, ["B", "A", "C"]) == ["B", "C"], "what failed for good may be tried again"
        measured(own_store, batches, batch, "A", well=True)
        ((listed, takes_units),) = batches.listed()
        assert listed.closed_at is None and takes_units
        clock.hours = 1.1
        ((listed, takes_units),) = batches.listed()
        last = batches.standing(batch.id).active_at
        assert listed.closed_at == last + timedelta(hours=1) and not takes_units
        with pytest.raises(Refused, match="closed"):
            batches.add(batch.id, ["D"])


def test_a_list_with_units_left_stays_open_and_takes_further_ones_once_it_goes_on(own_store: Store) -> None:
    with closing(RunService(own_store, [])) as service:
        clock = Later()
        batches = RunBatches(service, now=clock)
        batch = own_store.batches.create(DOCUMENT, ["A", "B"])
        clock.hours = 8.1
        ((listed, takes_units),) = batches.listed()
        assert listed.closed_at is None and not takes_units
        with pytest.raises(Conflict, match="8 h"):
            batches.add(batch.id, ["C"])
        run = own_store.runs.create(unit="A", rig="bench-1", plan={}, status="running", provenance={})
        (first, _) = batch.turns
        own_store.batches.update(
            batch.id, batch.turns, [replace(first, state="running", rig="bench-1", run_id=run.id)]
        )
        assert batches.add(batch.id, ["C"]) == []


def test_of_two_who_ask_for_the_run_that_tells_why_one_has_it_designed(own_store: Store) -> None:
    parts = {"stage": {"driver": "smc100", "port": "nowhere"}, "imu": {"driver": "calrig", "port": "nowhere"}}
    with closing(RunService(own_store, [RigSettings(name="bench-1", **parts)])) as service:
        batches = RunBatches(service)
        batch = own_store.batches.create({**DOCUMENT, "failed": "follow_up"}, ["A"])
        run = own_store.runs.create(unit="A", rig="bench-1", plan={}, status="running", provenance={})
        own_store.runs.update(run.id, status="completed")
        of_it = Turn(0, "A", "failed", "bench-1", run.id)
        follow_up = replace(of_it, position=1, state="follow_up")
        own_store.batches.update(batch.id, batch.turns, [of_it, follow_up])

        def apart(_: Callable[..., Designed]) -> Designed:
            assert batches.is_in_design(batch.id, "A")
            with pytest.raises(Conflict, match="A: its next run is being designed"):
                batches.start(batch.id, "bench-1", "A", apart, None)
            return "nothing is left to separate"

        with pytest.raises(Conflict, match="A: nothing is left to separate"):
            batches.start(batch.id, "bench-1", "A", apart, None)
        assert not batches.is_in_design(batch.id, "A")
        assert [turn.state for turn in batches.standing(batch.id).now.turns] == ["failed", "failed"]


def test_who_looks_at_what_is_to_be_mounted_keeps_it_for_that_rig(own_store: Store) -> None:
    with closing(RunService(own_store, [])) as service:
        batches = RunBatches(service)
        batch = own_store.batches.create({**DOCUMENT, "rigs": ["l", "r"]}, ["A", "B", "C"])
        a, b, c = batch.turns
        batches.standing(batch.id)
        assert own_store.batches.get(batch.id).turns == batch.turns, "whoever asks only changes nothing"
        batches.look(batch.id)
        assert own_store.batches.get(batch.id).turns == [replace(a, rig="l"), replace(b, rig="r"), c]
