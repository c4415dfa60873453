"""What an effect is to the search: the columns it adds to the reading and to every witness of it.

Angles in degrees, s and c sine and cosine of the elevation θ. The equations of the sensor's effects follow
from turning the gravity vector in the sensor's frame, (0, s, c) at elevation θ = atan2(a_y, a_z): an error δ
of a_y and ε of a_z turns the angle by δ·c − ε·s (rad) and lengthens the vector by δ·s + ε·c.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from calrig.calibration.responses import ANGLE, MOVE, READING, Responses
from calrig.estimation.angles import FloatArray

DEG = 180.0 / np.pi


@dataclass(frozen=True, slots=True)
class Shape:
    """One form an effect may take in some poses: its columns, linear in the parameters named.

    Attributes:
        shares: (n,) or (n, p) per channel.
        parameters: names of the first columns' coefficients; further columns are the witnesses' own.
        form: which of the effect's forms, where it has several.
        at: parameters found by scanning.
        polar: the two columns are A·sin and A·cos of something: amplitude and phase are reported.
        replaces: a base column that the effect's own column takes the place of.
        says: what is to be said of this form beside the effect's name.
    """

    shares: Mapping[str, FloatArray]
    parameters: tuple[str, ...]
    form: str = ""
    at: Mapping[str, float] = field(default_factory=dict)
    polar: bool = False
    replaces: str | None = None
    says: str = ""


@dataclass(frozen=True, slots=True)
class Effect:
    """One entry of the catalogue.

    Attributes:
        name, origin, covariate: as CONTRACT section 5 has them.
        shapes: the forms it may take in given poses; none where they cannot show it.
        apart: what separates it from its look-alikes.
        remedy: what a person can do about it.
        follows: offered only once this effect is in the model.
    """

    name: str
    origin: str
    covariate: str
    shapes: Callable[[Responses], Iterator[Shape]]
    apart: str
    remedy: str
    follows: str | None = None


CATALOGUE: list[Effect] = []
"""Every effect calrig has physics for, in the order of their modules."""


def effect(
    *, name: str, origin: str, covariate: str, apart: str, remedy: str, follows: str | None = None
) -> Callable[[Callable[[Responses], Iterator[Shape]]], Effect]:
    """Enters a function that gives an effect's shapes into the catalogue, with what is to be said of it."""

    def enter(shapes: Callable[[Responses], Iterator[Shape]]) -> Effect:
        entry = Effect(name, origin, covariate, shapes, apart, remedy, follows)
        CATALOGUE.append(entry)
        return entry

    return enter


def turned(r: Responses, f: FloatArray) -> dict[str, FloatArray]:
    """What turns the sensor itself: reading and accelerometer see f, the gyro its change."""
    return {READING: f, ANGLE: f, MOVE: r.steps(f)}


def tilted(f: FloatArray) -> dict[str, FloatArray]:
    """What changes the angle too slowly or too seldom for the gyro, or inside the accelerometer."""
    return {READING: f, ANGLE: f}


def turns(r: Responses) -> bool:
    """Whether the poses stand at more than one elevation."""
    return float(np.ptp(r.theta_deg)) > 1.0


def sin_cos(r: Responses) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine of θ."""
    theta = np.radians(r.theta_deg)
    return np.sin(theta), np.cos(theta)
