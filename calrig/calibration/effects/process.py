"""What mount, time and procedure do: a slip, a drift, a move that has not settled."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.effects.shape import Shape, effect, tilted, turned
from calrig.calibration.responses import ANGLE, MOVE, READING, Responses

EDGE_POSES = 3
"""A slip needs this many poses on either side: fewer are outliers."""
MOST_INSTANTS = 150
"""Beyond so many poses not every gap is tried: a slip is then placed to within a pose or two."""
LEFT_AT_THE_END = (0.1, 0.5, 0.9)
"""Of what the dwell lacks in the mean, for time constants of 0.3, 0.8 and 5 dwells."""


@effect(
    name="time_drift",
    origin="environment",
    covariate="time_s",
    apart="goes on when the temperature does not, and does not come back with it",
    remedy="measure a reference elevation between sweeps and take the drift out",
)
def time_drift(r: Responses) -> Iterator[Shape]:
    """Reading += deg_per_s·t."""
    if r.time_s is not None and np.ptp(r.time_s) > 0.0:
        yield Shape(tilted(r.time_s - r.time_s.min()), ("deg_per_s",))


@effect(
    name="mount_slip",
    origin="mounting",
    covariate="time_s",
    apart="a step at one instant; lost steps of the stage look the same until it is homed again",
    remedy="tighten the mount and repeat; poses before and after do not belong together",
)
def mount_slip(r: Responses) -> Iterator[Shape]:
    """Reading += step from one pose on, between two moves or during one."""
    if r.time_s is None:
        return
    order = np.arange(len(r))
    for k in range(EDGE_POSES, len(r) - EDGE_POSES + 1, 1 + len(r) // MOST_INSTANTS):
        if r.starts[k]:
            continue
        after = (order >= k).astype(float)
        at = {"at_s": float((r.time_s[k - 1] + r.time_s[k]) / 2.0), "pose": float(k)}
        yield Shape(tilted(after), ("step_deg",), form="between moves", at=at)
        if MOVE in r.channels:
            yield Shape(turned(r, after), ("step_deg",), form="during a move", at=at)


@effect(
    name="settling",
    origin="process",
    covariate="move_deg",
    apart="proportional to the last move; unequal steps in random order tell it from backlash",
    remedy="settle longer before the dwell",
)
def settling(r: Responses) -> Iterator[Shape]:
    """Reading −= fraction·move, in the filter alone or in the mount (creep) that the accelerometer sees.

    A creeping mount goes on after the dwell: the gyro feels what is still missing at its end, a share of the
    dwell's mean that depends on how fast it creeps, together with the next move.
    """
    if np.abs(r.move_deg).max() == 0.0:
        return
    yield Shape({READING: -r.move_deg}, ("fraction",), form="filter")
    if ANGLE not in r.channels:
        return
    moves_before = np.roll(r.move_deg, 1)
    moves_before[r.starts] = 0.0
    for share in LEFT_AT_THE_END if MOVE in r.channels else (0.0,):
        # what is missing when the dwell begins goes with the move itself: the gain of the gyro's base has it
        shares = {**tilted(-r.move_deg), MOVE: share * moves_before}
        yield Shape(shares, ("fraction",), form=f"creep, {share:g} left")


@effect(
    name="latency",
    origin="process",
    covariate="velocity",
    apart="proportional to the velocity at the time of the reading",
    remedy="read standing still, or advance the readings by the delay",
)
def latency(r: Responses) -> Iterator[Shape]:
    """Reading −= delay·velocity, of readings taken on the move (a column velocity_dps)."""
    velocity = r.covariates.get("velocity_dps")
    if velocity is not None:
        yield Shape({READING: -velocity, ANGLE: -velocity}, ("delay_s",))
