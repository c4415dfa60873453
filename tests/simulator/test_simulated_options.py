"""What a rig's `simulated` table may say, and how a slip in it is answered."""

from __future__ import annotations

import pytest

from calrig.simulator.config import SimulatorSettings


def test_nothing_asked_is_an_mpu_6050_on_a_perfect_stage():
    settings = SimulatorSettings.from_options({})
    assert settings.imu.accel_noise_ug_per_rthz == 400.0
    assert settings.imu.gyro_noise_dps_per_rthz == 0.005
    assert settings.mechanics.backlash_deg == settings.mount.offset_deg == 0.0


def test_options_go_over_those_of_the_preset_one_by_one():
    demo = SimulatorSettings.from_options({"preset": "demo"})
    changed = SimulatorSettings.from_options(
        {"preset": "demo", "seed": 3, "mechanics": {"backlash_deg": 0.0}}
    )
    assert demo.mechanics.backlash_deg == 0.12
    assert changed.mechanics == demo.mechanics.model_copy(update={"backlash_deg": 0.0})
    assert changed.imu == demo.imu
    assert changed.seed == 3


def test_the_demo_board_names_no_serial_and_streams_at_200_hz():
    board = SimulatorSettings.from_options({"preset": "demo"}).board
    assert (board.serial, board.default_rate_hz) == ("", 200)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"preset": "dmeo"}, "preset: 'dmeo' is unknown; there are demo, ideal"),
        ({"preset": ["demo"]}, "preset: ['demo'] is unknown"),
        ({"mechanics": {"backlash": 1}}, "mechanics.backlash: no such option; did you mean backlash_deg?"),
        ({"sede": 1}, "sede: no such option; did you mean seed?"),
        ({"time_scale": 0}, "time_scale: Input should be greater than 0"),
        ({"imu": {"accel_bias_mg": [1, 2]}}, "imu.accel_bias_mg"),
        ({"imu": {"accel_range_g": 3}}, "imu.accel_range_g"),
        ({"imu": {"accel_cross_axis_deg": {"xx": 1}}}, "imu.accel_cross_axis_deg.xx"),
        ({"mechanics": "much"}, "mechanics"),
        ({"mechanics": {"worm_deg": 3}}, "mechanics: worm_deg is so large"),
        ({"mechanics": {"vibration_direction": [0, 0, 0]}}, "mechanics: vibration_direction is 0, 0, 0"),
        ({"imu": {"dlpf_cfg": 7}}, "imu.dlpf_cfg: Input should be less than or equal to 6"),
        ({"environment": {"start_c": float("nan")}}, "environment.start_c"),
        ({"board": {"default_rate_hz": 2000}}, "board: default_rate_hz is above max_rate_hz"),
    ],
)
def test_a_slip_is_named_by_its_key(options, said):
    with pytest.raises(ValueError) as refused:
        SimulatorSettings.from_options(options)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
