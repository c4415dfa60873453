"""Runs with one cause of the blind board at the size that a diagnosis just sees, and what is true of them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from calrig.calibration.poses import Pose
from studies.blind import causes
from studies.blind.causes import Draw
from studies.blind.cells import GRID, JITTER_DEG, WHITE
from studies.blind.layout import Layout, timeline
from studies.blind.limits import AT_THE_LIMIT, distance
from studies.blind.physics import measure, shape_deg, surroundings

MAKES: dict[str, tuple[Callable[[float], Draw], float, float]] = {
    "backlash": (causes.backlash, 0.08, 0.0),
    "temperature": (causes.package_turn, 0.02, 0.0),
    "offset's tempco": (causes.bias_tempco, 0.02, 0.0),
    "gain's tempco": (causes.gain_tempco, 0.11, 0.0),
    "drift": (causes.drift, 0.12, 0.0),
    "creep": (causes.creep, 0.08, 0.0),
    "slip": (causes.slip, 0.12, 0.0),
    "worm": (causes.periodic, 0.06, JITTER_DEG),
    "motor steps": (lambda share: causes.motor_steps(1.8, share), 0.08, JITTER_DEG),
    "settling": (causes.settling, 0.01, JITTER_DEG),
    "eccentricity": (causes.eccentricity, 0.3, 0.0),
    "gain": (causes.gain, 0.28, 0.0),
    "offset": (causes.offset_anywhere, 2.1, 0.0),
    "askew": (lambda tilt: causes.askew(5.0, tilt), 2.0, 0.0),
    "slow cycle": (causes.cycle, 0.06, 0.0),
    "kink": (causes.kink, 0.006, 0.0),
    "supply": (causes.supply, 0.25, 0.0),
}
"""By name: the cause of a size, a size at which its shape is that at the limit, jitter of the elevations."""


def at_the_limit(name: str, seed: int) -> list[Pose]:
    """The run of a seed: noise, surroundings and the cause's own sense, instant and phase are drawn."""
    make, trial, jitter_deg = MAKES[name]
    rng = np.random.default_rng([*name.encode(), seed])
    layout = Layout.of(GRID.model_copy(update={"jitter_deg": jitter_deg, "seed": int(rng.integers(2**31))}))
    when = timeline(layout)
    around = surroundings(when.duration_s, rng)

    def cause(size: float):
        return make(size)(np.random.default_rng([1, seed]), when)

    found = distance(shape_deg(layout, cause(trial), around), when.target_deg, WHITE)
    return measure(layout, [cause(trial * math.sqrt(AT_THE_LIMIT / found))], WHITE, rng, around).poses
