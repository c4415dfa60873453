"""The causes of the board's cells, each drawn anew for a run: signs, instants, phases.

Where one name has several mechanisms, which of them is drawn too.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .layout import Timeline
from .physics import Cause

Draw = Callable[[np.random.Generator, Timeline], Cause]


def backlash(size_deg: float) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        options = {"mechanics": {"backlash_deg": size_deg}}
        return Cause("backlash", "stage", "approach", options, parameters={"backlash_deg": -size_deg})

    return draw


def package_turn(deg_per_c: float, sense: float | None = None) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        turn = deg_per_c * (sense or _sign(rng))
        options = {"imu": {"package_turn_deg_per_c": turn}}
        return Cause("temperature_bias", "sensor", "temperature_c", options, parameters={"deg_per_c": turn})

    return draw


def bias_tempco(deg_per_c: float) -> Draw:
    """The y axis's bias moves with temperature: the angle by this much where y lies level."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        mg = math.radians(deg_per_c) * 1e3 * _sign(rng)
        return Cause(
            "temperature_offset",
            "sensor",
            "temperature_c",
            {"imu": {"accel_bias_mg_per_c": [0.0, mg, 0.0]}},
            parameters={"y_mg_per_c": mg, "z_mg_per_c": 0.0},
        )

    return draw


def slow_heat(lag_s: float, swing_c: float = 6.0) -> Draw:
    """Heat reaches the package late: beside a `package_turn`, while the room warms and cools."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        around = {
            "stress_lag_s": lag_s,
            "ambient_amplitude_c": swing_c,
            "ambient_period_s": float(when.duration_s * rng.uniform(0.25, 0.5)),
        }
        return Cause("thermal_hysteresis", "sensor", "temperature_c", {"environment": around})

    return draw


def creep(deg_per_decade: float) -> Draw:
    """The joint was clamped when the run began."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        size = deg_per_decade * _sign(rng)
        options = {"mount": {"creep_deg_per_decade": size, "creep_began_s": float(when.move_s[0])}}
        return Cause("mount_creep", "mounting", "time_s", options, parameters={"deg_per_decade": size})

    return draw


def askew(cross_deg: float, tilt_deg: float) -> Draw:
    """The stage's axis is out of level, and the unit not square to it, either way."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        turn = rng.uniform(0.0, 2.0 * math.pi)
        options = {
            "yaw_deg": cross_deg * math.cos(turn),
            "pitch_deg": cross_deg * math.sin(turn),
            "axis_tilt_deg": tilt_deg * _sign(rng),
        }
        return Cause("axis_tilt", "mounting", "target_deg", {"mount": options})

    return draw


def gain_tempco(pct_per_c: float) -> Draw:
    """The gain of y moves with temperature, and that of all axes as much again."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        pct = pct_per_c * _sign(rng)
        return Cause(
            "temperature_gain",
            "sensor",
            "temperature_c",
            {"imu": {"accel_gain_pct_per_c": [pct, 2.0 * pct, pct]}},
            parameters={"gain_pct_per_c": pct},
        )

    return draw


def drift(size_deg: float) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        rate = size_deg * _sign(rng) / when.duration_s
        return Cause(
            "time_drift",
            "environment",
            "time_s",
            turned=lambda t, theta, v: rate * t,
            parameters={"deg_per_s": rate},
        )

    return draw


def slip(size_deg: float, first: float = 0.05, last: float = 0.95, sense: float | None = None) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        k = int(rng.uniform(first, last) * len(when.target_deg))
        moving = bool(rng.integers(2))
        begin, end = (when.move_s[k], when.arrival_s[k]) if moving else (when.begin_s[k], when.end_s[k])
        step = size_deg * (sense or _sign(rng))
        options = {"mount": {"slip_deg": step, "slip_at_s": float(rng.uniform(begin, end))}}
        return Cause("mount_slip", "mounting", "time_s", options, parameters={"step_deg": step})

    return draw


def periodic(size_deg: float, period_deg: tuple[float, float] = (4.0, 15.0)) -> Draw:
    """A worm's wave, of a period drawn from between two."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        period = float(rng.uniform(*period_deg))
        phase = float(rng.uniform(0.0, 360.0))
        options = {"mechanics": {"worm_deg": size_deg, "worm_period_deg": period, "worm_phase_deg": phase}}
        return Cause(
            "stage_periodic",
            "stage",
            "target_deg",
            options,
            parameters={"amplitude_deg": size_deg},
            period_deg=period,
        )

    return draw


def motor_steps(step_deg: float, detent_share: float) -> Draw:
    """A microstepped motor that its detents hold off: a wave of its full step at the table."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        options = {"mechanics": {"motor_step_deg": step_deg, "detent_share": detent_share}}
        size_deg = detent_share * step_deg * 2.0 / math.pi
        return Cause("stage_periodic", "stage", "target_deg", options, parameters={"amplitude_deg": size_deg})

    return draw


