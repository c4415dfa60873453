"""What the stage does: its play, its centre, its worm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.effects.shape import Shape, effect, sin_cos, turned, turns
from calrig.calibration.responses import ANGLE, MOVE, READING, Responses
from calrig.estimation.angles import FloatArray

SHORTEST_PERIOD_DEG = 2.0
LONGEST_PERIOD_DEG = 60.0


@effect(
    name="backlash",
    origin="stage",
    covariate="approach",
    apart="random order tells it from settling, reversals smaller than it from hysteresis of the mount",
    remedy="approach every elevation from the same side, or take up the play with a spring or a second gear",
)
def backlash(r: Responses) -> Iterator[Shape]:
    """Reading += backlash_deg·approach/2: the table follows its motor with play."""
    if r.approach is not None and {-1.0, 1.0} <= set(r.approach):
        yield Shape(turned(r, r.approach / 2.0), ("backlash_deg",))


@effect(
    name="stage_eccentricity",
    origin="stage",
    covariate="target_deg",
    apart="the gyro feels it and |accelerometer| does not; a unit turned by 90° on the stage keeps it",
    remedy="re-centre the scale or the mount on the axis, or correct by the rig's error map",
)
def stage_eccentricity(r: Responses) -> Iterator[Shape]:
    """Reading += amplitude·sin(θ + phase): scale or mount off the axis of rotation."""
    if turns(r):
        s, c = sin_cos(r)
        yield Shape(turned(r, np.stack([s, c], 1)), ("amplitude_deg", "phase_deg"), polar=True)


@effect(
    name="stage_periodic",
    origin="stage",
    covariate="target_deg",
    apart="its period: jittered elevations tell the periods apart that an exact grid confuses",
    remedy="correct by the rig's error map; look at the worm and its preload",
)
def stage_periodic(r: Responses) -> Iterator[Shape]:
    """Reading += amplitude·sin(360°·θ/period + phase): a worm's or a scale's error, one period each."""
    arc = float(np.ptp(r.theta_deg))
    if arc < 3 * SHORTEST_PERIOD_DEG:
        return
    shortest = SHORTEST_PERIOD_DEG
    step = grid_step_deg(r.theta_deg)
    if step is not None:
        shortest = max(shortest, 2.0 * step)  # shorter ones look like longer ones on an exact grid
    longest = min(LONGEST_PERIOD_DEG, arc / 1.5)
    if longest > shortest:
        for frequency in np.arange(1.0 / longest, 1.0 / shortest + 1e-9, 1.0 / (3.0 * arc)):
            yield periodic_shape(r, float(1.0 / frequency))


def periodic_shape(r: Responses, period_deg: float) -> Shape:
    """A sine of the elevation of one period."""
    here = _waves(r.theta_deg, period_deg)
    felt = here - _waves(r.theta_deg - r.move_deg, period_deg)
    shares = {READING: here, ANGLE: here, MOVE: felt}
    return Shape(shares, ("amplitude_deg", "phase_deg"), at={"period_deg": period_deg}, polar=True)


def _waves(theta_deg: FloatArray, period_deg: float) -> FloatArray:
    phase = 2.0 * np.pi * theta_deg / period_deg
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


def grid_step_deg(theta_deg: FloatArray) -> float | None:
    """The step of an exact grid of elevations, None where they lie on no grid."""
    places = np.unique(np.round(theta_deg, 2))
    if len(places) < 3 or len(places) > 0.6 * len(theta_deg):
        return None
    steps = np.diff(places)
    step = float(steps.min())
    return step if np.abs(steps / step - np.round(steps / step)).max() < 0.05 else None
