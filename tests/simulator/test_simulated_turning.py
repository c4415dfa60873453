"""What a stage that turns without stopping does to the readings, and how late either is told."""

from __future__ import annotations

import numpy as np
import pytest
import serial
from scipy.spatial.transform import Rotation
from support import PATIENCE_S
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.stages.grbl.firmware import BYTE_S

AX, AY, AZ, TEMP, GX, GY, GZ = range(7)
RATE_HZ = 200.0
G_PER_COUNT = 1 / 16384
VELOCITY_DPS, ACCELERATION_DPS2, STEP_HZ = 5.0, 80.0, 260.0
STEP_DEG = VELOCITY_DPS / STEP_HZ
TARGET_DEG = 30.007  # between two steps
ALIAS_HZ = 60.0  # as which a board at 200 Hz sees the steps; their next multiples at 80, 20, 40
BENT_MG = 100.0
TURNING = slice(60, 860)  # of the samples below: 4 s at full speed


def turned(**options) -> tuple[Bench, float, np.ndarray]:
    """A bench that turns from its home to its target, when it began, and 7 s of readings from there on."""
    bench = Bench(SimulatorSettings.from_options({"preset": "ideal"} | options))
    begin_s = bench.mechanics.home(0.0, 20.0, ACCELERATION_DPS2).at_s
    bench.mechanics.move(begin_s, TARGET_DEG, VELOCITY_DPS, ACCELERATION_DPS2)
    return bench, begin_s, bench.counts(begin_s + np.arange(7 * RATE_HZ) / RATE_HZ, RATE_HZ).astype(float)


def shaken_g(vibration: dict, imu: dict | None = None) -> np.ndarray:
    """What vibration adds to the accelerometer's readings (n, 3)."""
    still = {"motor_step_deg": STEP_DEG}
    with_it, without = (
        turned(mechanics=still | more, imu=imu or {})[2] for more in (vibration, {"vibration_g": 0.0})
    )
    return (with_it - without)[:, :3] * G_PER_COUNT


def test_a_turning_motor_shakes_the_package_at_its_steps_and_a_standing_one_does_not():
    shares = {"vibration_harmonics": [1.0, 0.5], "vibration_direction": [0, 0, 2.0]}
    added_g = shaken_g({"vibration_g": 0.1, **shares})
    ramp_s = VELOCITY_DPS / ACCELERATION_DPS2
    since_s = np.arange(len(added_g))[TURNING] / RATE_HZ
    steps = VELOCITY_DPS * (since_s - ramp_s / 2) / STEP_DEG
    expected_g = 0.1 * np.sin(2 * np.pi * steps) + 0.05 * np.sin(4 * np.pi * steps)
    np.testing.assert_allclose(added_g[TURNING, AZ], expected_g, atol=1.1 * G_PER_COUNT)
    assert not added_g[:, :AZ].any()
    arrived = int((TARGET_DEG / VELOCITY_DPS + ramp_s) * RATE_HZ) + 1
    assert not added_g[0].any()
    assert not added_g[arrived:].any()


@pytest.mark.parametrize(("dlpf_cfg", "left"), [(None, 1.0), (3, 1 / np.hypot(1, STEP_HZ / 44))])
def test_a_bent_accelerometer_rectifies_vibration_whatever_the_filter_leaves_of_it(dlpf_cfg, left):
    """The mean of k₂·(A·sin)² is k₂·A²/2: that much of a bias, and only while it turns."""
    vibration = {"vibration_g": 0.2, "vibration_harmonics": [1.0, 0.5], "vibration_direction": [0, 0, 1]}
    added_g = shaken_g(vibration, {"accel_quadratic_mg_per_g2": [0, 0, BENT_MG], "dlpf_cfg": dlpf_cfg})
    rectified_g = 1e-3 * BENT_MG * (0.2**2 + 0.1**2) / 2
    assert added_g[TURNING, AZ].mean() == pytest.approx(rectified_g, rel=0.002)
    # The bend also lends the waves a slope, 2·k₂·a, at the mean force a = cos of the angle, here 0.98.
    wave = np.abs(np.fft.rfft(added_g[TURNING, AZ]))[round(4 * ALIAS_HZ)] / 400
    assert wave == pytest.approx(0.2 * left * (1 + 2e-3 * BENT_MG * 0.98), rel=0.01)


@pytest.mark.parametrize(("times_resonance", "gain"), [(0.5, 1 / 3), (1.0, 10.0), (5.0, 25 / 24)])
def test_what_hangs_in_a_spring_is_shaken_as_the_speed_has_it(times_resonance, gain):
    spring = {"vibration_resonance_hz": STEP_HZ / times_resonance, "vibration_harmonics": [1.0]}
    added_g = shaken_g({"vibration_g": 0.02, "vibration_direction": [1, 0, 0], **spring})
    assert np.sqrt(2) * added_g[TURNING, AX].std() == pytest.approx(0.02 * gain, rel=0.01)


def test_vibration_keeps_its_direction_on_the_table_however_the_unit_is_clamped():
    along = {"vibration_g": 0.1, "vibration_harmonics": [1.0], "vibration_direction": [0, 0, 1]}
    turned_by_90 = {"clamped_deg": 90.0}
    added = [turned(mechanics=more, mount=turned_by_90)[2][:, :3] for more in (along, {})]
    heights_g = G_PER_COUNT * np.ptp(added[0] - added[1], axis=0) / 2
    assert heights_g == pytest.approx([0.0, 0.1, 0.0], abs=0.001)


