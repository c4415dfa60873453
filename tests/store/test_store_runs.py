"""Runs, their states and events, what comparisons make of them, and how they are found."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from uuid import UUID

import pytest
from dated_runs import gave, lay
from sqlalchemy import create_engine, text

from calrig.calibration.poses import Pose
from calrig.model.run import Progress
from calrig.run_ids import new_run_id
from calrig.store import AcceptedEffect, NotFound, Store, StoreError
from calrig.store.errors import Refused
from calrig.store.raw_rows import TEXTS, tables
from calrig.store.runs import Sought

NOBODY = "00000000-0000-4000-8000-000000000000"
"""A UUID that no run has."""
PROGRESS = {"poses_done": 3, "poses_total": 52, "fraction": 3 / 52, "remaining_s": None}


def test_a_run_comes_back_as_it_was_made(store, new_run):
    made = new_run(
        unit="AS-0042",
        plan={"kind": "calibration", "seed": 2**63 - 1},
        provenance={"calrig": "0.1", "filter": {"q_angle": 0.001}},
        operator="Ä. Operator",
        note="with the new cable",
        poses_total=52,
        status="queued",
    )

    assert store.runs.get(made.id) == made
    assert made.plan == {"kind": "calibration", "seed": 2**63 - 1}
    assert made.progress == Progress.model_validate(
        {"poses_done": 0, "poses_total": 52, "fraction": 0.0, "remaining_s": None}
    )
    assert (made.result, made.diagnosis, made.voided, made.error, made.follows) == (None,) * 5
    assert made.faults == {}
    assert (made.started_at, made.finished_at) == (None, None)
    assert abs(datetime.now(UTC) - made.created_at) < timedelta(minutes=1)


@pytest.mark.parametrize(
    "run_id", ["7", "0", "-1", "x", "", "1.0", "9" * 40, "١", " 1", "1\n", "\udcff", "\0", NOBODY]
)
def test_an_unknown_run_is_none_and_cannot_be_changed(store, new_run, run_id):
    new_run()
    assert store.runs.get(run_id) is None
    with pytest.raises(NotFound, match="there is no run"):
        store.runs.update(run_id, status="running")


def test_a_bench_mints_the_id_of_a_run_that_begins_there(store, new_run):
    run_id = new_run_id()
    assert new_run(run_id=run_id).id == run_id
    assert store.runs.get(run_id).id == run_id
    with pytest.raises(Refused, match=f"there is a run {run_id} already"):
        new_run(unit="B", run_id=run_id)
    assert store.units.get("B") is None
    for no_uuid in ("17", "", run_id.upper(), run_id.replace("-", "")):
        with pytest.raises(ValueError, match="is not a UUID"):
            new_run(run_id=no_uuid)


def test_elsewhere_the_store_mints_a_random_uuid(new_run):
    ids = {new_run().id for _ in range(20)}
    assert len(ids) == 20
    assert {UUID(run_id).version for run_id in ids} == {4}


def test_ids_are_found_by_how_they_begin(store, new_run):
    first, second, other = (
        f"{begin}-0000-4000-8000-000000000000" for begin in ("0123abcd", "0123abce", "f" * 8)
    )
    for run_id in (second, other, first):
        new_run(run_id=run_id)
    assert store.runs.ids_beginning("0123ab", 9) == [first, second]
    assert store.runs.ids_beginning("0123ab", 1) == [first]
    assert store.runs.ids_beginning("0123abcd-", 9) == [first]
    assert store.runs.ids_beginning("%", 9) == store.runs.ids_beginning("_123ab", 9) == []


def test_each_change_of_state_is_announced_with_it(store, new_run):
    run = new_run(status="queued")
    started = store.runs.update(run.id, status="running")
    store.runs.update(run.id, status="paused")
    store.runs.update(run.id, faults={"crc": 2})  # no state, no event
    failed = store.runs.update(
        run.id,
        status="failed",
        error="bench: the stage stalled",
        events=[("progress", PROGRESS)],
        progress=PROGRESS,
    )

    events = store.events.after(run.id)
    assert [e.seq for e in events] == [1, 2, 3, 4, 5]
    assert [e.data["status"] for e in events if e.type == "state"] == [
        "queued",
        "running",
        "paused",
        "failed",
    ]
    assert events[-1].data == {"status": "failed", "error": "bench: the stage stalled"}
    assert events[-2].type == "progress", "the terminal state comes last"
    assert started.started_at is not None and started.finished_at is None
    assert failed.started_at == started.started_at and failed.finished_at >= failed.started_at
    assert failed.faults == {"crc": 2}
    assert failed.progress == Progress.model_validate(PROGRESS)


def test_a_resumed_run_keeps_when_it_began_and_is_not_finished(store, new_run):
    run = new_run()
    store.runs.update(run.id, status="interrupted", error="the program died")
    resumed = store.runs.update(run.id, status="running", error=None)
    assert (resumed.started_at, resumed.finished_at, resumed.error) == (run.started_at, None, None)


def test_events_are_given_after_a_number_and_in_pieces(store, new_run):
    run, other = new_run(), new_run()
    store.events.append(other.id, [("reading", {"reading_deg": 9.0})])
    numbers = store.events.append(run.id, [("reading", {"reading_deg": float(k)}) for k in range(5)])

    assert numbers == [2, 3, 4, 5, 6]
    assert [e.seq for e in store.events.after(run.id, 3)] == [4, 5, 6]
    assert [e.data["reading_deg"] for e in store.events.after(run.id, 3, limit=2)] == [2.0, 3.0]
    assert store.events.after(run.id, 6) == []
    assert store.events.append(run.id, []) == []


def test_a_document_with_a_nan_is_refused_and_nothing_of_it_is_stored(store, new_run):
    run = new_run()
    with pytest.raises(ValueError, match="cannot be stored"):
        store.events.append(
            run.id, [("reading", {"reading_deg": 1.0}), ("reading", {"reading_deg": math.nan})]
        )
    assert [e.type for e in store.events.after(run.id)] == ["state"]


def test_runs_are_listed_newest_first_and_a_cursor_survives_new_runs(store, new_run):
    made = [new_run(unit="AB"[k % 2], rig="bench" if k < 4 else "oven").id for k in range(6)]

    first, cursor = store.runs.page(limit=4)
    new_run()
    second, end = store.runs.page(limit=4, cursor=cursor)

    assert [r.id for r in first + second] == made[::-1]
    assert end is None
    assert [r.id for r in store.runs.page(unit="B", rig="bench")[0]] == [made[3], made[1]]
    assert store.runs.page(status="failed") == ([], None)
    with pytest.raises(ValueError, match="cursor 'x'"):
        store.runs.page(cursor="x")
    with pytest.raises(ValueError, match="at least 1"):
        store.runs.page(limit=0)


def test_a_run_that_is_delivered_late_is_listed_by_when_it_was_made(store):
    yesterday, today, delivered = lay(store, *(("A", day, gave(), {}) for day in (1, 2, 0.5)))
    first, cursor = store.runs.page(limit=1)
    then, cursor = store.runs.page(limit=1, cursor=cursor)
    last, _ = store.runs.page(limit=1, cursor=cursor)
    assert [run.id for run in first + then + last] == [today, yesterday, delivered]
    with pytest.raises(ValueError, match="not one that this list gave"):
        store.runs.page(cursor=new_run_id())


def test_runs_of_one_moment_are_each_on_one_page(store):
    laid = lay(store, *(("A", 1, gave(), {}) for _ in range(5)))
    seen, cursor = store.runs.page(limit=2)
    while cursor is not None:
        page, cursor = store.runs.page(unit="A", limit=2, cursor=cursor)
        seen += page
    assert [run.id for run in seen] == laid[::-1]


def test_an_import_is_stored_at_once_or_not_at_all(store, new_run, result):
    run = new_run(status="completed", poses=[Pose(0.0, 0.1), Pose(10.0, 10.2)], result=result)
    assert [p.pose.reading_deg for p in store.poses.of(run.id)] == [0.1, 10.2]
    assert run.progress == Progress.model_validate(
        {"poses_done": 2, "poses_total": 2, "fraction": 1.0, "remaining_s": 0.0}
    )
    assert run.started_at == run.finished_at == run.created_at
    assert store.runs.latest_calibration("A").id == run.id

    with pytest.raises(StoreError):
        new_run(unit="B", status="completed", poses=[Pose(0.0, 0.1), Pose(1.0, math.nan)], result=result)
    assert store.units.get("B") is None
    assert len(store.runs.page()[0]) == 1


def test_a_follow_up_names_a_run_that_exists(store, new_run):
    first = new_run()
    assert new_run(follows=first.id).follows == first.id
    with pytest.raises(NotFound):
        new_run(follows="99")


def test_the_calibration_in_force_is_the_latest_that_counts(store, new_run, result):
    def finished(**given):
        plan = {"kind": given.pop("kind", "calibration")}
        status = given.pop("status", "completed")
        run = new_run(plan=plan)
        return store.runs.update(run.id, status=status, result={**result, **given})

    in_force = finished(kind="sweep")
    voided = finished()
    finished(scale=None, scale_std=None)
    finished(kind="static")
    finished(status="aborted")
    new_run()
    assert store.runs.latest_calibration("A").id == voided.id

    store.amendments.void(voided.id, "wrong fixture")

    assert store.runs.latest_calibration("A") == store.runs.get(in_force.id)
    assert store.runs.latest_calibration("B") is None
    assert store.runs.get(voided.id).voided.reason == "wrong fixture"
    assert store.runs.get(voided.id).result == voided.result, "a voided run is kept"


def test_a_comparison_holds_the_figures_of_completed_runs_by_unit_and_time(store, new_run, result):
    for unit in ("B", "A", "C"):
        for kind, bias in (("calibration", 0.1), ("sweep", 0.2)):
            run = new_run(unit=unit, plan={"kind": kind})
            store.runs.update(run.id, status="completed", result={**result, "bias_deg": bias})
    store.amendments.void(run.id, "dropped")
    new_run(unit="A")

    rows = store.units.comparison()
    assert [(r.unit, r.result["bias_deg"]) for r in rows] == [
        ("A", 0.1),
        ("A", 0.2),
        ("B", 0.1),
        ("B", 0.2),
        ("C", 0.1),
    ]
    assert [r.unit for r in store.units.comparison(["B", "unheard of"])] == ["B", "B"]
    row = rows[0]
    same = ("bias_std_deg", "scale", "scale_std", "rms_raw_deg", "rms_calibrated_deg", "temperature_c")
    assert row.result == {
        "bias_deg": 0.1,
        "rms_with_effects_deg": None,
        **{name: result[name] for name in same},
    }
    assert row.finished_at == store.runs.get(row.run_id).finished_at


def test_a_new_result_replaces_the_figures_and_none_removes_them(store, new_run, result):
    run = new_run()
    store.runs.update(run.id, status="completed", result=result)
    store.runs.update(run.id, result={**result, "bias_deg": 0.5})
    assert [r.result["bias_deg"] for r in store.units.comparison()] == [0.5]
    assert store.runs.get(run.id).result.bias_deg == 0.5

    store.runs.update(run.id, result=None)
    assert store.units.comparison() == []
    assert store.runs.get(run.id).result is None


def test_what_a_stage_is_worth_is_told_of_the_runs_that_know_it(store, new_run, result):
    stated = {"std_deg": 0.01, "bias_std_deg": 0.1 + 0.2, "scale_std": None}
    one, without, before, none = (
        new_run(result=given)
        for given in ({**result, "reference": stated}, {**result, "reference": None}, result, None)
    )
    found = store.runs.reference_figures([run.id for run in (one, without, before, none)])
    assert found == {one.id: (0.1 + 0.2, None)}, "as it was stored, to the last bit"


def test_units_know_their_runs(store, new_run):
    new_run(unit="B")
    last = new_run(unit="B")
    new_run(unit="A")
    a, b = store.units.all()
    assert (a.serial, a.n_runs, b.serial, b.n_runs) == ("A", 1, "B", 2)
    assert b.last_run_at == last.created_at
    assert store.units.get("B") == b
    assert store.units.get("C") is None


def test_what_a_dead_program_left_unfinished_is_found(url):
    with Store.open(url, writer="serve") as store:
        ids = {
            status: store.runs.create(unit="A", rig="r", plan=None, status=status, provenance={}).id
            for status in ("queued", "running", "paused", "completed", "failed", "interrupted")
        }
    with Store.open(url, writer="serve") as store:
        assert [run.id for run in store.runs.unfinished()] == [ids["queued"], ids["running"], ids["paused"]]


def test_effects_in_force_are_those_of_the_unit_and_of_its_rig_alone(store, new_run):
    run = new_run(unit="AS-1")
    of_unit = AcceptedEffect(run.id, "AS-1", None, "time_drift", "sensor", {"deg_per_s": 1e-4})
    of_rig = AcceptedEffect(run.id, None, "bench-1", "backlash", "stage", {"backlash_deg": 0.08})
    store.effects.accept(run.id, [of_unit, of_rig])
    assert store.effects.in_force("AS-1", "bench-1") == [of_unit, of_rig]
    assert store.effects.in_force("AS-2", "bench-1") == [of_rig]
    assert store.effects.in_force("AS-1", None) == [of_unit]


def test_an_error_accepted_as_the_units_is_not_the_rigs_as_well(store, new_run):
    run = new_run(unit="AS-1")
    wave = {"amplitude_deg": 1.0, "phase_deg": 0.0, "period_deg": 90.0}
    of_rig = AcceptedEffect(run.id, None, "bench-1", "stage_periodic", "stage", wave)
    of_unit = AcceptedEffect(run.id, "AS-1", None, "stage_periodic", "sensor", wave)
    store.effects.accept(run.id, [of_rig])
    store.effects.accept(run.id, [of_unit])
    assert store.effects.in_force("AS-1", "bench-1") == [of_unit]
    assert store.effects.in_force("AS-2", "bench-1") == [of_rig]


def test_several_of_one_name_are_in_force_together_and_one_given_twice_once(store, new_run):
    run = new_run(unit="AS-1")
    orders = [
        AcceptedEffect(run.id, "AS-1", None, "stage_periodic", "sensor", {"period_deg": 360.0 / order})
        for order in (2.0, 4.0, 4.0)
    ]
    store.effects.accept(run.id, orders)
    assert store.effects.in_force("AS-1", None) == orders[:2]


def test_where_a_stage_was_left_is_there_for_the_next_process(url):
    with Store.open(url, writer="run") as store:
        assert store.positions.of("bench") is None
        store.positions.save("bench", -60.5)
        store.positions.save("other", None)
    with Store.open(url, writer="serve") as store:
        assert store.positions.of("bench").stage_deg == -60.5
        assert store.positions.of("other").stage_deg is None
        store.positions.save("bench", None)
        assert store.positions.of("bench").stage_deg is None


@pytest.fixture
def runs(store):
    """Ids by the name of the run."""

    def make(name: str, **more):
        given = {"unit": name, "rig": "r", "plan": {"kind": "calibration"}, "status": "completed", **more}
        return store.runs.create(provenance={}, **given).id

    first = make("AS-0042", note="Gehäuse 100% dicht", plan={"kind": "verification"})
    return {
        "first": first,
        "second": make("as_0042"),
        "follow-up": make("B", follows=first),
        "static": make("C", plan={"kind": "static"}, rig="other"),
        "import": make("D", plan=None, rig=None),
    }


@pytest.mark.parametrize(
    ("sought", "names"),
    [
        (Sought(text="S-00"), ["first"]),
        (Sought(text="As"), ["second", "first"]),
        (Sought(text="s_0"), ["second"]),  # _ is text
        (Sought(text="0%"), ["first"]),  # and so is %
        (Sought(text="GEHÄUSE"), ["first"]),
        (Sought(text="as", rig="other"), []),
        (Sought(text="as", status="completed", kind="verification"), ["first"]),
        (Sought(kind="calibration"), ["second"]),
        (Sought(kind="static"), ["static"]),
        (Sought(kind="import"), ["import"]),
        (Sought(kind="follow-up"), ["follow-up"]),
    ],
)
def test_runs_are_found_by_what_they_say_and_are(store, runs, sought, names):
    found, cursor = store.runs.search(sought)
    assert ([run.id for run in found], cursor) == ([runs[name] for name in names], None)


def test_runs_are_found_by_when_they_were_made_and_by_what_they_follow(store, runs):
    second = store.runs.get(runs["second"]).created_at
    within = Sought(since=second, before=second + timedelta(microseconds=1))
    assert [run.id for run in store.runs.search(within)[0]] == [runs["second"]]
    assert [run.id for run in store.runs.search(Sought(before=second))[0]] == [runs["first"]]
    followed = store.runs.search(Sought(follows=runs["first"]))[0]
    assert [run.id for run in followed] == [runs["follow-up"]]


def test_what_is_sought_goes_on_page_by_page(store, runs):
    page, cursor = store.runs.search(Sought(text="as"), limit=1)
    rest, last = store.runs.search(Sought(text="as"), limit=1, cursor=cursor)
    assert ([run.id for run in (*page, *rest)], last) == ([runs["second"], runs["first"]], None)


SERIALS = ["B", "a-1", "A 2", "Ä-1", "A-1", "_1", "a1", "z", "é", "温度", "10", "9"]


def test_names_come_in_the_order_of_their_bytes(store: Store) -> None:
    for serial in SERIALS:
        store.runs.create(unit=serial, rig=serial, plan=None, status="completed", provenance={})
        store.check_standards.name(serial, serial, 7.0)
    in_order = sorted(SERIALS, key=str.encode)
    assert [unit.serial for unit in store.units.all()] == in_order
    assert [check.rig for check in store.check_standards.all()] == in_order


def test_no_text_is_ordered_by_a_language(new_database) -> None:
    """A server's databases are made for one, mostly; that of these tests is for none."""
    engine = create_engine(new_database())
    known = "SELECT table_name, column_name FROM information_schema.columns WHERE collation_name = 'C'"
    with engine.connect() as connection:
        by_bytes = {tuple(row) for row in connection.execute(text(known))}
    engine.dispose()
    ours = {(t.name, c.name) for t in tables() for c in t.columns if isinstance(c.type, TEXTS)}
    assert ours <= by_bytes
