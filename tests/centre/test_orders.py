"""Orders: what a bench never took is the centre's to end; what it took is the bench's to tell of."""

from __future__ import annotations

from contextlib import closing

import pytest
from sqlalchemy import create_engine, text
from support import QUICK, serving, wait_for
from table_bench import Measured, TableBench

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.centre.service import CentreService
from calrig.plan import Plan
from calrig.store.benches import HELD, versions_here
from calrig.store.errors import Refused


def test_a_run_and_its_order_are_made_together(centre: CentreService, bench: TableBench, plan: Plan):
    run = centre.start(unit="A", plan=plan, operator="Ada", note="warm", stage_at_deg=3.0)

    assert (run.status, run.rig, run.operator, run.note) == ("queued", "bench-1", "Ada", "warm")
    assert run.progress.poses_total == 6
    order = bench.order(run.id)
    assert (order.bench, order.rig, order.epoch, order.taken_epoch, order.wish) == (
        "hall-2",
        "bench-1",
        1,
        0,
        "begin",
    )
    assert order.document["plan"] == run.plan
    assert order.document["stage_at_deg"] == 3.0
    assert [event.data["status"] for event in centre.store.events.after(run.id)] == ["queued"]
    assert [entry.what for entry in centre.store.trail.entries(unit="A")] == ["started"]


def test_an_uncertainty_that_nobody_could_state_is_not_ordered_as_an_end(
    centre: CentreService, bench: TableBench, plan: Plan
):
    bench.beat(reference=None)
    ends = {"sweeps": 4, "until": {"expanded_uncertainty_deg": 0.5}}

    with pytest.raises(Invalid, match="has no `reference`"):
        centre.start(unit="A", plan=Plan.model_validate({**QUICK, **ends}))

    assert bench.orders() == []


def test_an_order_is_taken_once(centre: CentreService, bench: TableBench, plan: Plan):
    run_id = centre.start(unit="A", plan=plan).id

    assert bench.take(run_id, 1) == "begin"
    assert bench.take(run_id, 1) is None  # whatever is told a second time


def test_what_was_aborted_while_it_waited_is_never_taken(
    centre: CentreService, bench: TableBench, plan: Plan
):
    run_id = centre.start(unit="A", plan=plan).id

    run = centre.abort(run_id)

    assert (run.status, run.finished_at is None) == ("aborted", False)
    assert [event.data["status"] for event in centre.store.events.after(run_id)] == ["queued", "aborted"]
    assert bench.take(run_id, 1) is None
    assert bench.take(run_id, 2) is None  # the wish of that epoch is none
    with pytest.raises(Conflict, match="is aborted and cannot be aborted"):
        centre.abort(run_id)
    assert centre.start(unit="A", plan=plan).status == "queued"  # the rig is free again


def test_of_what_was_taken_only_the_bench_says_what_becomes(
    patient_centre: CentreService, bench: TableBench, plan: Plan
):
    run_id = patient_centre.start(unit="A", plan=plan).id
    assert bench.take(run_id, 1) == "begin"
    bench.beat(ago_s=4)

    with pytest.raises(Conflict, match=r"hall-2 was last seen \d+ s ago and cannot be told"):
        patient_centre.abort(run_id)

    assert patient_centre.run(run_id).status == "queued"
    assert bench.order(run_id).epoch == 1


def test_a_busy_rig_is_refused_unless_the_run_may_wait(centre: CentreService, bench: TableBench, plan: Plan):
    first = centre.start(unit="A", plan=plan).id

    with pytest.raises(Refused, match=f"'bench-1' is busy with run {first}"):
        centre.start(unit="B", plan=plan)
    second = centre.start(unit="B", plan=plan, queue=True).id

    assert bench.orders() == [first, second]
    assert centre.rigs()[0].run_id == first
    assert [entry.unit for entry in centre.store.trail.entries()] == ["A", "B"]


def test_what_cannot_be_ordered_is_said_before_anything_is_stored(
    centre: CentreService, bench: TableBench, plan: Plan
):
    beyond = Plan.model_validate({**QUICK, "elevations_deg": [0, 120]})
    for wanted, why, error in (
        ({"unit": " A"}, "serial number", Invalid),
        ({"rig": "bench-9"}, "no bench has a rig 'bench-9'; there are: bench-1", Unknown),
        ({"plan": beyond}, "120", Invalid),
        ({"plan": Plan(kind="verification")}, "no calibration in force to verify", Conflict),
    ):
        with pytest.raises(error, match=why):
            centre.start(**{"unit": "A", "plan": plan, **wanted})
    bench.beat(ago_s=3600)
    with pytest.raises(Conflict, match=r"bench hall-2 was last seen 3[67]\d\d s ago"):
        centre.start(unit="A", plan=plan)

    assert centre.store.runs.page() == ([], None)
    assert bench.orders() == []
    assert centre.start(unit="A", plan=plan, queue=True).status == "queued"


def test_a_run_that_its_bench_holds_back_says_so_and_is_ordered_anew_by_a_person(
    centre: CentreService, bench: TableBench, plan: Plan
):
    run_id = centre.start(unit="A", plan=plan).id
    with pytest.raises(Conflict, match="is queued and cannot be resumed"):
        centre.resume(run_id)
    bench.hold(run_id)
    wait_for(lambda: centre.run(run_id).error == HELD, "word of it")
    assert [event.data["status"] for event in centre.store.events.after(run_id)] == ["queued"]

    run = centre.resume(run_id)

    assert (run.status, run.error) == ("queued", None)
    order = bench.order(run_id)
    assert (order.epoch, order.held_epoch, order.wish) == (2, 1, "begin")
    assert bench.take(run_id, 1) is None
    assert bench.take(run_id, 2) == "begin"