@pytest.mark.parametrize(
    ("dlpf_cfg", "accel_s", "gyro_s"),
    [(None, 0, 0), (2, 3.0e-3, 2.8e-3), (3, 4.9e-3, 4.8e-3), (4, 8.5e-3, 8.3e-3), (6, 19.0e-3, 18.6e-3)],
)
def test_the_chips_filter_tells_each_channel_as_late_as_its_register_map_says(dlpf_cfg, accel_s, gyro_s):
    bench, begin_s, counts = turned(imu={"dlpf_cfg": dlpf_cfg})
    elevation_deg = np.degrees(np.arctan2(counts[TURNING, AY], counts[TURNING, AZ]))
    since_s = np.arange(len(counts)) / RATE_HZ
    behind_deg = bench.sensor(begin_s + since_s[TURNING]).angle_deg - elevation_deg
    assert behind_deg.mean() == pytest.approx(VELOCITY_DPS * accel_s, abs=2e-4)
    ramp = slice(5, 13)  # 25 to 60 ms after the beginning: the rate rises in proportion
    rate_dps = counts[ramp, GX] * 250 / 32768
    assert (since_s[ramp] - rate_dps / ACCELERATION_DPS2).mean() == pytest.approx(gyro_s, abs=1e-4)


def test_on_an_arm_the_specific_force_is_the_paths_second_derivative_less_gravity():
    arm_m, gravity = 0.1, 9.80665
    mount = {"lever_arm_m": arm_m, "yaw_deg": 20.0, "clamped_deg": 40.0}
    bench, begin_s, _ = turned(mount=mount, mechanics={"worm_deg": 0.2})
    h = 1e-3
    for at_s in begin_s + np.array([0.03, 1.0, 2.5]):
        table_deg = bench.mechanics.table(at_s + np.array([-h, 0.0, h])).angle_deg
        paths_m = Rotation.from_euler("x", table_deg[:, None], degrees=True).apply([0, 0, arm_m])
        felt_g = (paths_m[0] - 2 * paths_m[1] + paths_m[2]) / h**2 / gravity + [0, 0, 1]
        to_world = Rotation.from_euler("x", table_deg[1] + 40.0, degrees=True) * Rotation.from_euler(
            "z", 20.0, degrees=True
        )
        expected_g = to_world.inv().apply(felt_g)
        assert bench.specific_force_g(np.array([at_s]))[0] == pytest.approx(expected_g, abs=1e-5)
        assert np.linalg.norm(expected_g - to_world.inv().apply([0, 0, 1])) > 5e-5


DIALECTS = {  # home, turn at 5 °/s, ask, the answer's number, the finest it tells
    "smc100": ("1OR\r\n", "1VA5\r\n1PA30\r\n", "1TP\r\n", lambda said: float(said[3:]), 1e-5),
    "esp301": ("1OR\r", "1VA5;1PA30\r", "1TP\r", float, 1e-4),
    "zaber": (
        "/1 home\n",
        "/1 set maxspeed 52429\n/1 move abs 192000\n",
        "/1 get pos\n",
        lambda said: int(said.split()[-1]) / 6400,
        1 / 6400,
    ),
    "grbl": ("$H\n", "G1 X30 F300\n", "?", lambda said: float(said.split("WPos:")[1].split(",")[0]), 0.005),
}


BEGINS_S = {"grbl": 12 * BYTE_S + 0.0015 - BYTE_S}
"""After the command was sent: a line takes its time on the wire and to be read; `?` that of one byte."""


@pytest.mark.parametrize("delay_s", [0.0, 0.02])
@pytest.mark.parametrize("driver", DIALECTS)
def test_a_turning_stage_says_where_it_was_when_it_was_asked_or_a_told_time_before(driver, delay_s):
    home, turn, ask, number, finest_deg = DIALECTS[driver]
    stage = {
        "driver": driver,
        "report_delay_s": delay_s,
        "settings": {10: 0},  # a GRBL tells work coordinates
        "velocity_dps": 20.0,
        "acceleration_dps2": ACCELERATION_DPS2,
    }
    clock = VirtualClock()
    rig = virtual_rig(SimulatorSettings.from_options({"preset": "ideal", "stage": stage}), clock)
    with clock.taking_part(), rig, serial.serial_for_url(rig.stage_port, timeout=PATIENCE_S) as port:
        port.write(home.encode())
        clock.sleep(10.0)
        begin_s = clock.now_s()
        port.write(turn.encode())
        clock.sleep(0.005)
        port.read(port.in_waiting)
        asked_s, told_deg = [], []
        while clock.now_s() < begin_s + 0.3:
            asked_s.append(clock.now_s())
            port.write(ask.encode())
            told_deg.append(number(port.read_until(b"\n").decode().strip()))
        clock.stop()
    since_s = np.maximum(np.array(asked_s) - begin_s - delay_s - BEGINS_S.get(driver, 0.0), 0.0)
    ramp_s = VELOCITY_DPS / ACCELERATION_DPS2
    ramp_deg = ACCELERATION_DPS2 * np.minimum(since_s, ramp_s) ** 2 / 2
    expected_deg = ramp_deg + VELOCITY_DPS * np.maximum(since_s - ramp_s, 0.0)
    np.testing.assert_allclose(told_deg, expected_deg, atol=0.51 * finest_deg)
    if driver != "grbl":  # whose answers take their time on the wire
        assert len(told_deg) / (clock.now_s() - asked_s[0]) == pytest.approx(1000, rel=0.01)


def test_a_late_report_counts_from_the_home_that_is_known():
    bench = Bench(SimulatorSettings.from_options({"preset": "ideal"}))
    home_s = bench.mechanics.home(0.0, 20.0, ACCELERATION_DPS2).at_s
    assert bench.mechanics.encoder_deg(np.array([home_s]), 0.01)[0] == pytest.approx(-0.004, abs=1e-9)
