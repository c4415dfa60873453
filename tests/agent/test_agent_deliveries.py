"""What a bench delivers: nothing twice, nothing lost, in order, whatever becomes of the way to its centre."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from a_bench import ENDLESS, Cable, Delivery, HandWritten, Rig, agent_at
from postgresql_server import store_at
from support import QUICK, wait_for

from calrig.agent.link import LinkDown
from calrig.plan import Plan
from calrig.store import Store
from calrig.store.parcels import EVENTS_A_PARCEL, Spool


def once_in_order(events: list[dict]) -> bool:
    """Whether events count from 1 without a gap."""
    return [event["seq"] for event in events] == list(range(1, len(events) + 1))


def again_from(before: Delivery) -> set[int]:
    """Numbers of the events that may come first after a cut: the next, or those whose receipt was cut off."""
    *_, last = (document["events"] for document in before.documents if document["events"])
    return {last[0]["seq"], last[-1]["seq"] + 1}


def test_cut_off_in_mid_run_the_bench_ends_it_and_goes_on_delivering_where_it_was(
    centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    with agent_at(cable.url, spool, rig) as agent:
        run_id = centre.order(plan={**QUICK, "sweeps": 30})
        wait_for(lambda: centre.delivered(run_id).poses, "poses")
        cable.cut()
        assert agent.service.wait(run_id).status == "completed"
        before = centre.delivered(run_id)
        assert before.status == "running"
        wait_for(lambda: agent.service.store.spool.outbox().n_parcels > 0, "outbox")
        cable.mend()
        told, store = centre.ended(run_id), agent.service.store
    assert once_in_order(before.events)
    assert told.documents[: len(before.documents)] == before.documents
    since = [event["seq"] for event in told.events[len(before.events) :]]
    assert since[0] in again_from(before)
    assert since == list(range(since[0], since[-1] + 1))
    assert sorted(set(told.poses)) == list(range(90))
    states = {event["seq"]: event["data"]["status"] for event in told.events if event["type"] == "state"}
    assert [*states.values()] == ["queued", "running", "completed"]
    with Store.open(store_at(spool), writer=None) as store:
        assert told.n_samples == len(store.samples.of(run_id))


def test_a_day_without_the_centre_is_delivered_whole_and_begins_nothing_by_itself(
    centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    """The day passes by the clock that the agent is given: an hour between what happens."""
    rng, now_s = random.Random(31), [0.0]
    with agent_at(cable.url, spool, rig, now_s=lambda: now_s[0]) as agent:
        cable.cut()
        own: list[str] = []
        ordered: list[str] = []
        for hour in range(24):
            now_s[0] += 3600.0
            assert not agent.lease.is_held()
            if rng.random() < 0.4:
                ordered.append(centre.order(unit=f"ordered {hour}"))
            if rng.random() < 0.4:
                own.append(agent.service.start(unit=f"own {hour}", plan=Plan.model_validate(QUICK)).id)
                assert agent.service.wait(own[-1]).status == "completed"
        stop = centre.command("stop", rig="bench-1", age_s=20 * 3600.0)
        pause = centre.command("pause", run_uid=own[0], age_s=3600.0)
        assert agent.lease.losses == 1
        cable.mend()
        told = [centre.ended(run_id) for run_id in own]
        answer = wait_for(lambda: centre.answer(stop), "answer to the stop of hours ago")
        wait_for(lambda: all(centre.held_epoch(run_id) == 1 for run_id in ordered), "orders held back")
        wait_for(lambda: agent.service.store.spool.undelivered() == [], "delivery")
        assert [centre.taken_epoch(run_id) for run_id in ordered] == [0] * len(ordered)
    assert (len(own), len(ordered)) == (11, 14)
    assert answer["status"] == 200
    assert centre.taken_at(pause) is None
    for run in told:
        assert once_in_order(run.events)
        assert run.poses == list(range(6))


def test_a_server_that_throws_the_bench_out_meets_it_again(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = centre.order(plan=ENDLESS)
        for _ in range(3):
            seen = len(centre.delivered(run_id).events)
            centre.connection.execute(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                "WHERE datname = current_database() AND usename <> session_user"
            )
            wait_for(lambda n=seen: len(centre.delivered(run_id).events) > n, "more of it")
        agent.service.abort(run_id)
        told, n_poses = centre.ended(run_id), len(agent.service.store.poses.of(run_id))
    assert {event["seq"] for event in told.events} == set(range(1, told.events[-1]["seq"] + 1))
    assert sorted(set(told.poses)) == list(range(n_poses))


def test_a_run_begun_without_the_centre_is_delivered_by_a_later_program(
    centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    cable.cut()
    with agent_at(cable.url, spool, rig, is_accepted=False) as agent:
        run = agent.service.start(unit="AS-7", plan=Plan.model_validate(QUICK))
        assert agent.service.wait(run.id).status == "completed"
    cable.mend()
    with agent_at(cable.url, spool, rig):
        told = centre.ended(run.id)
    assert once_in_order(told.events)
    assert told.poses == list(range(6))
    assert told.documents[0]["run"]["unit"] == "AS-7"


def test_a_parcel_whose_receipt_was_lost_is_delivered_again_and_says_the_same(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark_delivered, lost = Spool.mark_delivered, []

    def forgets_some(spool: Spool, parcels: list) -> None:
        if len(lost) < 5:
            lost.append(parcels)
            raise LinkDown("the receipt is lost")
        mark_delivered(spool, parcels)

    monkeypatch.setattr(Spool, "mark_delivered", forgets_some)
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order()
        told = centre.ended(run_id)
    by_number: dict[int, list[dict]] = {}
    for event in told.events:
        by_number.setdefault(event["seq"], []).append(event)
    assert len(told.events) > len(by_number)
    assert all(event == same[0] for same in by_number.values() for event in same)
    assert sorted(set(told.poses)) == list(range(6))


def test_a_long_log_goes_in_pieces_that_say_how_the_run_stood(spool: Path) -> None:
    n = 2 * EVENTS_A_PARCEL + 100
    with Store.open(store_at(spool), writer="tests") as store:
        run = store.runs.create(unit="AS-1", rig="r", plan=None, status="queued", provenance={})
        store.runs.update(run.id, status="running")
        store.events.append(run.id, [("reading", {"time_s": float(k)}) for k in range(n)])
        store.runs.update(run.id, status="failed", error="a wire came off")
        told = []
        while parcels := store.spool.next_parcels(run.id):
            store.spool.mark_delivered(parcels)
            told += [parcel.document for parcel in parcels]
        assert store.spool.undelivered() == []
    assert [len(one["events"]) for one in told] == [EVENTS_A_PARCEL, EVENTS_A_PARCEL, 102, 1]
    assert [(one["run"]["status"], one["run"]["error"]) for one in told] == [
        *[("running", None)] * 3,
        ("failed", "a wire came off"),
    ]


def test_what_the_bench_says_of_itself(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        said = wait_for(lambda: (told := centre.said()).get("rigs") and told, "heartbeat")
        assert [(r["name"], r["state"], r["limits_deg"]) for r in said["rigs"]] == [
            ("bench-1", "idle", [-90.0, 90.0])
        ]
        run = agent.service.start(unit="AS-1", plan=Plan.model_validate(ENDLESS))
        (busy,) = wait_for(lambda: [r for r in centre.said()["rigs"] if r["state"] == "busy"], "busy rig")
        assert busy["run_id"] == run.id
        assert said["outbox"] == {"parcels": 0, "oldest_at": None}


def test_a_bench_that_was_revoked_goes_on_by_itself(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        wait_for(agent.lease.is_held, "lease")
        with Store.open(centre.url, writer="tests") as store:
            store.enrolment.revoke("hall-2")
        run = agent.service.start(unit="AS-1", plan=Plan.model_validate(QUICK))
        assert agent.service.wait(run.id).status == "completed"
        assert centre.delivered(run.id).documents == []
