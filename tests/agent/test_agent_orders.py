"""Orders of a centre: each is carried out once, or not at all, and what became of it is always said."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from a_bench import ENDLESS, HandWritten, Rig, agent_at
from support import QUICK, wait_for

from calrig.agent import orders
from calrig.agent.link import LEASE_S
from calrig.analysis.calibration_in_force import ActiveCalibration
from calrig.analysis.stored_runs import AmbiguousRuns
from calrig.calibration.line import Line
from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.regression.request import AS_USUAL
from calrig.calibration.uncertainty.budget import ReferenceFigures
from calrig.plan import Plan
from calrig.runs.assignment import NewRun, order_part, ordered_run
from calrig.runs.follow_up import FollowUpRun
from calrig.settings import BoardSettings, RigSettings, StageSettings
from calrig.store import Store
from calrig.store.benches import versions_here


def test_an_ordered_run_is_carried_out_once_and_delivered_in_order(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = centre.order()
        told = centre.ended(run_id)
        run, store = agent.service.run(run_id), agent.service.store
        assert (run.status, run.operator, run.unit) == ("completed", "mara", "AS-1")
        assert [event["seq"] for event in told.events] == list(range(1, len(store.events.after(run_id)) + 1))
        assert told.states == ["queued", "running", "completed"]
        assert told.poses == list(range(6))
        assert told.n_samples == len(store.samples.of(run_id))
        assert told.documents[-1]["run"]["result"]["bias_deg"] == pytest.approx(run.result.bias_deg)
        assert store.revisions.of("AS-1") == []  # which only the centre makes
        wait_for(lambda: store.spool.undelivered() == [], "note that all is delivered")
        assert store.spool.outbox().n_parcels == 0


def test_a_run_that_has_ended_at_the_centre_is_there_with_all_its_samples(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order()
        *before, last = centre.ended(run_id).documents
    assert [event["type"] for event in last["events"]] == ["state"]
    assert {document["run"]["status"] for document in before} <= {"queued", "running"}
    assert all(document["run"]["progress"]["poses_done"] <= 6 for document in before)


def test_an_order_is_told_of_and_nobody_waits_for_the_next_look(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orders, "LOOK_S", 1e6)
    with agent_at(centre.bench_url, spool, rig):
        for unit in ("AS-1", "AS-2"):
            assert centre.ended(centre.order(unit=unit)).status == "completed"


def test_an_order_that_nobody_heard_of_is_found_once_the_bench_listens_again(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orders, "LOOK_S", 1e6)
    with agent_at(centre.bench_url, spool, rig):
        assert centre.ended(centre.order()).status == "completed"
        centre.connection.execute(
            "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity WHERE datname = current_database() "
            "AND pid <> pg_backend_pid() AND query LIKE '%UPDATE bench_command SET taken_at%'"
        )
        assert centre.ended(centre.order(unit="AS-2")).status == "completed"


def test_news_that_comes_twice_carries_nothing_out_twice(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = centre.order()
        first = centre.ended(run_id)
        centre.tell()
        centre.order(unit="AS-2", rig="bench-1")
        wait_for(lambda: len(agent.service.store.runs.page()[0]) == 2, "next run")
        assert centre.delivered(run_id).events == first.events


@pytest.mark.parametrize(
    "columns", [{"epoch": 2, "wish": "none"}, {"epoch": 1, "taken_epoch": 1, "wish": "none"}]
)
def test_an_order_that_counts_no_more_moves_nothing(
    centre: HandWritten, rig: Rig, spool: Path, columns: dict[str, object]
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = centre.order(**columns)
        centre.order(unit="AS-2")  # what comes after it does
        wait_for(lambda: agent.service.store.runs.page()[0], "run")
        assert [run.unit for run in agent.service.store.runs.page()[0]] == ["AS-2"]
    assert centre.taken_epoch(run_id) == columns.get("taken_epoch", 0)


def test_an_order_taken_back_before_it_is_taken_moves_nothing(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = orders.take

    def too_late(of, order):
        with monkeypatch.context() as once:
            once.setattr(orders, "take", take)
            centre.connection.execute("UPDATE run_order SET epoch = epoch + 1, wish = 'none'")
            return take(of, order)

    monkeypatch.setattr(orders, "take", too_late)
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = centre.order()
        wait_for(lambda: centre._one("SELECT epoch FROM run_order") > 1, "withdrawal")
        wait_for(lambda: agent.service.crew.is_free("bench-1"), "rig that is kept no longer")
        assert agent.service.store.runs.get(run_id) is None
    assert centre.taken_epoch(run_id) == 0
    assert not rig.has_moved()


def test_runs_of_one_rig_wait_for_one_another(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        ordered = [centre.order(unit=f"AS-{k}") for k in range(3)]
        for run_id in ordered:
            assert centre.ended(run_id).status == "completed"
        runs = [agent.service.run(run_id) for run_id in ordered]
    for before, after in pairwise(runs):
        assert before.finished_at <= after.started_at


class Killed(BaseException):
    """The program ends here."""


def test_killed_between_taking_and_spool_the_run_is_interrupted_and_moves_nothing(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as at_this_point:
        at_this_point.setattr(orders.RigOrders, "_begin", killed)
        at_this_point.setattr("threading.excepthook", lambda _: None)
        with agent_at(centre.bench_url, spool, rig):
            run_id = centre.order()
            wait_for(lambda: centre.taken_epoch(run_id) == 1, "taking")
    with agent_at(centre.bench_url, spool, rig) as agent:
        told = centre.ended(run_id)
        assert told.states == ["queued", "interrupted"]
        assert "nothing is done twice" in told.events[-1]["data"]["error"]
        assert not rig.has_moved()
        centre.connection.execute("UPDATE run_order SET epoch = 2, wish = 'resume'")
        wait_for(lambda: agent.service.run(run_id).status == "completed", "end of the resumed run")
        done = wait_for(lambda: (d := centre.delivered(run_id)).status == "completed" and d, "delivery")
    assert done.states == ["queued", "interrupted", "queued", "running", "completed"]
    assert done.poses == list(range(6))


def test_killed_before_a_resumption_has_begun_the_run_stays_interrupted_and_says_so(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = centre.order(plan=ENDLESS)
        wait_for(lambda: centre.delivered(run_id).poses, "poses")
    assert centre.ended(run_id).status == "interrupted"  # it was told to go in order
    with monkeypatch.context() as at_this_point:
        at_this_point.setattr("threading.excepthook", lambda _: None)
        at_this_point.setattr("calrig.runs.service.RunService.resume", _raise_killed)
        with agent_at(centre.bench_url, spool, rig):
            centre.connection.execute("UPDATE run_order SET epoch = 2, wish = 'resume'")
            wait_for(lambda: centre.taken_epoch(run_id) == 2, "taking")
    with agent_at(centre.bench_url, spool, rig) as agent:
        wait_for(lambda: centre.delivered(run_id).states[-2:] == ["interrupted"] * 2, "word of it")
        assert agent.service.run(run_id).status == "interrupted"


def _raise_killed(*_: object) -> None:
    raise Killed


def test_an_order_beyond_the_rigs_limits_fails_and_says_why(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order(plan={**QUICK, "elevations_deg": [-100, 0]})
        told = centre.ended(run_id)
    assert told.status == "failed"
    assert "-100" in told.events[-1]["data"]["error"]
    assert not rig.has_moved()


def test_without_the_lease_nothing_is_taken_and_the_person_at_the_bench_starts_runs(
    centre: HandWritten, rig: Rig, spool: Path, cable
) -> None:
    now_s = [0.0]
    with agent_at(cable.url, spool, rig, now_s=lambda: now_s[0]) as agent:
        wait_for(agent.lease.is_held, "lease")
        cable.cut()
        now_s[0] += LEASE_S
        wait_for(lambda: agent.lease.losses == 1, "loss")
        run_id = centre.order()
        own = agent.service.start(unit="AS-9", plan=Plan.model_validate(QUICK))
        assert agent.service.wait(own.id).status == "completed"
        cable.mend()
        told = centre.ended(own.id)
        wait_for(lambda: centre.held_epoch(run_id), "order that is held back")
        assert centre.ended(centre.order(unit="AS-2")).status == "completed"
        assert centre.taken_epoch(run_id) == 0
    assert (told.states, told.documents[0]["epoch"]) == (["queued", "running", "completed"], 1)


def test_what_was_ordered_before_the_agent_began_waits_until_it_is_ordered_anew(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    run_id = centre.order()
    with agent_at(centre.bench_url, spool, rig) as agent:
        assert centre.held_epoch(run_id) == 1
        assert centre.ended(centre.order(unit="AS-2")).status == "completed"  # which came after it
        assert agent.service.store.runs.get(run_id) is None
        centre.connection.execute("UPDATE run_order SET epoch = 2 WHERE run_uid = %s", (run_id,))
        assert centre.ended(run_id).status == "completed"


@pytest.mark.parametrize("other", [{"protocol": 2}, {"schema_revision": "0017"}, {"schema_revision": "9999"}])
def test_an_agent_of_another_version_takes_no_orders_delivers_and_can_be_stopped(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch, other: dict[str, int | str]
) -> None:
    monkeypatch.setattr("calrig.agent.agent.versions_here", lambda: {**versions_here(), **other})
    with agent_at(centre.bench_url, spool, rig, is_accepted=False) as agent:
        wait_for(lambda: centre._one("SELECT refused FROM bench"), "refusal")
        run_id = centre.order()
        own = agent.service.start(unit="AS-9", plan=Plan.model_validate(ENDLESS))
        wait_for(lambda: centre.delivered(own.id).poses, "poses")
        stop = centre.command("stop", rig="bench-1")
        assert wait_for(lambda: centre.answer(stop), "answer")["status"] == 200
        assert centre.ended(own.id).status == "aborted"
        assert (agent.lease.is_held(), centre.taken_epoch(run_id)) == (False, 0)


def test_an_agent_at_an_older_centre_takes_no_orders_and_can_be_stopped(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    before = """
        DROP TRIGGER calrig_judge ON bench;
        DROP POLICY calrig_accepted ON run_order;
        ALTER TABLE bench DROP COLUMN refused, DROP COLUMN bears;
        ALTER TABLE run_order DROP COLUMN held_epoch;
    """
    centre.connection.execute(before)
    with agent_at(centre.bench_url, spool, rig, is_accepted=False) as agent:
        wait_for(lambda: centre.said().get("rigs"), "heartbeat")
        run_id = centre.order()
        stop = centre.command("stop", rig="bench-1")
        assert wait_for(lambda: centre.answer(stop), "answer")["status"] == 200
        assert (agent.lease.is_held(), centre.taken_epoch(run_id)) == (False, 0)


def test_an_order_waits_while_its_run_could_not_be_kept_and_a_stop_does_not(
    centre: HandWritten, rig: Rig, small_disk: Path
) -> None:
    with agent_at(centre.bench_url, small_disk / "spool.db", rig) as agent:
        ballast = small_disk / "ballast"
        ballast.write_bytes(bytes(room_bytes(small_disk) - 200_000))
        run_id = centre.order()
        why = wait_for(lambda: centre.said().get("trouble"), "word of it")
        assert "the disk is full" in why
        stop = centre.command("stop", rig="bench-1")
        assert wait_for(lambda: centre.answer(stop), "answer")["status"] == 200
        assert centre.taken_epoch(run_id) == 0
        ballast.unlink()
        assert centre.ended(run_id).status == "completed"
        wait_for(lambda: centre.said().get("trouble") is None, "word of it")
        assert agent.service.store.spool.taken_epochs() == {run_id: 1}


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Sixteen megabytes of a real file system."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ("mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", folder)
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no file system can be mounted here: run as root")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def room_bytes(folder: Path) -> int:
    return shutil.disk_usage(folder).free


def test_a_stop_calls_off_what_is_about_to_begin(rig: Rig, spool: Path, centre: HandWritten) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        service = agent.service
        from calrig.runs.assignment import ordered_run

        document = {
            "unit": "AS-1",
            "plan": Plan.model_validate(QUICK).model_dump(mode="json"),
            "operator": None,
            "note": None,
            "provenance": {},
        }
        run_id = "00000000-0000-4000-8000-000000000001"
        with service.crew.keeping("bench-1", run_id) as is_free:
            assert is_free
            service.stop("bench-1")
            run = service.begin(rig.settings, ordered_run(run_id, document, rig.settings))
        assert service.wait(run.id).status == "aborted"
    assert not rig.has_moved()


def test_a_spool_that_was_lost_leaves_what_the_centre_has(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order()
        told = centre.ended(run_id)
    with agent_at(centre.bench_url, spool.with_name("new.db"), rig):
        wait_for(lambda: len(centre.delivered(run_id).documents) > len(told.documents), "word of the doubt")
    again = centre.delivered(run_id).events[len(told.events) :]
    assert all(event["seq"] <= len(told.events) for event in again)  # the centre has those, and skips them


def test_the_spool_is_an_ordinary_store(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order()
        centre.ended(run_id)
    with Store.open(f"sqlite:///{spool}", writer=None) as store:
        assert store.runs.get(run_id).status == "completed"
        assert store.spool.taken_epochs() == {run_id: 1}


RIG = RigSettings(
    name="bench-1", stage=StageSettings(driver="smc100", port=""), imu=BoardSettings(driver="calrig", port="")
)
RUN_ID = "00000000-0000-4000-8000-000000000001"


def ordered(plan: Plan, **part: object):
    """The run as the bench reads it."""
    wanted = NewRun(unit="AS-1", plan=plan, operator="mara", **part)
    document = {**wanted.columns(len(plan.elevations())), **order_part(wanted)}
    return ordered_run(RUN_ID, json.loads(json.dumps(document)), RIG)


def test_a_verification_applies_the_same_line_effects_and_reference() -> None:
    verifies = ActiveCalibration(
        revision=3,
        run_id="17",
        line=Line(0.8, 1.01, 0.001, 2e-5, ((1e-6, 0.0), (0.0, 4e-10)), None),
        effects=[("misalignment", {"tilt_deg": 0.1}), ("backlash", {"play_deg": 0.03})],
        reference=ReferenceFigures(std_deg=0.29, kind="harmonic", bias_std_deg=0.1, scale_std=None),
        of_rig=[("backlash", {"backlash_deg": 0.1})],
    )
    run = ordered(Plan.model_validate({**QUICK, "kind": "verification"}), verifies=verifies)
    assert run.verifies == verifies
    assert (run.run_id, run.unit, run.operator, run.follow_up) == (RUN_ID, "AS-1", "mara", None)


def test_a_follow_up_rests_on_the_same_poses_and_finds_the_same_in_them() -> None:
    rng = random.Random(3)
    poses = []
    for approach in (1, -1, 1, -1):
        for elevation_deg in range(-60 * approach, 61 * approach, 10 * approach):
            reading_deg = elevation_deg - approach * 0.03 + rng.gauss(0.0, 0.025)
            poses.append(
                Pose(
                    float(elevation_deg),
                    reading_deg,
                    approach=approach,
                    time_s=4.0 * len(poses),
                    filtering=Filtering(),
                )
            )
    earlier = AmbiguousRuns.of(["17"], [poses], AS_USUAL)
    plan = Plan.model_validate({**QUICK, "sweeps": 1})
    run = ordered(plan, follow_up=FollowUpRun(earlier, ["backlash", "settling"], 2, plan, RIG.limits_deg))
    assert run.follow_up is not None
    again = run.follow_up.earlier
    assert (again.run_ids, again.poses) == (earlier.run_ids, earlier.poses)
    assert str(again.findings.found) == str(earlier.findings.found)
    assert run.follow_up.provenance() == {
        "separates": ["backlash", "settling"],
        "deciding": 2,
        "decided_on": [],
        "decided_early": False,
        "reference": "stage",
    }


def test_a_persons_word_for_where_the_stage_stands_comes_through() -> None:
    assert ordered(Plan.model_validate(QUICK), stage_at_deg=12.5).stage_at_deg == 12.5