def test_a_bench_that_takes_no_orders_is_shown_and_given_none_but_such_as_wait(
    centre: CentreService, bench: TableBench, plan: Plan
):
    bench.versions = {**versions_here(), "schema_revision": "0017"}
    bench.beat()
    with serving(centre) as client:
        (listed,), (shown,) = client.get("/api/benches").json(), client.get("/api/benches/overview").json()
        assert "too old" in listed["refused"] and "too old" in shown["refused"]
        assert listed["schema_revision"] == "0017"
        with pytest.raises(Conflict, match="bench hall-2 takes no orders: its calrig is too old"):
            centre.start(unit="A", plan=plan)
        run_id = centre.start(unit="A", plan=plan, queue=True).id
        wait_for(lambda: "too old" in (centre.run(run_id).error or ""), "reason")
        bench.versions = versions_here()
        bench.beat()
        wait_for(lambda: centre.run(run_id).error is None, "end of it")


def test_a_centre_writes_nothing_into_tables_that_a_newer_one_has_changed_meanwhile(
    centre: CentreService, bench: TableBench, plan: Plan, url: str
):
    engine = create_engine(url)
    with engine.begin() as newer:
        newer.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    engine.dispose()
    with serving(centre) as client:
        refused = client.post("/api/runs", json={"unit": "A", "plan": plan.model_dump(mode="json")})
        assert refused.status_code == 503
        assert "another calrig changed the tables meanwhile (revision 9999" in refused.json()["detail"]
        assert client.get("/api/runs").json()["items"] == []


def test_a_second_bench_with_a_rig_of_the_name_is_refused_and_keeps_the_first_one_from_nothing(
    centre: CentreService, bench: TableBench, plan: Plan, url: str
):
    with closing(TableBench(url, "hall-1")):  # by its name the first one
        assert [(one.name, one.refused is None) for one in centre.store.benches.all()] == [
            ("hall-1", False),
            ("hall-2", True),
        ]
        assert bench.order(centre.start(unit="A", plan=plan).id).bench == "hall-2"


def test_a_run_that_its_bench_holds_back_is_aborted_without_it(
    centre: CentreService, bench: TableBench, plan: Plan
):
    run_id = centre.start(unit="A", plan=plan).id
    bench.hold(run_id)
    bench.beat(ago_s=40)
    assert centre.abort(run_id).status == "aborted"


def _interrupted(centre: CentreService, bench: TableBench, measured: Measured) -> str:
    """A run of the bench that was interrupted after some poses."""
    parcels = measured.parcels[:2]
    document, _ = parcels[-1]
    reason = "the program that carried it out ended before the run did"
    last = document["events"][-1]
    state = {"status": "interrupted", "error": reason}
    end = {**last, "seq": last["seq"] + 1, "type": "state", "data": state}
    bench.deliver(measured.run.id, [*parcels, ({**document, "events": [end], "poses": []}, None)])
    wait_for(
        lambda: (run := centre.store.runs.get(measured.run.id)) and run.status == "interrupted",
        "interruption",
    )
    return measured.run.id


def test_an_interrupted_run_is_taken_up_by_a_new_order(
    centre: CentreService, bench: TableBench, measured: Measured, plan: Plan
):
    run_id = _interrupted(centre, bench, measured)
    assert centre.run(run_id).error == "the program that carried it out ended before the run did"

    assert centre.resume(run_id).status == "queued"

    order = bench.order(run_id)
    assert (order.epoch, order.wish, order.taken_epoch) == (2, "resume", 1)
    with pytest.raises(Refused, match="busy"):
        centre.start(unit="B", plan=plan)
    assert bench.take(run_id, 1) is None  # an old message
    assert bench.take(run_id, 2) == "resume"


def test_a_resumption_takes_along_where_its_stage_stands(
    centre: CentreService, bench: TableBench, measured: Measured
):
    run_id = _interrupted(centre, bench, measured)
    with pytest.raises(Invalid, match="has homing"):
        centre.resume(run_id, 12.5)
    known = centre.run(run_id).provenance
    centre.store.runs.update(run_id, provenance={**known, "stage": {**known["stage"], "homes": False}})
    centre.resume(run_id, 12.5)
    assert bench.order(run_id).document["stage_at_deg"] == 12.5
    centre.store.orders.withdraw(run_id)
    centre.store.orders.settle_withdrawn(None)
    centre.resume(run_id)
    assert bench.order(run_id).document["stage_at_deg"] is None, "what was said before does not count"


def test_a_resumption_that_was_not_taken_is_taken_back_and_the_bench_ends_the_run(
    patient_centre: CentreService, bench: TableBench, measured: Measured
):
    centre = patient_centre
    run_id = _interrupted(centre, bench, measured)
    centre.resume(run_id)

    with pytest.raises(Conflict, match="cannot be told"):
        centre.abort(run_id)

    run = centre.run(run_id)
    assert (run.status, run.error) == (
        "interrupted",
        "the program that carried it out ended before the run did",
    )
    assert bench.take(run_id, 3) is None


def test_a_run_of_a_bench_that_was_revoked_can_be_ended(centre: CentreService, bench: TableBench, plan: Plan):
    run_id = centre.start(unit="A", plan=plan).id
    bench.take(run_id, 1)
    bench.is_gone()

    run = centre.abort(run_id)

    assert (run.status, run.error) == ("aborted", "its bench was revoked")
    assert centre.rigs() == []