def settling(share: float) -> Draw:
    """A filter too slow for the settling time, or a mount that creeps; about `share` of a move is missing."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        if rng.integers(2):
            return Cause("settling", "process", "move_deg", filter_s=0.35 * math.sqrt(share / 0.01))
        settle_s, dwell_s = when.begin_s[0] - when.arrival_s[0], when.end_s[0] - when.begin_s[0]
        left = 1.5 / dwell_s * (math.exp(-settle_s / 1.5) - math.exp(-(settle_s + dwell_s) / 1.5))
        options = {"mechanics": {"creep_fraction": share / left, "creep_s": 1.5}}
        return Cause("settling", "process", "move_deg", options)

    return draw


def offset(size_mg: float) -> Draw:
    """On z, where it is hardest to see: 2.1 mg leave 0.004° in the reading."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        mg = size_mg * _sign(rng)
        return Cause(
            "accelerometer_offset",
            "sensor",
            "target_deg",
            {"imu": {"accel_bias_mg": [0.0, 0.0, mg]}},
            parameters={"y_mg": 0.0, "z_mg": mg},
        )

    return draw


def offset_anywhere(size_mg: float) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        turn = rng.uniform(0.0, 2.0 * math.pi)
        y, z = size_mg * math.cos(turn), size_mg * math.sin(turn)
        return Cause(
            "accelerometer_offset",
            "sensor",
            "target_deg",
            {"imu": {"accel_bias_mg": [0.0, y, z]}},
            parameters={"y_mg": y, "z_mg": z},
        )

    return draw


def gain(size_pct: float) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        pct = size_pct * _sign(rng)
        return Cause(
            "axis_mismatch",
            "sensor",
            "target_deg",
            {"imu": {"accel_gain_error_pct": [0.0, pct, 0.0]}},
            parameters={"gain_pct": pct},
        )

    return draw


def eccentricity(size_deg: float) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        options = {"eccentricity_deg": size_deg, "eccentricity_phase_deg": float(rng.uniform(0.0, 360.0))}
        return Cause("stage_eccentricity", "stage", "target_deg", {"mechanics": options})

    return draw


def supply(deg_per_v: float) -> Draw:
    """The regulator's steps of ±0.25 V turn what the sensor gives; how long each lasts is drawn."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        return Cause(
            "unnamed",
            "unknown",
            "supply_v",
            {"environment": _steps(rng, when)},
            turned=lambda t, theta, v: deg_per_v * (v - 3.3),
        )

    return draw


def supply_bias(deg_per_v: float) -> Draw:
    """The same through the y axis's bias, as an accelerometer's supply sensitivity would do it."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        mg = math.radians(deg_per_v) * 1e3
        options = {"environment": _steps(rng, when), "imu": {"accel_bias_mg_per_v": [0.0, mg, 0.0]}}
        return Cause("unnamed", "unknown", "supply_v", options)

    return draw


def _steps(rng: np.random.Generator, when: Timeline) -> dict[str, object]:
    per_pose_s = when.duration_s / len(when.target_deg)
    return {
        "supply_ripple_v": 0.25,
        "supply_waveform": "square",
        "supply_period_s": float(per_pose_s * rng.uniform(3.0, 25.0)),
    }


def cycle(size_deg: float) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        rate = 2.0 * math.pi * rng.uniform(3.0, 8.0) / when.duration_s
        phase = rng.uniform(0.0, 2.0 * math.pi)
        return Cause(
            "unnamed", "unknown", "time_s", turned=lambda t, theta, v: size_deg * np.sin(rate * t + phase)
        )

    return draw


def kink(deg_per_deg: float, beyond_deg: float = 20.0) -> Draw:
    """Of the sensor or of the stage: the gyro feels the second."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        slope = deg_per_deg * _sign(rng)
        return Cause(
            "unnamed",
            "unknown",
            "target_deg",
            turned=lambda t, theta, v: slope * np.maximum(theta - beyond_deg, 0.0),
            felt=bool(rng.integers(2)),
        )

    return draw


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))
