"""The sensor on its table against first principles: 1 g, rates that integrate to angles, noise densities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal, stats

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings

AX, AY, AZ, TEMP, GX, GY, GZ = range(7)
RATE_HZ = 200.0


def bench(**options) -> Bench:
    return Bench(SimulatorSettings.from_options({"preset": "ideal"} | options))


def standing_at(target_deg: float, **options) -> tuple[Bench, float]:
    """A bench that stands at an angle, and an instant from which on it does."""
    table = bench(**options)
    home_s = table.mechanics.home(0.0, 90.0, 900.0).at_s
    return table, table.mechanics.move(home_s, target_deg, 90.0, 900.0).at_s


def still(table: Bench, from_s: float, n: int = 1) -> np.ndarray:
    return table.counts(from_s + np.arange(n) / RATE_HZ, RATE_HZ)


def elevation_deg(counts: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(counts[:, AY].astype(float), counts[:, AZ].astype(float)))


@given(st.floats(-170, 170))
def test_gravity_has_one_g_and_points_where_the_table_does(target):
    table, ready_s = standing_at(target)
    at = np.array([ready_s])
    force_g = table.specific_force_g(at)[0]
    assert np.linalg.norm(force_g) == pytest.approx(1.0, abs=1e-12)
    assert force_g == pytest.approx([0.0, np.sin(np.radians(target)), np.cos(np.radians(target))], abs=1e-9)
    assert elevation_deg(table.counts(at))[0] == pytest.approx(target, abs=0.01)


@settings(deadline=None)
@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-40, 40), st.floats(-80, 80))
def test_askew_or_out_of_level_gravity_still_has_one_g(tilt, yaw, pitch, target):
    mount = {"axis_tilt_deg": tilt, "yaw_deg": yaw, "pitch_deg": pitch, "offset_deg": 3.0}
    table, ready_s = standing_at(target, mount=mount)
    times_s = np.linspace(0.0, ready_s, 50)
    np.testing.assert_allclose(np.linalg.norm(table.specific_force_g(times_s), axis=1), 1.0, atol=1e-12)
    rates = np.linalg.norm(table.angular_rate_dps(times_s), axis=1)
    np.testing.assert_allclose(rates, np.abs(table.sensor(times_s).rate_dps), atol=1e-9)


def test_a_level_axis_along_x_leaves_a_yawed_sensor_short_in_y_alone():
    table, ready_s = standing_at(30.0, mount={"yaw_deg": 10.0})
    force_g = table.specific_force_g(np.array([ready_s]))[0]
    assert force_g == pytest.approx(
        [np.sin(np.radians(10)) * 0.5, np.cos(np.radians(10)) * 0.5, np.cos(np.radians(30))], abs=1e-9
    )


def test_the_integrated_gyro_is_what_the_sensor_turned():
    table = bench(mechanics={"backlash_deg": 0.3, "eccentricity_deg": 0.2}, mount={"offset_deg": 1.0})
    start_s = table.mechanics.home(0.0, 20.0, 80.0).at_s
    end_s = table.mechanics.move(start_s, 45.0, 20.0, 80.0).at_s
    times_s = np.arange(start_s, end_s + 0.1, 1 / 1000)
    rate_dps = table.counts(times_s)[:, GX].astype(float) * 250 / 32768
    turned_deg = np.diff(table.sensor(times_s).angle_deg[[0, -1]])[0]
    assert np.trapezoid(rate_dps, times_s) == pytest.approx(turned_deg, abs=0.02)


@pytest.mark.parametrize(
    ("mount", "moved_deg"),
    [
        ({"offset_deg": 0.8}, 0.8),
        ({"slip_deg": -0.4, "slip_at_s": 0.0}, -0.4),
        ({"slip_deg": -0.4, "slip_at_s": 1e6}, 0.0),
        # 0.2 kg on 0.1 m give 0.196 N·m at the horizontal, half of it at 60°.
        ({"cable_mass_kg": 0.2, "cable_arm_m": 0.1, "compliance_deg_per_nm": 0.5}, -0.5 * 0.0980665),
        ({"cable_stiffness_nm_per_deg": 0.001, "compliance_deg_per_nm": 0.5}, -0.5 * 0.06),
    ],
)
def test_what_the_mount_adds_to_an_elevation_of_60_degrees(mount, moved_deg):
    table, ready_s = standing_at(60.0, mount=mount)
    assert table.sensor(np.array([ready_s])).angle_deg[0] == pytest.approx(60.0 + moved_deg, abs=1e-9)


def test_a_slip_is_a_step_that_the_gyro_feels():
    table = bench(mount={"slip_deg": 0.5, "slip_at_s": 10.0, "slip_s": 0.1})
    times_s = np.arange(9.9, 10.2, 1e-4)
    angle_deg, rate_dps = table.sensor(times_s)
    assert angle_deg[-1] - angle_deg[0] == pytest.approx(0.5)
    assert np.trapezoid(rate_dps, times_s) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("imu", "changed"),
    [
        ({"accel_bias_mg": [10, 0, 0]}, {AX}),
        ({"accel_gain_error_pct": [0, 5, 0]}, {AY}),
        ({"accel_cross_axis_deg": {"yz": 1.0}}, {AY}),
        ({"accel_quadratic_mg_per_g2": [0, 0, 20]}, {AZ}),
        ({"accel_cubic_mg_per_g3": [0, 20, 0]}, {AY}),
        ({"gyro_bias_dps": [0, 1, 0]}, {GY}),
        ({"gyro_walk_dps_per_rts": 0.5}, {GX, GY, GZ}),
        ({"accel_walk_mg_per_rts": 5.0}, {AX, AY, AZ}),
        ({"accel_noise_ug_per_rthz": 400.0}, {AX, AY, AZ}),
        ({"gyro_noise_dps_per_rthz": 0.05}, {GX, GY, GZ}),
        ({"temperature_noise_c": 0.1}, {TEMP}),
        ({"accel_range_g": 4}, {AY, AZ}),
        # The environment below is 10 °C above the reference and 0.1 V above nominal.
        ({"accel_bias_mg_per_c": [0, 1, 0]}, {AY}),
        ({"accel_gain_pct_per_c": [0, 0, 0.1]}, {AZ}),
        ({"accel_bias_mg_per_v": [0, 0, 50]}, {AZ}),
        ({"gyro_bias_dps_per_c": [0, 0, 0.1]}, {GZ}),
        ({"package_turn_deg_per_c": 0.1}, {AY, AZ}),
    ],
)
def test_each_fault_of_the_sensor_changes_its_own_registers_only(imu, changed):
    warm = {
        "environment": {
            "start_c": 35.0,
            "end_c": 35.0,
            "supply_ripple_v": 0.1,
            "supply_waveform": "square",
            "supply_period_s": 1e6,
        }
    }
    without, ready_s = standing_at(40.0, **warm)
    with_fault, _ = standing_at(40.0, imu=imu, **warm)
    differ = (still(with_fault, ready_s, 50) != still(without, ready_s, 50)).any(axis=0)
    assert set(np.flatnonzero(differ)) == changed


def test_the_gyro_scale_is_felt_on_the_move_only():
    counts = {}
    for error_pct in (0.0, 10.0):
        table = bench(imu={"gyro_scale_error_pct": [error_pct, 0, 0]})
        start_s = table.mechanics.home(0.0, 20.0, 80.0).at_s
        table.mechanics.move(start_s, 40.0, 20.0, 80.0)
        counts[error_pct] = table.counts(np.array([start_s, start_s + 1.0]))[:, GX].astype(float)
    assert counts[10.0][0] == counts[0.0][0] == 0
    assert counts[10.0][1] / counts[0.0][1] == pytest.approx(1.1, abs=0.001)


@pytest.mark.parametrize(("axis", "density"), [(AX, 400e-6 * 16384), (GZ, 0.005 * 32768 / 250)])
def test_white_noise_has_the_data_sheet_density_at_any_rate(axis, density):
    for rate_hz in (100.0, 500.0):
        table = Bench(SimulatorSettings(seed=2))
        counts = table.counts(np.arange(60_000) / rate_hz, rate_hz)[:, axis].astype(float)
        _, power = signal.welch(counts, rate_hz, nperseg=1024)
        quantisation = 1 / 12 / (rate_hz / 2)
        assert np.mean(power[2:-2]) == pytest.approx(density**2 + quantisation, rel=0.03)


def test_samples_are_independent_and_gaussian():
    counts = (
        Bench(SimulatorSettings(seed=5)).counts(np.arange(20_000) / RATE_HZ, RATE_HZ)[:, AX].astype(float)
    )
    centred = counts - counts.mean()
    assert abs(np.mean(centred[1:] * centred[:-1]) / counts.var()) < 4 / np.sqrt(len(counts))
    assert stats.jarque_bera(counts).pvalue > 1e-3


def test_a_gyro_bias_walks_as_the_root_of_time():
    ends_dps = []
    for seed in range(200):
        table = bench(seed=seed, imu={"gyro_walk_dps_per_rts": 0.1})
        ends_dps.append(float(table.counts(np.arange(0.0, 25.0, 0.1))[-1, GX]) * 250 / 32768)
    assert np.std(ends_dps) == pytest.approx(0.1 * np.sqrt(24.9), rel=0.2)


@settings(deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=20), st.integers(0, 2**32))
def test_how_samples_are_cut_into_blocks_changes_nothing(blocks, seed):
    options = {
        "preset": "demo",
        "seed": seed,
        "environment": {"hysteresis_c": 0.5},
        "imu": {"package_turn_deg_per_c": 0.01, "accel_walk_mg_per_rts": 0.1},
    }
    times_s = np.arange(sum(blocks)) / RATE_HZ
    at_once = Bench(SimulatorSettings.from_options(options)).counts(times_s)
    table = Bench(SimulatorSettings.from_options(options))
    piecewise = [table.counts(piece) for piece in np.split(times_s, np.cumsum(blocks)[:-1])]
    np.testing.assert_array_equal(np.concatenate(piecewise), at_once)


def test_another_seed_is_another_noise():
    one, other = (Bench(SimulatorSettings(seed=seed)).counts(np.arange(10) / RATE_HZ) for seed in (1, 2))
    assert (one != other).any()


@pytest.mark.parametrize(("imu", "register"), [({}, AZ), ({"gyro_bias_dps": [0, 0, 400]}, GZ)])
def test_registers_saturate_at_sixteen_bits(imu, register):
    table = bench(imu={"accel_gain_error_pct": [0, 0, 150]} | imu)
    assert table.counts(np.array([0.0]))[0, register] == 32767


def test_the_temperature_register_follows_the_register_map():
    table = bench(environment={"start_c": 20.0, "end_c": 40.0, "warm_up_s": 100.0})
    times_s = np.array([0.0, 100.0, 1e5])
    read_c = table.counts(times_s)[:, TEMP] / 340 + 36.53
    np.testing.assert_allclose(read_c, [20.0, 40 - 20 / np.e, 40.0], atol=1 / 340)
    np.testing.assert_allclose(read_c, table.temperature_c(times_s), atol=1 / 340)


def test_hysteresis_separates_warming_from_cooling_by_its_width():
    swing = {"ambient_amplitude_c": 10.0, "ambient_period_s": 1000.0, "hysteresis_c": 2.0}
    level = {"power_up_deg": 0.0}
    table = bench(environment=swing, mechanics=level, imu={"accel_bias_mg_per_c": [0, 5, 0]})
    cooling_s, warming_s = 1500.0, 2000.0  # both at 25 °C, after the loop has closed
    offset_mg = table.counts(np.array([cooling_s, warming_s]))[:, AY] / 16.384
    assert offset_mg == pytest.approx([5.0, -5.0], abs=0.1)


def test_a_package_that_heat_reaches_late_follows_the_swing_of_the_room_like_a_first_order_lag():
    lag_s, period_s = 80.0, 1000.0
    swing = {"ambient_amplitude_c": 10.0, "ambient_period_s": period_s, "stress_lag_s": lag_s}
    level = {"power_up_deg": 0.0}
    table = bench(environment=swing, mechanics=level, imu={"accel_bias_mg_per_c": [0, 5, 0]})
    times_s = 2000.0 + np.arange(0.0, period_s, 50.0)  # long after the start
    warmer_c = table.counts(times_s)[:, AY] / 16.384 / 5.0
    behind = 2 * np.pi * lag_s / period_s
    expected_c = 10.0 / np.hypot(1.0, behind) * np.sin(2 * np.pi * times_s / period_s - np.arctan(behind))
    np.testing.assert_allclose(warmer_c, expected_c, atol=0.03)


def test_a_joint_creeps_by_as_much_in_each_tenfold_of_time_and_the_gyro_feels_how_fast():
    table = bench(mount={"creep_deg_per_decade": 0.1}, mechanics={"power_up_deg": 0.0})
    crept_deg = table.sensor(np.array([1.0, 10.0, 100.0, 1000.0])).angle_deg
    np.testing.assert_allclose(np.diff(crept_deg), 0.1, rtol=0.02)
    fine_s = np.linspace(5.0, 6.0, 1001)
    turned_deg = np.trapezoid(table.angular_rate_dps(fine_s)[:, 0], fine_s)
    assert turned_deg == pytest.approx(np.diff(table.sensor(fine_s[[0, -1]]).angle_deg)[0], rel=1e-4)


def test_the_demo_rig_hides_effects_but_no_blunder():
    table = Bench(SimulatorSettings.from_options({"preset": "demo"}))
    now_s = table.mechanics.home(0.0, 15.0, 90.0).at_s
    stage_deg, reading_deg = [], []
    for sweep in range(4):
        for target in np.arange(-60, 61, 10) * (-1) ** sweep:
            now_s = table.mechanics.move(now_s, target, 30.0, 90.0).at_s + 1.0
            counts = table.counts(now_s + np.arange(400) / RATE_HZ, RATE_HZ)
            now_s += 2.0
            stage_deg.append(target)
            reading_deg.append(elevation_deg(counts).mean())
    fit = stats.linregress(stage_deg, reading_deg)
    residual_deg = reading_deg - fit.intercept - fit.slope * np.array(stage_deg)
    noise_deg = np.degrees(400e-6 * np.sqrt(RATE_HZ / 2)) / np.sqrt(400)
    assert 0.5 < np.sqrt(np.mean((np.array(reading_deg) - stage_deg) ** 2)) < 1.2
    assert 5 * noise_deg < np.sqrt(np.mean(residual_deg**2)) < 0.2
    assert now_s / 6.0 < 35.0


@pytest.mark.parametrize(
    ("axis", "up", "after"),
    [("x", "z", "y"), ("y", "x", "z"), ("z", "y", "x"), ("-x", "z", "y"), ("-y", "x", "z"), ("-z", "y", "x")],
)
def test_each_face_lies_along_the_stage_and_turns_with_its_clamp(axis, up, after):
    table, ready_s = standing_at(20.0)
    there_s = table.clamp(ready_s + 1.0, 100.0, axis)
    before, at = np.array([ready_s]), np.array([there_s + 0.1])
    at_20 = [0, np.sin(np.radians(20)), np.cos(np.radians(20))]
    assert table.specific_force_g(before)[0] == pytest.approx(at_20)
    sense = -1.0 if axis.startswith("-") else 1.0
    along, sine, cosine = ("xyz".index(name) for name in (axis[-1], after, up))
    force_g = table.specific_force_g(at)[0]
    assert force_g[along] == pytest.approx(0.0, abs=1e-12)
    assert np.degrees(np.arctan2(force_g[sine], force_g[cosine])) == pytest.approx(sense * 120.0)
    turning = np.arange(at[0], table.mechanics.move(at[0], -30.0, 20.0, 80.0).at_s + 0.1, 1e-3)
    turned_deg = np.trapezoid(table.angular_rate_dps(turning), turning, axis=0)
    assert turned_deg[along] == pytest.approx(sense * -50.0, abs=0.01)


def test_a_hand_turns_the_unit_as_slowly_as_its_gyro_can_follow_and_seats_it_anew_each_time():
    table, ready_s = standing_at(0.0, mount={"seat_std_deg": 0.5, "roll_deg": 2.0}, seed=4)
    there_s = table.clamp(ready_s, 120.0)
    times_s = np.arange(ready_s, there_s, 1e-3)
    rates_dps = table.angular_rate_dps(times_s)[:, 0]
    assert rates_dps.max() < 61.0
    assert np.trapezoid(rates_dps, times_s) == pytest.approx(120.0, abs=0.1)
    seen = []
    for _ in range(40):
        there_s = table.clamp(there_s + 0.1, 0.0) + 0.1
        seen.append(table.specific_force_g(np.array([there_s]))[0])
    tilts_deg = np.degrees(np.array(seen))[:, :2]
    assert tilts_deg.mean(axis=0) == pytest.approx([0.0, 2.0], abs=0.4)
    assert tilts_deg.std(axis=0) == pytest.approx([0.5, 0.5], abs=0.2)


def test_a_gyro_mixes_its_axes_and_feels_gravity():
    per_g = [[0, 0, 0.2], [0.1, 0, 0], [0, 0.3, 0]]
    response = {"gyro_cross_axis_deg": {"yx": 1.0, "zx": -2.0}, "gyro_dps_per_g": per_g}
    table, ready_s = standing_at(90.0, imu=response)
    assert still(table, ready_s)[0, GX:].astype(float) * 250 / 32768 == pytest.approx(
        [0.0, 0.0, 0.3], abs=0.01
    )
    start_s, end_s = ready_s, table.mechanics.move(ready_s, 0.0, 30.0, 90.0).at_s
    times_s = np.arange(start_s, end_s, 1e-3)
    turned_deg = np.trapezoid(table.counts(times_s)[:, GX:].astype(float) * 250 / 32768, times_s, axis=0)
    felt_s = np.trapezoid(table.specific_force_g(times_s), times_s, axis=0)
    by_gravity = np.array([0.2 * felt_s[2], 0.1 * felt_s[0], 0.3 * felt_s[1]])
    expected = -90.0 * np.array([1.0, np.sin(np.radians(1)), -np.sin(np.radians(2))])
    assert turned_deg - by_gravity == pytest.approx(expected, abs=0.03)
