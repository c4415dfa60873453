"""Commands: a bench does what is asked and says so in time, or whoever asked hears that it was not told."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager

import psycopg
import pytest
from sqlalchemy import make_url
from support import serving, wait_for
from table_bench import TableBench
from virtual_time.clock import VirtualClock

from calrig.analysis.errors import Conflict, Unknown
from calrig.centre.service import CentreService
from calrig.plan import Plan
from calrig.store.bench_tables import BenchCommandTable
from calrig.store.postgresql.database import TURN


@contextmanager
def answering(
    bench: TableBench, status: int = 200, detail: str | None = None
) -> Iterator[list[BenchCommandTable]]:
    """Has the bench answer whatever it is asked; gives what that was."""
    asked: list[BenchCommandTable] = []
    over = threading.Event()

    def answer() -> None:
        while not over.wait(0.01):
            if (command := bench.command()) is not None:
                asked.append(command)
                bench.answer(command, status, detail)

    with ThreadPoolExecutor(1) as beside:
        answers = beside.submit(answer)
        try:
            yield asked
        finally:
            over.set()
        answers.result()


def test_a_stop_is_answered_by_the_bench(centre: CentreService, bench: TableBench):
    with answering(bench) as asked:
        state = centre.stop("bench-1")

    assert (state.name, state.state, state.bench) == ("bench-1", "idle", "hall-2")
    assert [(command.kind, command.rig) for command in asked] == [("stop", "bench-1")]


def test_what_waits_to_begin_does_not_begin_after_a_stop(
    centre: CentreService, bench: TableBench, plan: Plan
):
    begun = centre.start(unit="A", plan=plan).id
    bench.take(begun, 1)
    waiting = centre.start(unit="B", plan=plan, queue=True).id

    with answering(bench):
        centre.stop("bench-1")

    run = centre.run(waiting)
    assert (run.status, run.error) == ("aborted", "the stage was stopped by request")
    assert bench.take(waiting, 1) is None
    assert centre.run(begun).status == "queued"  # the bench will say what became of it


def test_what_the_bench_says_no_to_is_a_conflict_in_its_words(centre: CentreService, bench: TableBench):
    refusal = "rig 'bench-1': it does not stand: cut its motor power"
    with answering(bench, 409, refusal), pytest.raises(Conflict, match=refusal):
        centre.stop("bench-1")
    with answering(bench, 404, "there is no rig 'bench-1'"), pytest.raises(Unknown, match="there is no rig"):
        centre.stop("bench-1")
    with pytest.raises(Unknown, match="no bench has a rig 'bench-7'"):
        centre.stop("bench-7")


def test_a_stop_that_reaches_nobody_stays_and_is_said_to(patient_centre: CentreService, bench: TableBench):
    bench.beat(ago_s=40)

    said = (
        r"hall-2 was last seen \d+ s ago and has not said that the stage stands: go there, or cut .*; "
        "the stop stays: the bench obeys it before anything else"
    )
    with pytest.raises(Conflict, match=said):
        patient_centre.stop("bench-1")
    assert patient_centre.rigs()[0].stop_asked_at is not None
    bench.ages(days=2)
    patient_centre.store.commands.prune()

    stop = bench.command()  # when it comes back
    assert stop is not None
    bench.answer(stop)
    assert patient_centre.rigs()[0].stop_asked_at is None


def test_a_stop_that_stays_goes_once_somebody_withdraws_it(patient_centre: CentreService, bench: TableBench):
    bench.beat(ago_s=40)
    with serving(patient_centre) as client:
        assert client.delete("/api/rigs/bench-1/stop").status_code == 404
        assert client.post("/api/rigs/bench-1/stop").status_code == 409
        assert client.get("/api/benches/overview").json()[0]["rigs"][0]["stop_asked_at"] is not None
        assert client.delete("/api/rigs/bench-1/stop").status_code == 204
        assert client.get("/api/rigs").json()[0]["stop_asked_at"] is None
    assert bench.command() is None
    (entry,) = patient_centre.store.trail.entries()
    assert (entry.what, entry.rig, entry.detail) == (
        "stop_withdrawn",
        "bench-1",
        {"benches": ["hall-2"]},
    )


def test_a_bench_that_has_a_stop_and_says_nothing_is_not_said_to_stand(
    patient_centre: CentreService, bench: TableBench, clock: VirtualClock
):
    with clock.taking_part():  # time stands wherever this thread does not wait by it
        asking = patient_centre.begin_stop("bench-1")
        clock.until(bench.command, "stop")

        with pytest.raises(Conflict, match="has not said that the stage stands: go"):
            asking.result()

    assert bench.commands()[0].withdrawn_at is None


def test_a_stop_by_a_name_is_for_every_bench_that_bears_it(
    patient_centre: CentreService, bench: TableBench, url: str, clock: VirtualClock
):
    with closing(TableBench(url, "hall-3")) as other, clock.taking_part():
        stopping = patient_centre.begin_stop("bench-1")
        both = [clock.until(one.command, "stop") for one in (bench, other)]
        bench.answer(both[0])
        other.answer(both[1])
        assert stopping.result().name == "bench-1"

        stopping = patient_centre.begin_stop("bench-1")
        bench.answer(clock.until(bench.command, "stop"))
        with pytest.raises(Conflict, match=r"bench hall-2: the stage stands; bench hall-3: .*has not said"):
            stopping.result()


def test_a_bench_has_a_stop_and_an_abort_while_somebody_else_writes(
    centre: CentreService, bench: TableBench, plan: Plan, url: str
):
    run_id = centre.start(unit="A", plan=plan).id
    bench.take(run_id, 1)
    server = make_url(url).set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(server) as somebody:
        somebody.execute("SELECT pg_advisory_xact_lock(%s)", (TURN,))
        aborting, stopping = centre.begin_abort(run_id), centre.begin_stop("bench-1")
        commands = [wait_for(bench.command, "command") for _ in range(2)]
    for command in commands:
        bench.answer(command)
    assert {command.kind for command in commands} == {"abort", "stop"}
    assert stopping.result().name == "bench-1"
    assert aborting.result().status == "queued"  # the bench says what became of it


def test_commands_of_yesterday_are_deleted(centre: CentreService, bench: TableBench):
    with answering(bench):
        centre.stop("bench-1")
    centre.store.commands.prune()
    assert len(bench.commands()) == 1
    bench.ages(days=1.1)
    centre.store.commands.prune()
    assert bench.commands() == []


def test_pause_and_resume_go_to_the_bench_of_a_run_that_goes_on(
    centre: CentreService, bench: TableBench, plan: Plan
):
    run_id = centre.start(unit="A", plan=plan).id
    with pytest.raises(Conflict, match="is queued and cannot be paused"):
        centre.pause(run_id)
    bench.take(run_id, 1)

    with answering(bench) as asked:
        centre.pause(run_id)
        centre.resume(run_id)

    assert [(command.kind, command.run_uid) for command in asked] == [("pause", run_id), ("resume", run_id)]


def test_an_abort_of_a_taken_run_returns_once_the_bench_has_told_of_its_end(
    centre: CentreService, bench: TableBench, plan: Plan, measured
):
    run_id = centre.start(unit="A", plan=plan).id
    bench.take(run_id, 1)
    document = measured.parcels[0][0]
    queued, running, *_ = document["events"]
    end = {**running, "seq": 3, "data": {"status": "aborted", "error": None}}
    told = {**document, "run": {**document["run"], "status": "aborted", "result": None}, "poses": []}

    aborting = centre.begin_abort(run_id)
    command = wait_for(bench.command, "abort")
    bench.deliver(run_id, [({**told, "events": [queued, running, end]}, None)])
    bench.answer(command)

    assert aborting.result().status == "aborted"
    assert [event.data["status"] for event in centre.store.events.after(run_id)] == [
        "queued",
        "running",
        "aborted",
    ]
