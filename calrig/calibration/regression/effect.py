"""Define an effect: everything that its consumers ask of it, and its part of the accelerometer's vector.

An effect is one module of `calrig.calibration.effects`, which binds `EFFECT = Effect(...)`. Search, report,
correction, C header, figures, the page and the rule of acceptance know no effect by name.

At an elevation φ of the sensor itself a faultless one measures a_y = sin φ and a_z = cos φ (g). An error δ of
a_y and ε of a_z turns the angle atan2(a_y, a_z) by atan2(δ·c − ε·s, 1 + δ·s + ε·c). Errors of several effects
add up before they turn it: an offset of 80 mg with a gain error of 3 % is 0.14° off if each turns it alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from calrig.calibration.regression.motion import Motion
from calrig.calibration.regression.responses import Change, Responses
from calrig.estimation.angles import FloatArray

VectorError = tuple[FloatArray | float, FloatArray | float]
"""What is added to a_y and to a_z, g: (n,) each, or a number for all."""

TURNS_THE_SENSOR = frozenset({"stage", "mounting", "environment"})
"""Origins of effects that turn the sensor itself: its axes err at the elevation that they leave."""
OF_SENSOR = "of_sensor"
"""Set among the parameters of an applied effect that is the sensor's own by a good reference."""


@dataclass(frozen=True, slots=True)
class VectorInC:
    """C expressions of what is added to a_y and to a_z, g."""

    y_g: str
    z_g: str


def sin_cos(felt_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n,) a_y and a_z of a sensor without errors at elevations in degrees, g."""
    angle = np.radians(felt_deg)
    return np.sin(angle), np.cos(angle)


def turned_vector(felt_deg: FloatArray, error: VectorError) -> tuple[FloatArray, FloatArray]:
    """Return (n,) the turn of the measured vector by errors of all effects, degrees, and (n,) its length, g.

    `felt_deg` (n,) are elevations of the sensor, `error` is of a_y and a_z, g.
    """
    s, c = sin_cos(felt_deg)
    across, along = error[0] * c - error[1] * s, 1.0 + error[0] * s + error[1] * c
    return np.degrees(np.arctan2(across, along)), np.hypot(across, along)


Origin = Literal["sensor", "stage", "mounting", "process", "environment", "unknown"]
Scope = Literal["unit", "rig", "run"]
Parameters = Mapping[str, float]
"""Values by the contract's names."""
Documents = dict[str, dict[str, float | None] | None]
"""Parameters of a diagnosis: `{"value": …, "std": …}` by name."""

ORIGINS: dict[Origin, str] = {
    "sensor": "the sensor",
    "stage": "the stage",
    "mounting": "the mounting",
    "process": "the procedure",
    "environment": "the surroundings",
    "unknown": "not known",
}
OF = "of_deg"
"""The place that a harmonic's depends on."""
HIDDEN = ("pose", "part", "order", "over_s", "harmonic", "span", "begins", OF)
"""Places that serve the search alone and are in no document."""


class EffectError(TypeError):
    """An effect lacks a part; the message names effect and part."""


class ApplyError(ValueError):
    """An effect cannot be applied: unknown, without a parameter or a covariate it needs, or not to invert."""


@dataclass(frozen=True, slots=True)
class Covariate:
    """What an effect is a function of.

    Attributes:
        name: as documents have it (CONTRACT section 5).
        title, unit: in words, as an axis of a figure; the unit empty where it has none.
        of: (n,) the column in some poses; None where they lack it.
        needs_time: whether it changes as time passes, not by what a plan moves.
    """

    name: str
    title: str
    unit: str
    of: Callable[[Responses], FloatArray | None]
    needs_time: bool = False


