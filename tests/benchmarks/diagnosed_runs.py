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
