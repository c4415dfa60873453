"""What is wrong with the rigs and units of the sweeps' blind board, by the simulator's own physics.

Each world is drawn anew for a run: signs, instants, phases. Sizes are about twice what the fixed plan shows
four times in five, so that it names most of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

BEGINS_S = 6.0
"""After the rig was switched on: homing, and the way to the first pose."""
WARM_UP_C = 6.0
START_C = 20.0

Parts = dict[str, dict[str, Any]]
Draw = Callable[[np.random.Generator, float], Parts]
"""Options of the simulator's parts, given how long the run takes, s."""


@dataclass(frozen=True)
class World:
    """One row of the table: what is wrong, and the names that are right."""

    draw: Draw
    right: frozenset[str]


def options(world: World, seed: int, lasts_s: float) -> Parts:
    """Of the simulator, in the run of a seed: a unit that warms up by 6 °C, and what is wrong beside it."""
    rng = np.random.default_rng([seed, 17])
    bend = rng.uniform(2.0, 5.0)
    end_c = START_C + WARM_UP_C / -math.expm1(-bend)
    made: Parts = {
        "environment": {"start_c": START_C, "end_c": end_c, "warm_up_s": lasts_s / bend},
        "imu": {
            "gyro_bias_dps": [1.4, -0.6, 0.3],
            "gyro_scale_error_pct": [0.4, 0.0, 0.0],
            "temperature_noise_c": 0.05,
            "reference_c": end_c - WARM_UP_C / bend,
        },
        "mechanics": {"scale_error_pct": 0.2},
    }
    for part, values in world.draw(rng, lasts_s).items():
        made[part] = {**made.get(part, {}), **values}
    return made


def _always(parts: Mapping[str, Mapping[str, Any]]) -> Draw:
    return lambda _rng, _lasts_s: {part: dict(values) for part, values in parts.items()}


def _signed(part: str, name: str, size: float, axis: int | None = None) -> Draw:
    """One option of either sign, of one axis where it has three."""

    def draw(rng: np.random.Generator, _lasts_s: float) -> Parts:
        value = size * _sign(rng)
        return {part: {name: value if axis is None else [value * (k == axis) for k in range(3)]}}

    return draw


def _slip(size_deg: float) -> Draw:
    def draw(rng: np.random.Generator, lasts_s: float) -> Parts:
        at_s = BEGINS_S + rng.uniform(0.1, 0.9) * lasts_s
        return {"mount": {"slip_deg": size_deg * _sign(rng), "slip_at_s": at_s}}

    return draw


def _drift(size_deg: float) -> Draw:
    """A joint that has long been under its load creeps evenly, as much as this over the run."""
    ago = 20.0

    def draw(rng: np.random.Generator, lasts_s: float) -> Parts:
        a_decade = size_deg * _sign(rng) / math.log10(1.0 + 1.0 / ago)
        return {"mount": {"creep_deg_per_decade": a_decade, "creep_began_s": -ago * lasts_s}}

    return draw


def _creep(deg_per_decade: float) -> Draw:
    def draw(rng: np.random.Generator, _lasts_s: float) -> Parts:
        return {
            "mount": {"creep_deg_per_decade": deg_per_decade * _sign(rng), "creep_began_s": BEGINS_S - 3.0}
        }

    return draw


def _heat_comes_late(deg_per_c: float) -> Draw:
    """The room warms and cools, and the package turns with heat that reaches it half a minute later."""

    def draw(rng: np.random.Generator, lasts_s: float) -> Parts:
        around = {"ambient_amplitude_c": 6.0, "ambient_period_s": lasts_s * rng.uniform(0.3, 0.6)}
        turns = {"package_turn_deg_per_c": deg_per_c * _sign(rng)}
        return {"environment": {**around, "stress_lag_s": lasts_s * 0.15}, "imu": turns}

    return draw


def _worm(size_deg: float, shortest_deg: float, longest_deg: float) -> Draw:
    def draw(rng: np.random.Generator, _lasts_s: float) -> Parts:
        wave = {"worm_period_deg": rng.uniform(shortest_deg, longest_deg), "worm_phase_deg": _phase(rng)}
        return {"mechanics": {"worm_deg": size_deg, **wave}}

    return draw