APPROACH = Covariate("approach", "approach", "", lambda r: r.approach)
ELEVATION = Covariate("target_deg", "elevation", "°", lambda r: r.theta_deg)
TEMPERATURE = Covariate("temperature_c", "temperature", "°C", lambda r: r.temperature_c, needs_time=True)
TIME = Covariate("time_s", "time", "s", lambda r: r.time_s, needs_time=True)
LAST_MOVE = Covariate("move_deg", "last move", "°", lambda r: r.move_deg)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect; `unit` None is that of the covariate, whatever it is.

    Attributes:
        flag: 1 or absent, and said in the evidence: nothing to show as a number.
    """

    name: str
    title: str
    unit: str | None
    flag: bool = False


@dataclass(frozen=True, slots=True)
class Shape:
    """One form an effect takes in some poses: its columns, linear in the parameters named.

    Attributes:
        shares: (n,) or (n, p) per channel.
        parameters: names of the first columns' coefficients; further columns are the witnesses' own.
        form: which of the effect's forms, where it has several.
        at: parameters that are not coefficients: found by scanning, or a reference.
        scanned: whether the search chose the place among many.
        place_cost: how many parameters that choice counts as: two where neighbouring places differ as an
            instant does from the next, one where they go over into each other.
        covariate: where it is not the effect's.
        replaces: a base column that the effect's own column takes the place of.
        says: what is to be said of this form beside the effect's name.
        part_of: the form with all parameters, where this one has some of them.
        alike: names that such poses do not part it from, however much better it fits.
        claimed_first: of those that are alike and explain the poses as well, this one is claimed.
        is_linear: whether the effect's `not_linear` does not apply to this form.
        follows: as the effect's, in such poses alone.
        at_std: standard errors of the places that were refined.
        series: what it is one term of, where several terms make one cause: a search counts them once.
        beside: covariates that effects in the model must follow before it is offered.
        changed: between which runs, where it is only in the later ones.
        alone: not offered with its effect's companions: of places close together few stand for all.
        knots: (k,) of a curve of the angle, from which a document's values of it can be evaluated.
        at_elevation: what it adds to the reading at elevations (m,), (m,) or (m, p) of each coefficient,
            where it is a function of the elevation alone: a late reading has it at an earlier one.
    """

    shares: Mapping[str, FloatArray]
    parameters: tuple[str, ...]
    form: str = ""
    at: Parameters = field(default_factory=dict)
    scanned: bool = False
    place_cost: int = 2
    covariate: str = ""
    replaces: str | None = None
    says: str = ""
    part_of: str = ""
    alike: tuple[str, ...] = ()
    claimed_first: bool = False
    is_linear: bool = False
    follows: str | None = None
    at_std: Parameters = field(default_factory=dict)
    series: str = ""
    beside: tuple[str, ...] = ()
    changed: Change | None = None
    alone: bool = False
    knots: tuple[float, ...] = ()
    at_elevation: Callable[[FloatArray], FloatArray] | None = None

    @property
    def stated(self) -> frozenset[str]:
        """Names of the parameters that a document has of it."""
        return frozenset({*self.parameters, *self.at} - set(HIDDEN))


class Circumstances:
    """What effects are functions of, in addition to the elevation: columns by name.

    Any column of the poses may be among them under its own name. These have a meaning of their own:

    Args:
        motion: of the stage, of readings taken on the move.
        columns: (n,) each; None where not known of every pose.

    Columns:
        approach: +1, −1; 0 where unknown, to which backlash adds nothing.
        move_deg: θ less the pose before's; NaN for a run's first pose, to which a move adds nothing.
        travel_deg: way since the stage last turned; without it all play is taken up.
        time_s: without it a slip has happened: the unit stands as it stood last.
        kappa: share of a gyro scale error times the move that the filter still shows.
        stretch_deg: how far the stage turned while the pose was read; without it not at all.
    """

    def __init__(self, motion: Motion | None = None, /, **columns: FloatArray | None) -> None:
        self.motion = motion
        self._columns = columns

    @classmethod
    def of(cls, r: Responses) -> Circumstances:
        """Of the poses of a search, what effects on a_y and a_z may follow."""
        return cls(**{**r.covariates, "temperature_c": r.temperature_c})

    def get(self, name: str) -> FloatArray | None:
        """Return (n,) the column of a name; None where it is not known of every pose."""
        return self._columns.get(name)

    def rows(self, chosen: npt.NDArray[np.bool_]) -> Circumstances:
        """Return the circumstances of some of the poses."""
        columns = self._columns.items()
        return Circumstances(**{name: None if one is None else one[chosen] for name, one in columns})


@dataclass(frozen=True, slots=True, eq=False)
class Applied:
    """An effect's parameters at n elevations; what it needs and has not is missed by name.

    Attributes:
        felt_deg: (n,) the elevation of the sensor itself, mount and all: θ where it is not known.
    """

    effect: str
    parameters: Parameters
    theta_deg: FloatArray
    given: Circumstances
    felt_deg: FloatArray | None = None

    def value(self, name: str, default: float | None = 0.0) -> float:
        """Return a parameter; ApplyError where it is absent and has no default."""
        found = self.parameters.get(name, default)
        if found is None:
            raise ApplyError(f"the effect {self.effect} needs its parameter {name}")
        return found

    def column(self, name: str) -> FloatArray:
        """Return (n,) one of the circumstances; ApplyError where it is not known of every pose."""
        values = self.given.get(name)
        if values is None:
            raise ApplyError(f"the effect {self.effect} needs {name} of every pose")
        return values

    def sin_cos(self) -> tuple[FloatArray, FloatArray]:
        """Return what a sensor without errors measures of a_y and a_z, g."""
        return sin_cos(self.theta_deg if self.felt_deg is None else self.felt_deg)

    def warmer_c(self) -> FloatArray:
        """Temperature less the effect's reference."""
        return self.column("temperature_c") - self.value("reference_c", None)

    def moved_deg(self) -> FloatArray:
        """Return the last move; 0 where it is not known."""
        return np.asarray(np.nan_to_num(self.column("move_deg"), nan=0.0), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class NotInFlight:
    """Why an effect has no term in flight software."""

    reason: str


@dataclass(frozen=True, slots=True)
class Wording:
    """What an effect is called, what to do, and whose it is."""

    title: str
    remedy: str
    owner: str = ORIGINS["sensor"]

    @property
    def inside(self) -> str:
        """The title inside a sentence."""
        return f"{self.title[0].lower()}{self.title[1:]}"


def linear(shape: Shape, beta: FloatArray, covariance: FloatArray) -> Documents:
    """Coefficients as they are, with their standard errors."""
    return {
        name: {"value": float(beta[k]), "std": math.sqrt(max(float(covariance[k, k]), 0.0))}
        for k, name in enumerate(shape.parameters)
    }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """One entry of the catalogue.

    Attributes:
        name, origin, covariate: as CONTRACT section 5 has them.
        scope: what it stays with: the unit (applied in flight), the rig (its error map), or one run alone.
        parameters: those of its documents, in their order.
        formula: what is added to the reading, as text.
        forms: the forms it takes in any poses with some of its parameters given: scanned places and
            references are taken from there where they are, else from the poses. None where the poses cannot
            show it. Coefficients among the parameters are ignored: they are fitted.
        on_reading_deg: (n,) the formula, exact where the forms are linear.
        on_vector_g: instead, what the effect adds to a_y and a_z: all effects turn one vector together.
        in_c: the same in C, of `theta` in degrees, `temperature_c`, and the sensor's own `s` and `c`.
        apart, remedy: what separates it from its look-alikes, and what a person can do about it.
        seen_by_gravity: what else separates it where the poses have an accelerometer.
        scan: the places that the search tries; without it one, of no parameters.
        refine: the shape at the best place near a leading one's, in the poses given (the leading one may be
            of more), by a shape's criterion; None where there is nothing to refine.
        place: the parameter among the scanned ones that the likelihood refines between them.
        settled: the places to take for those refined, by their standard errors: a value that is known.
        look_alikes: places that these poses may not tell from a shape's, the likeliest first.
        resolved: where a shape lies, in widths that these poses resolve: two that are less than one apart are
            not both in one model; NaN without a place.
        carried: whether these poses determine the coefficients of a shape together with its place.
        harmonics: places of the further terms of one cause, once a shape that is the first of them is found.
        reported, evidence: a document's parameters of coefficients and covariance; sentences about a shape.
        not_linear: (n,) a channel, what the forms' columns do not say, of the effect's own coefficients.
        late_by_deg: (n,) by how much the elevation changed since the one that a late reading stands for, of
            the effect's coefficient: bias, scale and what follows the elevation are then those of the
            earlier one.
        possible: whether coefficients are any that the physics allows.
        follows: offered by itself only once this effect is in the model.
        together_with: effects that it is offered together with, as one: each alone may look like noise.
        as_sensor: its words if the reference is good; a term of the angle is then the unit's own.
    """

    name: str
    title: str
    origin: Origin
    scope: Scope
    covariate: Covariate
    parameters: tuple[Parameter, ...]
    formula: str
    forms: Callable[[Responses, Parameters], Iterator[Shape]]
    in_c: Callable[[Parameters], str | VectorInC] | NotInFlight
    apart: str
    remedy: str
    seen_by_gravity: str = ""
    on_reading_deg: Callable[[Applied], FloatArray] | None = None
    on_vector_g: Callable[[Applied], VectorError] | None = None
    scan: Callable[[Responses], Iterator[Parameters]] | None = None
    refine: Callable[[Responses, Shape, Callable[[Shape], float]], Shape | None] | None = None
    place: str = ""
    settled: Callable[[Parameters, Parameters], Parameters] = lambda at, _std: at
    look_alikes: Callable[[Responses, Shape], Iterator[Parameters]] = lambda _r, _shape: iter(())
    resolved: Callable[[Responses, Shape], float] | None = None
    carried: Callable[[Responses, Shape], bool] = lambda _r, _shape: True
    harmonics: Callable[[Responses, Shape], Iterator[Parameters]] = lambda _r, _shape: iter(())
    reported: Callable[[Shape, FloatArray, FloatArray], Documents] = linear
    evidence: Callable[[Responses, Shape], list[str]] = lambda _r, _shape: []
    not_linear: Callable[[Responses, FloatArray], Mapping[str, FloatArray]] | None = None
    late_by_deg: Callable[[Responses, float], FloatArray] | None = None
    possible: Callable[[Shape, FloatArray], bool] = lambda _shape, _beta: True
    follows: str | None = None
    together_with: tuple[str, ...] = ()
    as_sensor: Wording | None = None

    def __reduce__(self) -> tuple[Callable[[str], Effect], tuple[str]]:
        """Goes to another process by its name: the catalogue there has it."""
        return _of_the_catalogue, (self.name,)

    def __post_init__(self) -> None:
        for part in fields(self):
            if part.default is MISSING and getattr(self, part.name) in ("", (), None):
                raise EffectError(f"the effect {self.name!r} lacks its {part.name}")
        if self.on_reading_deg is None and self.on_vector_g is None:
            raise EffectError(f"the effect {self.name!r} lacks its on_reading_deg, or its on_vector_g")
        if isinstance(self.in_c, NotInFlight) and not self.in_c.reason:
            raise EffectError(f"the effect {self.name!r} lacks the reason why it is not applied in flight")
        if self.scope != "unit" and self.as_sensor is None and not isinstance(self.in_c, NotInFlight):
            raise EffectError(f"the effect {self.name!r} has a C term, and does not stay with the unit")

    def is_of_sensor(self, covariate: str, *, reference_is_good: bool) -> bool:
        """Return whether it is the sensor's only because the reference is good: a term of the angle."""
        return reference_is_good and self.as_sensor is not None and covariate == ELEVATION.name

    def title_of(self, origin: str) -> str:
        """Return its title where it is of an origin: a term of the angle has another one of the sensor."""
        of_sensor = self.as_sensor is not None and origin == "sensor" and self.origin != "sensor"
        return self.as_sensor.title if of_sensor and self.as_sensor else self.title

    def wording(self, *, reference_is_good: bool, covariate: str = "") -> Wording:
        """Return what it is called, what to do, whose it is; a shape without a name needs its covariate."""
        is_other = self.origin == "unknown" and covariate != ELEVATION.name
        if reference_is_good and self.as_sensor and not is_other:
            return self.as_sensor
        return Wording(self.title, self.remedy, ORIGINS[self.origin])

    def turns_the_sensor(self, parameters: Parameters) -> bool:
        """Return whether an applied effect turns the sensor itself."""
        return self.origin in TURNS_THE_SENSOR and not parameters.get(OF_SENSOR)

    def shapes(self, r: Responses) -> Iterator[Shape]:
        """Return every form at every place that the search considers in these poses."""
        for at in ({},) if self.scan is None else self.scan(r):
            yield from (shape for shape in self.forms(r, at) if self.carried(r, shape))

    def told_apart(self, *, has_accelerometer: bool) -> str:
        """Return what separates it from its look-alikes, by what the poses have."""
        return "; ".join(filter(None, (self.seen_by_gravity * has_accelerometer, self.apart)))

    def documented(self, shape: Shape, beta: FloatArray, covariance: FloatArray) -> dict[str, Any]:
        """A document's `parameters`: what was fitted or refined with its standard error, the rest without."""
        places = {name: float(value) for name, value in shape.at.items() if name not in HIDDEN}
        of_places = {name: {"value": at, "std": shape.at_std.get(name)} for name, at in places.items()}
        return {**self.reported(shape, beta, covariance), **of_places}


def _of_the_catalogue(name: str) -> Effect:
    from calrig.calibration.effects import effect_of

    return effect_of(name)
