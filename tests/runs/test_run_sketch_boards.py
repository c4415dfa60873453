"""Boards that people have flashed, end to end: they have no clock, so their rigs are no faster than life."""

from __future__ import annotations

import numpy as np
import pytest
from run_rigs import CLOCK, plan
from virtual_time import virtual_rig

from calrig.export.samples_csv import sample_columns
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings

OFFSET_DEG = 0.8
STAGE = {"velocity_dps": 60.0, "acceleration_dps2": 240.0, "homing_velocity_dps": 30.0}


@pytest.fixture
def calibrate(store):
    """Runs a plan on a rig that is no faster than life; gives the run."""

    def run(sketch, chosen, stage="smc100", driver=None, **board):
        options = {
            "seed": 1,
            "stage": {"driver": stage, **STAGE},
            "mount": {"offset_deg": OFFSET_DEG},
            "board": {"sketch": sketch, **board},
        }
        with virtual_rig(SimulatorSettings.from_options(options), CLOCK) as rig:
            settings = RigSettings(
                name=f"{stage}-{sketch}",
                stage=StageSettings(driver=stage, port=rig.stage_port),
                imu=BoardSettings(driver=driver or sketch, port=rig.imu_port),
                reference=ReferenceSettings(std_deg=0.29),
            )
            service = RunService(store, [settings])
            try:
                asked = service.start(unit=f"AS-{sketch}", plan=chosen, rig=settings.name)
                return service.wait(asked.id, 120)
            finally:
                service.close()

    return run


def test_a_grbl_stage_and_a_raw_board_at_ten_lines_a_second_calibrate_a_unit(calibrate, store):
    """The plan's 200 Hz are not asked of a board that has one rate; a dwell of 2 s holds twenty samples."""
    run = calibrate("i2cdev-raw", plan(elevations_deg=[-20, 20], settle_s=1.0, dwell_s=2.0), "grbl")
    assert (run.status, run.error) == ("completed", None)
    assert run.provenance["board"]["rate_hz"] == pytest.approx(9.5, abs=1)
    assert run.result.bias_deg == pytest.approx(OFFSET_DEG, abs=0.5)
    assert run.result.scale == pytest.approx(1, abs=0.02)
    assert run.result.gyro.scale is None  # ten samples a second do not carry a move of 40° at 60°/s
    for stored in store.poses.of(run.id):
        assert stored.pose.gyro_move_deg is None
        assert 14 <= stored.pose.n_samples <= 21
        assert stored.pose.temperature_c is None
        assert stored.pose.accel_z_g == pytest.approx(np.cos(np.radians(20)), abs=0.02)
        assert stored.pose.reading_stderr_deg > 0
    samples = sample_columns(store.samples.of(run.id))
    assert "angle_deg" not in samples
    assert (np.diff(samples["time_s"]) > 0).all()


def test_a_board_that_sends_its_own_angle_calibrates_a_unit_by_it(calibrate, store):
    """What it does not send is not known, and is not made up: no rate, no acceleration, no second filter."""
    run = calibrate("tkj-kalman", plan(elevations_deg=[-30, 30], settle_s=2.0, dwell_s=1.0))
    assert (run.status, run.error) == ("completed", None)
    assert run.result.bias_deg == pytest.approx(OFFSET_DEG, abs=0.3)
    assert run.result.gyro.bias_dps == [None] * 3
    assert run.result.gyro.scale is None
    for stored in store.poses.of(run.id):
        assert stored.pose.accel_y_g is None
        assert stored.pose.gyro_move_deg is None
        assert stored.pose.reading_stderr_deg > 0
    samples = sample_columns(store.samples.of(run.id, 0))
    assert samples["angle_deg"].mean() == pytest.approx(store.poses.of(run.id)[0].pose.reading_deg)
    assert np.isnan(samples["gyro_x_dps"]).all()


def test_a_plan_whose_dwells_are_too_short_for_the_board_is_refused_before_anything_moves(calibrate, store):
    run = calibrate("adafruit-basic", plan(dwell_s=2.0))
    assert run.status == "failed"
    assert "a dwell of 2 s holds about 4, a reading needs 8; nothing was moved: dwell longer" in run.error
    assert not store.poses.of(run.id)


def test_a_board_without_rates_is_refused_a_sweep_before_anything_moves(calibrate, store):
    run = calibrate("mpu6050-light", Plan(kind="sweep"))
    assert run.status == "failed"
    assert (
        "mpu6050-light sends no rates and accelerations, which a sweep needs; nothing was moved" in run.error
    )
    assert not store.poses.of(run.id)


def test_another_sketch_than_the_rig_says_fails_the_run_and_names_it(calibrate):
    run = calibrate("i2cdev-raw-fast", plan(), driver="adafruit-plotter")
    assert run.status == "failed"
    assert "it looks like driver 'i2cdev-raw'" in run.error