def _eccentricity(size_deg: float) -> Draw:
    return lambda rng, _lasts_s: {
        "mechanics": {"eccentricity_deg": size_deg, "eccentricity_phase_deg": _phase(rng)}
    }


def _askew(cross_deg: float, tilt_deg: float) -> Draw:
    def draw(rng: np.random.Generator, _lasts_s: float) -> Parts:
        turn = math.radians(_phase(rng))
        across = {"yaw_deg": cross_deg * math.cos(turn), "pitch_deg": cross_deg * math.sin(turn)}
        return {"mount": {**across, "axis_tilt_deg": tilt_deg * _sign(rng)}}

    return draw


def _gain_that_warms(pct_per_c: float) -> Draw:
    def draw(rng: np.random.Generator, _lasts_s: float) -> Parts:
        pct = pct_per_c * _sign(rng)
        return {"imu": {"accel_gain_pct_per_c": [pct, 2.0 * pct, pct]}}

    return draw


def _jump_of_y(size_mg: float) -> Draw:
    """The supply's voltage jumps once, and the offset of y with it: no record of either is kept."""

    def draw(rng: np.random.Generator, lasts_s: float) -> Parts:
        at_s = BEGINS_S + rng.uniform(0.55, 0.9) * lasts_s
        steps = {"supply_ripple_v": 0.25, "supply_waveform": "square", "supply_period_s": 2.0 * at_s}
        return {"environment": steps, "imu": {"accel_bias_mg_per_v": [0.0, 2.0 * size_mg * _sign(rng), 0.0]}}

    return draw


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 360.0))


LATE = {"stage": {"report_delay_s": 0.02}, "imu": {"dlpf_cfg": 4}}
WORLDS: dict[str, World] = {
    name: World(draw, frozenset(right.split()))
    for name, draw, right in (
        ("nothing", _always({}), ""),
        ("reports 20 ms late, filter 13 ms", _always(LATE), ""),
        ("backlash of 0.04°", _always({"mechanics": {"backlash_deg": 0.04}}), "backlash"),
        ("slip of 0.05°", _slip(0.05), "mount_slip"),
        ("drift of 0.09°", _drift(0.09), "time_drift"),
        ("creep of 0.08° a decade", _creep(0.08), "mount_creep"),
        ("mechanical creep of 1.5 %", _always({"mechanics": {"creep_fraction": 0.015}}), "settling"),
        ("mechanical creep of 0.5 %", _always({"mechanics": {"creep_fraction": 0.005}}), "settling"),
        ("package turns by 0.02°/°C", _signed("imu", "package_turn_deg_per_c", 0.02), "temperature_bias"),
        ("offset of y by 0.35 mg/°C", _signed("imu", "accel_bias_mg_per_c", 0.35, 1), "temperature_offset"),
        ("gain of y by 0.06 %/°C", _gain_that_warms(0.06), "temperature_gain"),
        ("package turns late by 0.02°/°C", _heat_comes_late(0.02), "thermal_hysteresis temperature_bias"),
        ("worm of 0.04°, 20–40°", _worm(0.04, 20.0, 40.0), "stage_periodic"),
        ("worm of 0.04°, 4–15°", _worm(0.04, 4.0, 15.0), "stage_periodic"),
        ("eccentricity of 0.3°", _eccentricity(0.3), "stage_eccentricity"),
        ("offset of z by 3 mg", _signed("imu", "accel_bias_mg", 3.0, 2), "accelerometer_offset"),
        ("gain of y by 0.3 %", _signed("imu", "accel_gain_error_pct", 0.3, 1), "axis_mismatch"),
        ("askew by 5°, 2° out of level", _askew(5.0, 2.0), "axis_tilt"),
        ("gyro wrong by 2.5 %", _always({"imu": {"gyro_scale_error_pct": [2.5, 0.0, 0.0]}}), "gyro_scale"),
        ("offset of y jumps by 0.8 mg", _jump_of_y(0.8), "unnamed"),
    )
}
