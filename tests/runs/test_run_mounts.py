"""A run of several mounts: it waits for the unit to be turned, looks at gravity, and goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from run_rigs import TruthRig, begin, events, pass_time, plan, states, until

from calrig.analysis.errors import Conflict
from calrig.analysis.solutions import SolutionRequest, question
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve
from calrig.estimation.angles import wrap_deg
from calrig.model.run import Mount
from calrig.runs.service import RunService
from calrig.store import Run, Store

MakeRig = Callable[..., TruthRig]
Serve = Callable[..., RunService]
THREE = plan(elevations_deg=[-40, 20], sweeps=1, settle_s=0.3, dwell_s=0.3, mounts_deg=[0, 120, 240])
HAND: dict[str, Any] = {"mount": {"seat_std_deg": 0.3}}


def clamp(bench: TruthRig, mount_deg: float, axis: str = "x") -> None:
    """Turns the unit by hand."""
    with bench.simulated.bench.lock:
        until_s = bench.simulated.bench.clamp(bench.now_s, mount_deg, axis)
    pass_time(bench, until_s - bench.now_s + 0.5)


def waits(service: RunService, run: Run, mount_deg: float, axis: str = "x") -> None:
    """Until the run waits for that mount."""
    asked = {"mount_deg": mount_deg, "mount_axis": axis}
    until(lambda: service.run(run.id).progress.waiting_for == Mount(**asked), f"mount {mount_deg}", 60)
    assert service.run(run.id).status == "paused"


def all_mounts(bench: TruthRig, service: RunService, run: Run, mounts_deg: list[float], axis: str) -> Run:
    for mount_deg in mounts_deg:
        waits(service, run, mount_deg, axis)
        clamp(bench, mount_deg, axis)
        service.resume(run.id)
    return service.wait(run.id, 60)


@pytest.fixture(scope="module")
def finished(request: pytest.FixtureRequest, store: Store) -> Iterator[tuple[TruthRig, Run]]:
    """A run of three mounts, turned by hand, on a stage that is off by 0.29° in four orders."""
    waves = [(1, 0.3, 40), (2, 0.2, 200), (4, 0.12, 10), (5, 0.08, 90)]
    harmonics = [{"order": k, "amplitude_deg": a, "phase_deg": p} for k, a, p in waves]
    options = {**HAND, "mechanics": {"harmonics": harmonics}, "imu": {"accel_bias_mg": [0, 30, -20]}}
    bench = TruthRig("mapped", **options)
    both_ways = {"start_deg": -80, "stop_deg": 80, "step_deg": 32, "sweeps": 2}
    full = plan(elevations_deg=None, **both_ways, settle_s=0.3, dwell_s=0.4, mounts_deg=[0, 120, 240])
    with bench.simulated:
        service = RunService(store, [bench.settings])
        run = all_mounts(bench, service, begin(service, full, "AS-M"), [120, 240], "x")
        service.close()
        yield bench, run


def test_it_waits_for_each_mount_and_refuses_to_go_on_where_gravity_disagrees(
    make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    bench = make_rig(**HAND)
    service = serve(bench)
    run = begin(service, THREE)
    waits(service, run, 120)
    stood_deg, done = bench.table_deg(bench.now_s), len(store.poses.of(run.id))
    assert done == 2
    with pytest.raises(Conflict, match=r"clamped at \S*°, not 120°: turn it by a further 1[12]\d\.\d°"):
        service.resume(run.id)
    clamp(bench, 93)
    with pytest.raises(Conflict, match=r"at 9[2345]\.\d°, not 120°: turn it by a further 2[5678]\.\d°"):
        service.resume(run.id)
    clamp(bench, 120, "y")
    with pytest.raises(Conflict, match=r"unit's x does not lie along the stage's axis|clamped at"):
        service.resume(run.id)
    assert service.run(run.id).status == "paused"
    assert bench.table_deg(bench.now_s) == pytest.approx(stood_deg, abs=1e-3)
    clamp(bench, 118)
    assert service.resume(run.id).progress.waiting_for is None
    waits(service, run, 240)
    clamp(bench, -120)
    service.resume(run.id)
    ended = service.wait(run.id, 60)
    assert (ended.status, ended.error, ended.faults) == ("completed", None, {})
    assert states(store, run) == ["queued", "running", *["paused", "running"] * 2, "completed"]
    told = [event.data["waiting_for"] for event in events(store, run, "progress")]
    asked = [{"mount_deg": mount, "mount_axis": "x"} for mount in (120, 240)]
    assert [one for one in told if one] == asked and ended.progress.waiting_for is None
    poses = [stored.pose for stored in store.poses.of(run.id)]
    assert [pose.mount_deg for pose in poses] == [0, 0, 120, 120, 240, 240]
    assert [pose.sweep for pose in poses] == [0, 0, 1, 1, 2, 2]
    assert [pose.target_deg for pose in poses] == [-40, 20] * 3
    assert all(abs(wrap_deg(pose.reading_deg - pose.theta_deg)) < 5.0 for pose in poses)


@pytest.mark.statistical
def test_its_result_is_of_the_first_mount_and_all_of_them_solve_the_stage(
    finished: tuple[TruthRig, Run], store: Store
) -> None:
    _, run = finished
    assert run.status == "completed", run.error
    assert run.result is not None and run.result.n_poses == 12
    assert abs(run.result.scale - 1.0) < 0.02
    solution = solve(question(store, SolutionRequest([run.id])).lots)
    document = solution_document(solution)
    assert document["separable"]
    assert [mount["mount_deg"] for mount in document["mounts"]] == [0, 120, 240]
    unit = document["units"][0]["parameters"]
    for name, true_mg in (("y_mg", 30.0), ("z_mg", -20.0)):
        assert abs(unit[name]["value"] - true_mg) < 5.0 * unit[name]["std"] < 5.0
    (kept,) = store.revisions.of("AS-M")
    first_deg = [one.pose.target_deg for one in store.poses.of(run.id) if one.pose.mount_deg == 0.0]
    assert len(set(first_deg)) > 3, "jittered, as a plan of several mounts is unless it states otherwise"
    assert kept.document["range_deg"] == pytest.approx([min(first_deg), max(first_deg)], abs=0.01)


@pytest.mark.parametrize("at", ["between mounts", "within a mount"])
def test_a_run_that_was_interrupted_goes_on_at_the_mount_it_was_at(
    at: str, make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    bench = make_rig(**HAND)
    service = serve(bench)
    run = begin(service, THREE)
    waits(service, run, 120)
    if at == "within a mount":
        clamp(bench, 120)
        service.resume(run.id)
        until(lambda: store.poses.count(run.id) > 2, "pose", 60)
    service.close()
    assert service.run(run.id).status == "interrupted"
    again = serve(bench)
    if at == "between mounts":
        clamp(bench, 240)  # somebody was at it meanwhile, and wrongly
        again.resume(run.id)
        waits(again, run, 120)
        with pytest.raises(Conflict, match="turn it back by"):
            again.resume(run.id)
        clamp(bench, 120)
    again.resume(run.id)
    waits(again, run, 240)
    again.abort(run.id)
    ended = again.run(run.id)
    assert (ended.status, ended.progress.waiting_for) == ("aborted", None)
    assert [stored.pose.mount_deg for stored in store.poses.of(run.id)] == [0, 0, 120, 120]
    assert ("measured_again" in ended.provenance["interruptions"][0]) == (at == "within a mount")


@pytest.mark.parametrize(("axis", "first"), [("-x", 30.0), ("y", 60.0)])
def test_other_faces_are_asked_for_at_once_and_read_about_their_own_axis(
    axis: str, first: float, make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    bench = make_rig(**HAND)
    service = serve(bench)
    mounts_deg = [first, first + 180.0]
    run = begin(service, THREE.model_copy(update={"mounts_deg": mounts_deg, "mount_axis": axis}))
    assert run.progress.poses_total == 4
    ended = all_mounts(bench, service, run, mounts_deg, axis)
    assert (ended.status, ended.result, ended.faults) == ("completed", None, {}), ended.error
    sense = -1 if axis.startswith("-") else 1
    for stored in store.poses.of(run.id):
        pose = stored.pose
        assert abs(wrap_deg(pose.reading_deg - sense * pose.theta_deg)) < 3.0
        along_g = {"x": pose.accel_x_g, "y": pose.accel_y_g, "z": pose.accel_z_g}[axis[-1]]
        assert abs(along_g or 0.0) < 0.03


def test_nobody_is_asked_for_a_first_mount_that_gravity_agrees_with(
    make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    bench = make_rig(mount={"clamped_deg": 120.0})
    service = serve(bench)
    run = begin(service, plan(mounts_deg=[120]))
    ended = service.wait(run.id, 60)
    assert ended.status == "completed" and "paused" not in states(store, run)
    assert ended.result is not None
    assert ended.result.bias_deg == pytest.approx(0.8, abs=0.1)
    assert store.revisions.of(run.unit)[0].document["range_deg"] == pytest.approx([90, 150], abs=0.01)


def test_the_rigs_own_clamp_turns_the_unit_for_who_asks_while_the_run_waits(
    make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    bench, bare = make_rig("headed", clamp={}), make_rig("bare")
    service = serve(bench, bare)
    with pytest.raises(Conflict, match=r"no clamp of its own"):
        service.begin_clamp("bare", 120, "x")
    run = begin(service, THREE.model_copy(update={"mounts_deg": [0, 120]}), rig="headed")
    with pytest.raises(Conflict, match=r"does not wait for the unit to be turned"):
        service.begin_clamp("headed", 120, "x")
    waits(service, run, 120)
    turning = service.begin_clamp("headed", 120, "x")
    with pytest.raises(Conflict, match=r"already"):
        service.begin_clamp("headed", 120, "x")
    assert turning.result().clamp == "index"
    service.resume(run.id)
    assert service.wait(run.id, 60).status == "completed"
    bench.simulated.clamp_wire.stop()
    with pytest.raises(Conflict, match=r"clamp"):
        service.begin_clamp("headed", 0, "x").result()
