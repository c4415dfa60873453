"""A scale or a mount off the stage's axis of rotation: order 1 of the turn at any range of poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.effect import ELEVATION, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import (
    THE_TURN,
    amplitude_and_phase,
    amplitude_within,
    sin_cos,
    turned,
    turns,
    wave_deg,
)

LARGEST_AMPLITUDE_DEG = 30.0
"""The centre off the axis by half of the radius (amplitude = eccentricity/radius, in radians)."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if turns(r):
        s, c = sin_cos(r)
        columns = np.stack([s, c], 1)
        yield Shape(turned(r, columns), ("amplitude_deg", "phase_deg"), series=THE_TURN)


EFFECT = Effect(
    name="stage_eccentricity",
    title="Eccentricity of the stage",
    origin="stage",
    scope="rig",
    covariate=ELEVATION,
    parameters=(Parameter("amplitude_deg", "Amplitude", "°"), Parameter("phase_deg", "Phase", "°")),
    formula="amplitude_deg·sin(θ + phase_deg)",
    forms=_forms,
    on_reading_deg=lambda p: wave_deg(p, p.theta_deg / 360.0),
    in_c=NotInFlight("it belongs to the rig's stage"),
    apart="a unit turned by 90° on the stage keeps it",
    seen_by_gravity="the gyro measures it and |accelerometer| does not",
    remedy="re-centre the scale or the mount on the axis, or correct by the rig error map",
    reported=amplitude_and_phase,
    possible=amplitude_within(LARGEST_AMPLITUDE_DEG),
)
