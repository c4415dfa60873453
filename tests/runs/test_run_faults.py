"""Damage on the wire is counted and never enters a reading."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from run_rigs import TruthRig, pass_time, plan, until

from calrig.estimation.angles import elevation_deg
from calrig.runs.service import RunService
from calrig.store import Store

SIX_SIGMA_DEG = 6 * np.degrees(0.004)
"""Of one sample's elevation at 200 Hz, with the data sheet's 400 µg/√Hz."""


@pytest.mark.parametrize(("fault", "counted"), [("corrupt", "crc"), ("gaps", "sequence_gap")])
def test_every_tenth_packet_damaged(
    make_rig: Any, serve: Any, store: Store, fault: str, counted: str
) -> None:
    bench = make_rig(board={"fault": fault})
    service = serve(bench)
    chosen = plan(elevations_deg=[-40, 0, 40])
    run = service.wait(service.start(unit="AS-1", plan=chosen).id, 30)
    assert run.status == "completed", run.error
    samples = store.samples.of(run.id)
    assert run.faults[counted] == pytest.approx(len(samples) / 9, rel=0.3)
    for stored in store.poses.of(run.id):
        assert stored.pose.n_samples == pytest.approx(180, abs=2)
        dwell = store.samples.of(run.id, stored.index)
        off_deg = elevation_deg(dwell.accel_g) - stored.pose.stage_deg - 0.8
        assert np.abs(off_deg).max() < SIX_SIGMA_DEG
        assert np.abs(dwell.gyro_dps - [1.4, -0.6, 0.3]).max() < 6 * 0.05
        assert stored.pose.reading_deg - stored.pose.stage_deg == pytest.approx(0.8, abs=0.1)
    assert run.result.bias_deg == pytest.approx(0.8, abs=0.1)


def test_the_gyros_account_of_a_move_in_which_the_board_was_reset_is_not_known(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = service.start(unit="AS-1", plan=plan(elevations_deg=[-40, 0, 40], order="given"))
    until(lambda: store.poses.count(run.id) == 1 and bench.moves(), "second move", 20)
    bench.simulated.board.reset()
    ended = service.wait(run.id, 30)
    assert (ended.status, ended.faults["board_reset"]) == ("completed", 1)
    assert [p.pose.gyro_move_deg for p in store.poses.of(run.id)][1:] == [None, pytest.approx(40, abs=0.1)]
    assert ended.result.gyro.scale == pytest.approx(1, abs=2e-3)


def test_a_sensor_that_hangs_for_a_moment(bench: TruthRig, service: RunService, store: Store) -> None:
    run = service.start(unit="AS-1", plan=plan(elevations_deg=[0, 30], order="given", dwell_s=16.0))
    until(lambda: store.poses.count(run.id) == 1 and bench.moves(), "second move", 20)
    until(bench.stands_for_good, "second dwell", 10)
    pass_time(bench, 4.0)
    bench.simulated.board.fault = "frozen"
    pass_time(bench, 4.0)
    bench.simulated.board.fault = None
    ended = service.wait(run.id, 30)
    assert ended.status == "completed", ended.error
    assert ended.faults["frozen"] > 3.0 * 200
    dwell, pose = store.samples.of(run.id, 1), store.poses.of(run.id)[1].pose
    assert pose.n_samples == len(dwell) < 14 * 200
    registers = np.hstack([dwell.accel_g, dwell.gyro_dps])
    assert (np.diff(registers, axis=0) != 0).any(axis=1).all()
    assert pose.reading_deg - pose.stage_deg == pytest.approx(0.8, abs=0.1)


def test_a_dwell_of_which_too_little_came_is_taken_again(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = service.start(unit="AS-1", plan=plan(elevations_deg=[30], dwell_s=30.0))
    until(lambda: bench.table_deg(bench.now_s) > 20, "move", 20)
    until(bench.stands_for_good, "dwell", 10)
    pass_time(bench, 4.0)
    bench.simulated.board.fault = "frozen"
    pass_time(bench, 20.0)
    bench.simulated.board.fault = None
    ended = service.wait(run.id, 30)
    assert ended.status == "completed", ended.error
    assert ended.faults["retried_pose"] == 1
    assert store.poses.of(run.id)[0].pose.n_samples == pytest.approx(6000, abs=1)
