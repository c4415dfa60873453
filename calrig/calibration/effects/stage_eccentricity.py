"""A scale or a mount off the stage's axis of rotation: order 1 of the turn at any range of poses."""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.effect import (
    ELEVATION,
    Effect,
    Parameter,
    Parameters,
    Shape,
    Wording,
    sin_cos,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import (
    LEAST_TURN_DEG,
    THE_TURN,
    alike_a_drift,
    amplitude_and_phase,
    c_wave,
    goes_round,
    turned,
    turns,
    wave_deg,
)
from calrig.estimation.angles import FloatArray


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if turns(r) and (r.arc_deg < LEAST_TURN_DEG or goes_round(r)):  # not of many turns at the same places
        yield Shape(
            turned(r, _sine_and_cosine(r.theta_deg)),
            ("amplitude_deg", "phase_deg"),
            series=THE_TURN,
            alike=alike_a_drift(r),
            at_elevation=_sine_and_cosine,
        )


def _sine_and_cosine(theta_deg: FloatArray) -> FloatArray:
    return np.stack(sin_cos(theta_deg), 1)


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
    in_c=lambda p: c_wave(p, 1.0),
    apart="a unit turned by 90° on the stage keeps it",
    seen_by_gravity="the gyro measures it and |accelerometer| does not",
    remedy="re-centre the scale or the mount on the axis, or correct by the rig error map",
    reported=amplitude_and_phase,
    # amplitude in radians = eccentricity/radius: with the axis outside the scale, that would turn back
    possible=lambda _shape, beta: bool(np.hypot(*beta[:2]) < np.degrees(1.0)),
    as_sensor=Wording(
        "Eccentricity of the sensor", "correct by the unit's calibration; centre the magnet or the disc"
    ),
)
