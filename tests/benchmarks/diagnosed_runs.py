"""Runs of the sizes that the aims name, from the simulator's physics, which know nothing of the diagnosis."""

from __future__ import annotations

import math

import numpy as np
from studies.blind.cells import (
    GRID,
    backlash,
    bias_tempco,
    eccentricity,
    offset_anywhere,
    package_turn,
    periodic,
)
from studies.blind.physics import Noise, measure, timeline

from calrig.calibration.poses import Pose
from calrig.plan import Plan

QUIET = Noise(reading_deg=0.009, norm_mg=0.1, move_deg=0.01)
"""As the simulated sensor's."""


def demo_run() -> list[Pose]:
    """The default plan's 52 poses with what the demo rig hides: backlash, eccentricity, offset, its drift."""
    causes = (
        backlash(0.12),
        eccentricity(0.12),
        offset_anywhere(3.6),
        bias_tempco(math.degrees(0.25e-3)),
    )
    return _measured(Plan(), causes, QUIET)


def three_effects() -> list[Pose]:
    """100 poses with a backlash, a package that turns with temperature and a worm."""
    plan = GRID.model_copy(update={"jitter_deg": 2.0})
    return _measured(plan, (backlash(0.08), package_turn(0.02), periodic(0.06)), Noise())


def _measured(plan: Plan, draws, noise: Noise) -> list[Pose]:
    rng = np.random.default_rng(1)
    return measure(plan, [draw(rng, timeline(plan)) for draw in draws], noise, rng).poses


def eleven_turns() -> list[Pose]:
    """500 poses over 3960°, 8° apart: orders 1, 2 and 12 of the turn, and a gear of 17.3° a tooth.

    The shortest period is 15.8°, twice the spacing, and no exact grid hides what lies between the poses.
    """
    rng = np.random.default_rng(1)
    step_deg = 3960.0 / 500
    theta_deg = step_deg * (np.arange(500) + rng.uniform(-0.3, 0.3, 500))
    errors_deg = rng.normal(0.0, 0.05, 500) + 0.2 * np.sin(2.0 * np.pi * theta_deg / 17.3 + 1.0)
    for order, amplitude_deg in ((1, 0.5), (2, 0.3), (12, 0.1)):
        errors_deg += amplitude_deg * np.sin(np.radians(order * theta_deg) + order)
    return [
        Pose(target_deg=theta, reading_deg=theta + error, time_s=3.0 * k)
        for k, (theta, error) in enumerate(zip(theta_deg.tolist(), errors_deg.tolist(), strict=True))
    ]


LATE_S, SPEED_DPS = 0.035, 36.0
ORDERS_DEG = {1: 0.9, 2: 8.0, 4: 1.5, 8: 0.5, 12: 0.25, 16: 0.1, 50: 0.3}
"""Amplitudes by order of the turn; order 50 is the electrical period of a 200-step motor, 7.2°."""


def measured_axis() -> list[Pose]:
    """485 poses of an axis as real ones are: eleven turns at constant speed, reversed once, read late.

    Half of the noise of 0.1° is a first-order autoregression from pose to pose.
    """
    rng = np.random.default_rng(7)
    there = np.linspace(0.0, 1980.0, 243)
    theta_deg = np.concatenate([there, there[-2::-1]]) + rng.normal(0.0, 0.3, 485)
    sense = np.where(np.arange(485) < 243, 1.0, -1.0)
    time_s = np.abs(np.diff(theta_deg, prepend=theta_deg[0])).cumsum() / SPEED_DPS
    late_deg = theta_deg - sense * SPEED_DPS * LATE_S
    slow_deg = np.zeros(485)
    for k in range(1, 485):
        slow_deg[k] = 0.5 * slow_deg[k - 1] + rng.normal(0.0, 0.05)
    reading_deg = 1.2 + 1.001 * late_deg + slow_deg + rng.normal(0.0, 0.07, 485)
    for order, amplitude_deg in ORDERS_DEG.items():
        reading_deg += amplitude_deg * np.sin(np.radians(order * late_deg) + order)
    rows = zip(theta_deg.tolist(), reading_deg.tolist(), time_s.tolist(), strict=True)
    return [Pose(target_deg=theta, stage_deg=theta, reading_deg=r, time_s=t) for theta, r, t in rows]
