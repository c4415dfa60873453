"""Poses and raw samples: stored together, back exactly, excluded but kept, pruned by age."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calrig.calibration.poses import Pose
from calrig.model.result import Result
from calrig.model.run import Progress
from calrig.store import NotFound, SampleBlock, Store, StoreError
from calrig.store.convert import joined_arrays, packed_arrays

FULL = Pose(
    target_deg=-60.0,
    reading_deg=-59.87654321012345,
    sweep=3,
    approach=-1,
    time_s=12.5,
    temperature_c=24.1,
    stage_deg=-60.01,
    reading_std_deg=0.05,
    reading_stderr_deg=0.01,
    n_samples=400,
    accel_x_g=0.001,
    accel_y_g=-0.866,
    accel_z_g=0.5,
    gyro_move_deg=-10.02,
    settle_s=1.0,
    covariates={"supply_v": 3.3, "humidity": None},
)


def block(index: int, phase: str, n: int = 3, first_s: float = 0.0) -> SampleBlock:
    rng = np.random.default_rng(index)
    return SampleBlock(
        index,
        phase,
        first_s + np.arange(n) / 200,
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)),
        np.full(n, 24.0),
    )


class Rows(list):
    """Poses of an import; each time some are asked for, something else happens."""

    def __init__(self, poses, meanwhile):
        super().__init__(poses)
        self.meanwhile = meanwhile

    def __getitem__(self, some):
        self.meanwhile()
        return super().__getitem__(some)


def test_a_run_stores_its_poses_while_an_import_is_read(store, new_run):
    run = new_run()
    others = []

    def measured():
        store.poses.add(run.id, len(others), replace(FULL, target_deg=float(len(others))))
        others.append(run.id)

    poses = [replace(FULL, target_deg=0.01 * k) for k in range(2500)]
    made = new_run(unit="B", status="completed", poses=Rows(poses, measured))
    assert [(stored.index, stored.pose) for stored in store.poses.of(made.id)] == list(enumerate(poses))
    assert [stored.index for stored in store.poses.of(run.id)] == list(range(len(others))) != []


def test_an_import_that_breaks_off_stores_nothing(store, new_run):
    calls = []

    def break_off():
        calls.append(None)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        new_run(unit="B", status="completed", poses=Rows([FULL] * 2500, break_off))
    assert store.runs.page() == ([], None)
    made = new_run(unit="B", status="completed", poses=[FULL])
    assert [stored.pose for stored in store.poses.of(made.id)] == [FULL]


def test_a_pose_comes_back_exactly(store, new_run):
    run = new_run()
    store.poses.add(run.id, 0, FULL)
    store.poses.add(run.id, 1, Pose(10.0, 9.9))
    assert [p.pose for p in store.poses.of(run.id)] == [FULL, Pose(10.0, 9.9)]


def test_a_pose_is_stored_with_its_events_and_samples_or_not_at_all(store, new_run):
    run = new_run(poses_total=2)
    progress = {"poses_done": 1, "poses_total": 2, "fraction": 0.5, "remaining_s": 3.0}
    events = [("pose", {"index": 0, **FULL.row()}), ("progress", progress)]
    blocks = [block(0, "move"), block(0, "dwell")]
    assert store.poses.add(run.id, 0, FULL, blocks, events, progress=progress, faults={"crc": 1}) == [2, 3]
    assert (store.runs.get(run.id).progress, store.runs.get(run.id).faults) == (
        Progress.model_validate(progress),
        {"crc": 1},
    )

    with pytest.raises(StoreError, match=r"(?i)unique"):
        store.poses.add(run.id, 0, FULL, [block(0, "dwell")], events, faults={"crc": 9})

    assert len(store.events.after(run.id)) == 3
    assert len(store.samples.of(run.id)) == 6
    assert store.runs.get(run.id).faults == {"crc": 1}


def test_an_excluded_pose_is_kept_and_changes_the_result_with_it(store, new_run, result):
    run = new_run(status="completed", poses=[Pose(float(k), 0.0) for k in range(3)], result=result)
    without = {**result, "bias_deg": 0.5}

    changed = store.amendments.exclude_pose(run.id, 1, "somebody leaned on the bench", result=without)

    assert changed == store.runs.get(run.id)
    assert changed.result == Result.model_validate(without)
    assert [row.result["bias_deg"] for row in store.units.comparison()] == [0.5]
    assert [p.excluded for p in store.poses.of(run.id)] == [None, "somebody leaned on the bench", None]
    assert [p.index for p in store.poses.of(run.id, include_excluded=False)] == [0, 2]
    for index in (-1, 3, 2**70):
        with pytest.raises(NotFound, match=f"no pose {index}"):
            store.amendments.exclude_pose(run.id, index, "", result=None)
    assert store.runs.get(run.id).result == Result.model_validate(without)


@given(
    arrays=st.integers(0, 20).flatmap(
        lambda n: st.tuples(
            *(hnp.arrays(np.float64, shape, elements=st.floats(width=64)) for shape in (n, (n, 3), (n, 3), n))
        )
    )
)
@settings(max_examples=50, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_every_bit_of_a_sample_comes_back(arrays):
    back = joined_arrays([packed_arrays(SampleBlock(0, "dwell", *arrays))])
    for was, now in zip(arrays, (back.time_s, back.accel_g, back.gyro_dps, back.temperature_c), strict=True):
        assert was.tobytes() == now.tobytes() and was.shape == now.shape


def test_a_boards_own_angle_comes_back_where_it_was_sent(store, new_run):
    run, plain = new_run(), block(0, "move")
    angled = replace(block(0, "dwell", first_s=1), angle_deg=np.array([1.0, np.nan, 3.0]))
    store.poses.add(run.id, 0, FULL, [plain, angled])
    nan = np.nan
    np.testing.assert_array_equal(store.samples.of(run.id).angle_deg, [nan, nan, nan, 1, nan, 3])
    np.testing.assert_array_equal(store.samples.of(run.id, pose=0).angle_deg, [1, nan, 3])
    assert joined_arrays([packed_arrays(plain)]).angle_deg is None
    with pytest.raises(ValueError, match="angle_deg has shape"):
        replace(plain, angle_deg=np.zeros(2))


def test_samples_are_joined_in_order_or_given_for_one_dwell(store, new_run):
    run = new_run()
    store.poses.add(run.id, 0, FULL, [block(0, "move"), block(0, "dwell", first_s=1)])
    store.poses.add(run.id, 1, FULL, [block(1, "move", first_s=2), block(1, "dwell", n=5, first_s=3)])

    everything = store.samples.of(run.id)
    assert len(everything) == 14
    assert np.all(np.diff(everything.time_s) > 0)
    np.testing.assert_array_equal(store.samples.of(run.id, pose=1).accel_g, block(1, "dwell", n=5).accel_g)
    assert store.samples.of(new_run().id).accel_g.shape == (0, 3)
    with pytest.raises(NotFound, match="no pose 2"):
        store.samples.of(run.id, pose=2)


def test_a_block_of_unequal_arrays_is_refused():
    with pytest.raises(ValueError, match="gyro_dps has shape"):
        SampleBlock(0, "dwell", np.zeros(2), np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(2))


def test_pruning_takes_samples_of_old_finished_runs_and_shortens_the_file(database, url, result):
    with Store.open(url, writer="serve") as store:
        old, going = (
            store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={}) for _ in range(2)
        )
        for run in (old, going):
            store.poses.add(run.id, 0, FULL, [block(0, "dwell", n=20_000)])
        store.runs.update(old.id, status="completed", result=result)

        assert store.samples.prune(old.created_at) == 0
    size = database.stat().st_size
    with Store.open(url, writer="serve") as store:
        assert store.samples.prune(datetime.now(UTC) + timedelta(days=1)) == 20_000
        assert (len(store.samples.of(old.id)), len(store.samples.of(going.id))) == (0, 20_000)
        assert [p.pose for p in store.poses.of(old.id)] == [FULL]
        assert store.runs.get(old.id).result == Result.model_validate(result)
    assert database.stat().st_size < 0.6 * size
