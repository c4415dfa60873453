"""Apply a calibration: what accepted effects add to a reading, and readings to calibrated elevations.

The formulas of CONTRACT section 5, exact where the search linearises them. Effects on the accelerometer's
axes act on one vector, at the elevation of the sensor itself. `calrig apply`, `calrig.load`, the C header and
a verification all take a document's arithmetic (CONTRACT section 6) from here.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from calrig.calibration.effects import EFFECTS, UNNAMED, effect_of
from calrig.calibration.line import MIN_SCALE, Line, fit_line
from calrig.calibration.regression.column_units import TIMES
from calrig.calibration.regression.effect import (
    ELEVATION,
    OF_SENSOR,
    TEMPERATURE,
    Applied,
    ApplyError,
    Circumstances,
    NotInFlight,
    Parameters,
    turned_vector,
)
from calrig.calibration.regression.spline import SplineCurve
from calrig.calibration.results.reading_turns import ReadingTurns
from calrig.estimation.angles import FloatArray, elevation_deg, wrap_deg

AppliedEffect = tuple[str, Parameters]
"""An accepted effect: its name and the values of its parameters."""


def own_effect(name: str, parameters: Mapping[str, Any]) -> AppliedEffect:
    """Return an effect of the unit itself, as its document or its acceptance has it.

    A term of the angle that is the stage's elsewhere was accepted with a good reference: it turns no sensor.
    """
    numbers = numbers_of(parameters)
    return name, {**numbers, OF_SENSOR: 1.0} if effect_of(name).scope != "unit" else numbers


ITERATIONS = 60
CONVERGED_DEG = 1e-10
DERIVATIVE_STEP_DEG = 1e-3


def numbers_of(parameters: Mapping[str, Any]) -> dict[str, float]:
    """The values of a diagnosis' parameters ({"value": …, "std": …}) or a calibration's (plain numbers)."""
    values = {
        name: given["value"] if isinstance(given, Mapping) else given for name, given in parameters.items()
    }
    return {name: float(value) for name, value in values.items() if value is not None}


def effects_on_reading_deg(
    effects: Sequence[AppliedEffect],
    theta_deg: FloatArray,
    given: Circumstances | None = None,
    felt_deg: FloatArray | None = None,
) -> FloatArray:
    """Return (n,) what several effects together add to the readings of n poses, degrees.

    Args:
        effects: names of the catalogue, each with values by the contract's names; a value that is absent
            counts as 0, a reference must be there.
        theta_deg: (n,) elevations.
        given: what else the effects depend on.
        felt_deg: (n,) elevations of the sensor itself, bias + scale·θ, at which its axes err; θ where not
            given.

    Raises:
        ApplyError: an effect has no formula, or a covariate or parameter that it needs is not there.
    """
    given = given or Circumstances()
    felt_deg = theta_deg if felt_deg is None else felt_deg
    total = np.zeros(len(theta_deg))
    # a late reading has all other effects at the elevation that it stands for
    late_first = sorted(effects, key=lambda one: effect_of(one[0]).late_by_deg is None)
    for name, parameters in late_first:
        effect = effect_of(name)
        if effect.on_reading_deg is not None:
            added = effect.on_reading_deg(Applied(name, parameters, theta_deg, given))
            total = total + added
            if effect.late_by_deg is not None:
                theta_deg = theta_deg + added
            if effect.turns_the_sensor(parameters) or effect.late_by_deg is not None:
                felt_deg = felt_deg + added
    error_g = error_on_vector_g(effects, theta_deg, given, felt_deg)
    return np.asarray(total + turned_vector(felt_deg, error_g)[0], dtype=np.float64)


def error_on_vector_g(
    effects: Sequence[AppliedEffect], theta_deg: FloatArray, given: Circumstances, felt_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (n,) each, the sum of what effects add to a_y and to a_z, g."""
    error_y, error_z = np.zeros(len(theta_deg)), np.zeros(len(theta_deg))
    for name, parameters in effects:
        on_vector_g = effect_of(name).on_vector_g
        if on_vector_g is not None:
            more_y, more_z = on_vector_g(Applied(name, parameters, theta_deg, given, felt_deg))
            error_y, error_z = error_y + more_y, error_z + more_z
    return error_y, error_z


def fit_line_with_effects(
    theta_deg: FloatArray,
    reading_deg: FloatArray,
    effects: Sequence[AppliedEffect],
    given: Circumstances | None = None,
    *,
    doubts: bool = True,
) -> Line:
    """Return bias and scale of what is left of the readings once the effects are taken out.

    With what they are worth unless `doubts` is False.
    """
    left_deg = reading_deg - effects_on_reading_deg(effects, theta_deg, given)
    line = fit_line(theta_deg, left_deg, doubts=False)
    for _ in range(ITERATIONS):  # where the sensor's axes lie follows from bias and scale themselves
        felt_deg = felt_elevation_deg(theta_deg, line.bias_deg, line.scale)
        left_deg = reading_deg - effects_on_reading_deg(effects, theta_deg, given, felt_deg)
        line = fit_line(theta_deg, left_deg, doubts=False)
        moved = felt_elevation_deg(theta_deg, line.bias_deg, line.scale) - felt_deg
        if not (np.abs(wrap_deg(moved)) > CONVERGED_DEG).any():
            break
    return fit_line(theta_deg, left_deg) if doubts else line


def felt_elevation_deg(theta_deg: FloatArray, bias_deg: float, scale: float | None) -> FloatArray:
    """Return (n,) elevations of the sensor itself, whose axes its errors belong to."""
    return bias_deg + (1.0 if scale is None else scale) * theta_deg


def slope_of_reading(
    theta_deg: FloatArray,
    bias_deg: float,
    scale: float | None,
    effects: Sequence[AppliedEffect],
    given: Circumstances | None = None,
) -> FloatArray:
    """Return (n,) by how many degrees a reading grows per degree of elevation, effects included."""
    behind, ahead = (
        effects_on_reading_deg(effects, at_deg, given, felt_elevation_deg(at_deg, bias_deg, scale))
        for at_deg in (theta_deg - DERIVATIVE_STEP_DEG, theta_deg + DERIVATIVE_STEP_DEG)
    )
    return (1.0 if scale is None else scale) + (ahead - behind) / (2.0 * DERIVATIVE_STEP_DEG)


def unit_slopes(
    theta_deg: FloatArray, line: Line, effects: Sequence[AppliedEffect], given: Circumstances
) -> FloatArray:
    """Return (n,) the unit's `slope_of_reading`; effects of the stage move the unit, and change none."""
    return slope_of_reading(theta_deg, line.bias_deg, line.scale, of_unit(effects), given)


def elevation_errors_deg(
    theta_deg: FloatArray,
    left_deg: FloatArray,
    line: Line,
    effects: Sequence[AppliedEffect],
    given: Circumstances,
) -> FloatArray:
    """Return (n,) the elevations that `calibrated_elevation_deg` gives for readings, less θ.

    Effects of the stage are taken out at θ, which they lead to; those of the unit at the elevation itself.

    `theta_deg` (n,) are elevations of the stage, `left_deg` (n,) what line and effects leave of each reading
    there, on the turn of the stage. Effects are of the unit and of the stage.
    """
    own, felt_deg = of_unit(effects), felt_elevation_deg(theta_deg, line.bias_deg, line.scale)
    added_deg = effects_on_reading_deg(own, theta_deg, given, felt_deg)
    aim_deg = felt_deg - line.bias_deg + added_deg + left_deg
    return _solved_deg(aim_deg, line.bias_deg, line.scale, own, given) - theta_deg


def of_unit(effects: Sequence[AppliedEffect]) -> list[AppliedEffect]:
    """Return those of the effects that are the unit's own, and not the stage's."""
    return [one for one in effects if effect_of(one[0]).scope == "unit" or OF_SENSOR in one[1]]


def calibrated_elevation_deg(
    reading_deg: FloatArray,
    bias_deg: float,
    scale: float | None,
    effects: Sequence[AppliedEffect],
    given: Circumstances | None = None,
    range_deg: tuple[float, float] = (-180.0, 180.0),
    turns: ReadingTurns | None = None,
) -> FloatArray:
    """Return (n,) the θ with reading = bias + scale·θ + effects(θ), to 1e-9°.

    NaN where one reading stands for many elevations, by its effects or by its turns. Newton's iteration from
    the θ without effects; those that depend on the elevation are read at θ itself.

    Args:
        reading_deg: (n,).
        bias_deg: of the line.
        scale: of the line; None is 1.
        effects: each with its parameters.
        given: what the effects follow.
        range_deg: of the calibration: it decides between angles that differ by whole turns.
        turns: which of these is meant; by the range alone where not given.

    Raises:
        ApplyError: the scale is 0.
    """
    factor = 1.0 if scale is None else scale
    if abs(factor) < MIN_SCALE:
        raise ApplyError(f"the scale is {factor:g}: the reading does not follow the elevation")
    aim = (turns or ReadingTurns(bias_deg, factor, range_deg)).aim_deg(reading_deg)
    return _solved_deg(aim, bias_deg, scale, effects, given)


def _solved_deg(
    aim: FloatArray,
    bias_deg: float,
    scale: float | None,
    effects: Sequence[AppliedEffect],
    given: Circumstances | None,
) -> FloatArray:
    """Return (n,) the θ with aim = scale·θ + effects(θ), NaN where there is none or more than one."""
    factor = 1.0 if scale is None else scale
    theta = aim / factor
    stands_for_many = np.isnan(aim)
    for _ in range(ITERATIONS):
        felt_deg = felt_elevation_deg(theta, bias_deg, scale)
        here = factor * theta + effects_on_reading_deg(effects, theta, given, felt_deg)
        slope = slope_of_reading(theta, bias_deg, scale, effects, given)
        stands_for_many |= slope * factor <= 0.0
        step = np.where(stands_for_many, 0.0, (aim - here) / np.where(stands_for_many, 1.0, slope))
        theta = theta + step
        moving = np.abs(step) > CONVERGED_DEG
        if not moving.any():
            break
    return np.where(stands_for_many | moving, np.nan, theta)


SMALL = 1e-2
"""Of a standard error, a step for derivatives."""
WITHIN_STDS, WITHIN_SHARE = 2.0, 0.01
"""Of standard uncertainties, or of the range: beyond its end by no more, an elevation is as good as there."""
HELD_BY_MATRIX = frozenset({"accelerometer_offset", "axis_mismatch", "axis_nonlinearity"})
"""Effects that say of the axes what an accelerometer's bias and matrix say."""


def effects_at_rest(document: Mapping[str, Any]) -> tuple[list[AppliedEffect], list[str]]:
    """The effects that a unit at rest shows, with their values, and the names of those that it does not.

    Raises:
        ApplyError: an effect has no formula.
    """
    taken: list[AppliedEffect] = []
    left_out: list[str] = []
    for effect in document["effects"]:
        name = str(effect["name"])
        if name not in EFFECTS or (
            name == UNNAMED and SplineCurve.of(numbers_of(effect["parameters"])) is None
        ):
            raise ApplyError(f"the effect {name!r} has no formula of its own that could be applied")
        if isinstance(effect_of(name).in_c, NotInFlight):
            left_out.append(name)
        else:
            taken.append(own_effect(name, effect["parameters"]))
    return taken, left_out


def columns_followed(effects: Sequence[AppliedEffect]) -> list[str]:
    """Return names of the columns beside the elevation that effects of a unit at rest are functions of."""
    covariates = [effect_of(name).covariate for name, _ in effects if name != UNNAMED]  # that is a curve of θ
    followed = [one.name for one in covariates if one is not ELEVATION]
    return sorted({column for name in followed for column in name.split(TIMES)})


def reference_temperature_c(document: Mapping[str, Any], effects: Sequence[AppliedEffect]) -> float | None:
    """Return the temperature that a table without temperatures is for.

    That of the effects where they have one, their mean where they have several; else the middle of the
    calibration's. None where no temperature is known.
    """
    stated = {parameters["reference_c"] for _, parameters in effects if "reference_c" in parameters}
    warmth = document.get("temperature_c") or {}
    known = sorted(stated) or [value for end in ("min", "max") if (value := warmth.get(end)) is not None]
    return math.fsum(known) / len(known) if known else None


def _given(temperature_c: FloatArray | None, others: Mapping[str, FloatArray] | None) -> Circumstances:
    return Circumstances(**{**(others or {}), TEMPERATURE.name: temperature_c})


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """What a document's `joint_covariance` says, of the effects that a unit at rest shows.

    Attributes:
        parameters: of effects, each with the place of its effect among these.
        matrix: (2 + p, 2 + p) covariance of bias, scale and parameters.
        scatter_deg: of a reading.
    """

    parameters: Sequence[tuple[int, str]]
    matrix: FloatArray
    scatter_deg: float

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self | None:
        found = document.get("joint_covariance")
        if found is None:
            return None
        at_rest = [not isinstance(effect_of(one["name"]).in_c, NotInFlight) for one in document["effects"]]
        parsed = [re.fullmatch(r"effects\[(\d+)\]\.(\w+)", name) for name in found["parameters"]]
        stated = [(k, int(one[1]), one[2]) for k, one in enumerate(parsed) if one and at_rest[int(one[1])]]
        kept = [0, 1, *(k for k, _, _ in stated)]
        matrix = _array(found["matrix"], len(parsed), len(parsed))[np.ix_(kept, kept)]
        parameters = [(sum(at_rest[:effect]), name) for _, effect, name in stated]
        return cls(parameters, matrix, float(found["scatter_deg"]))

    def derivatives(
        self,
        theta_deg: FloatArray,
        bias_deg: float,
        scale: float,
        effects: Sequence[AppliedEffect],
        given: Circumstances,
    ) -> FloatArray:
        """Return (2 + p, n) derivatives of the readings by the parameters, by central differences."""
        felt_deg = felt_elevation_deg(theta_deg, bias_deg, scale)
        found = [np.ones_like(theta_deg), theta_deg]
        for (k, name), std in zip(self.parameters, np.sqrt(np.diag(self.matrix))[2:], strict=True):
            step = SMALL * float(std) or SMALL
            over, under = (
                effects_on_reading_deg(
                    [
                        (one, {**values, name: values[name] + by} if place == k else values)
                        for place, (one, values) in enumerate(effects)
                    ],
                    theta_deg,
                    given,
                    felt_deg,
                )
                for by in (step, -step)
            )
            found.append((over - under) / (2.0 * step))
        return np.stack(found)


@dataclass(frozen=True, slots=True, eq=False)
class Application:
    """A document, ready for many readings.

    Attributes:
        bias_deg, scale: of the line.
        effects: those taken out, with their values.
        accelerometer: bias (3,) in g and matrix (3, 3), true = matrix·(raw − bias), where elevations follow
            from it alone; None where bias, scale and effects are what there is to apply.
        range_deg: of elevation.
        turns: which of the angles that differ by whole turns is meant.
        temperature_c: lowest and highest of the calibration; None where not known.
        type_a_deg: standard uncertainty of an elevation from one reading, its mean over the range; NaN where
            not known, and so below.
        type_b_deg: what the reference is worth.
        covariance: (2, 2) of bias and scale.
        joint: of bias, scale and parameters of effects, which takes its place where the document has it.
        map_std: elevations and their standard errors, relative to the mean, which take the place of
            `type_b_deg` where the document has them.
        level_std_deg: of the level, where it is known.
    """

    bias_deg: float
    scale: float
    effects: Sequence[AppliedEffect]
    accelerometer: tuple[FloatArray, FloatArray] | None
    range_deg: tuple[float, float]
    turns: ReadingTurns
    temperature_c: tuple[float, float] | None
    type_a_deg: float
    type_b_deg: float
    covariance: FloatArray
    joint: _Joint | None
    map_std: tuple[FloatArray, FloatArray] | None
    level_std_deg: float

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """Return what a document says.

        Raises:
            ApplyError: an effect has no formula, bias or scale are not known, or it is no such document.
        """
        if document["bias_deg"] is None or document["scale"] is None:
            raise ApplyError("bias or scale is not known: there is nothing to apply")
        try:
            return cls._of(document)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            if isinstance(error, ApplyError):
                raise
            raise ApplyError(f"it is no calibration as `calrig export` prints one ({error})") from error

    @classmethod
    def _of(cls, document: Mapping[str, Any]) -> Self:
        if not MIN_SCALE <= abs(document["scale"]) <= 1.0 / MIN_SCALE:
            raise ApplyError(f"the scale is {document['scale']:g}: the reading does not follow the elevation")
        effects, _ = effects_at_rest(document)
        worth, warmth = document.get("uncertainty") or {}, document.get("temperature_c") or {}
        grid, covariance = document.get("elevation_std_deg"), document.get("covariance")
        ends = [warmth.get(end) for end in ("min", "max")]
        return cls(
            bias_deg=float(document["bias_deg"]),
            scale=float(document["scale"]),
            effects=effects,
            accelerometer=_accelerometer(document, effects),
            range_deg=(float(document["range_deg"][0]), float(document["range_deg"][1])),
            turns=ReadingTurns.of_document(document),
            temperature_c=None if None in ends else (float(ends[0]), float(ends[1])),  # type: ignore[arg-type]
            type_a_deg=_number(worth.get("type_a_deg")),
            type_b_deg=_number(worth.get("type_b_deg")),
            covariance=np.zeros((2, 2)) if covariance is None else _array(covariance, 2, 2),
            joint=_Joint.of_document(document),
            map_std=None if grid is None else _curve(grid["elevation_deg"], grid["std_deg"]),
            level_std_deg=float(document.get("level_std_deg") or 0.0) if document.get("level_known") else 0.0,
        )

    @property
    def columns(self) -> list[str]:
        """Names of the columns that effects follow, those of a product each."""
        return columns_followed(self.effects)

    def reading_of_deg(self, accel_g: FloatArray) -> FloatArray:
        """(n,) the reading that (n, 3) accelerations stand for, g; x is needed with `accelerometer` alone."""
        if self.accelerometer is not None and not np.isnan(accel_g[:, 0]).any():
            bias_g, matrix = self.accelerometer
            accel_g = (accel_g - bias_g) @ matrix.T
        return elevation_deg(accel_g)

    def elevation_deg(
        self,
        reading_deg: FloatArray,
        temperature_c: FloatArray | None,
        others: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray:
        """Return (n,) elevations; NaN where a reading stands for many.

        Args:
            reading_deg: (n,).
            temperature_c: (n,), or None where it is not known.
            others: (n,) each, further columns that effects follow, by name.

        Raises:
            ApplyError: an effect lacks a column or a parameter.
        """
        given = _given(temperature_c, others)
        return calibrated_elevation_deg(
            reading_deg, self.bias_deg, self.scale, self.effects, given, turns=self.turns
        )

    def std_deg(
        self,
        elevation_deg: FloatArray,
        temperature_c: FloatArray | None = None,
        others: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray:
        """Return (n,) standard uncertainty (k = 1) of elevations relative to their mean over the range.

        Each from one reading as noisy as those of the calibration. NaN beyond the range, and where the
        document does not know it. With C the covariance of bias and scale (GUM, JCGM 100:2008, 5.2.2), of
        u²(θ) = type_a² + ((1 θ)·C·(1 θ)ᵀ − its mean over the range)/scale² + type_b²
        the root of the mean over the range, times the document's k, is its expanded uncertainty. With effects
        u²(θ) = (s² + g·C·gᵀ)/slope(θ)² + type_b², C of all parameters, g the reading's derivatives by them.

        Args:
            elevation_deg: (n,).
            temperature_c: as of `elevation_deg`; where effects lack a column, it is the mean over the range.
            others: likewise.
        """
        at_deg = np.clip(elevation_deg, *self.range_deg)
        given = _given(temperature_c, others)
        if self.map_std is not None:
            variance = np.interp(at_deg, *self.map_std) ** 2 + self.type_a_deg**2
        elif self.joint is not None:
            variance = self._joint_variance_deg2(self.joint, at_deg, given) + self.type_b_deg**2
        else:
            low, high = self.range_deg
            powers = np.array(
                [[1.0, (low + high) / 2], [(low + high) / 2, (low**2 + low * high + high**2) / 3]]
            )
            here = np.stack([np.ones_like(at_deg), at_deg])
            of_line = np.einsum("in,ij,jn->n", here, self.covariance, here) - np.sum(powers * self.covariance)
            variance = of_line / self.scale**2 + self.type_b_deg**2 + self.type_a_deg**2
        std_deg = np.sqrt(np.maximum(variance + self.level_std_deg**2, 0.0))
        return np.where(np.abs(elevation_deg - at_deg) > self._tolerated_deg(std_deg), np.nan, std_deg)

    def _joint_variance_deg2(self, joint: _Joint, at_deg: FloatArray, given: Circumstances) -> FloatArray:
        """Return (n,) variance of elevations by scatter, bias, scale and effects; NaN at none."""
        try:
            slope = slope_of_reading(at_deg, self.bias_deg, self.scale, self.effects, given)
            reading = joint.derivatives(at_deg, self.bias_deg, self.scale, self.effects, given)
        except ApplyError:
            return np.full(len(at_deg), self.type_a_deg**2)
        of_curve = np.einsum("in,ij,jn->n", reading, joint.matrix, reading)
        return np.asarray((joint.scatter_deg**2 + of_curve) / slope**2)

    def beyond_range(self, elevation_deg: FloatArray) -> FloatArray:
        """Return (n,) how far elevations are beyond the range, degrees; 0 where that is hardly so."""
        at_deg = np.clip(elevation_deg, *self.range_deg)
        beyond = np.abs(elevation_deg - at_deg)
        return np.where(beyond > self._tolerated_deg(self.std_deg(at_deg)), beyond, 0.0)

    def _tolerated_deg(self, std_deg: FloatArray) -> FloatArray:
        width = self.range_deg[1] - self.range_deg[0]
        return np.maximum(WITHIN_STDS * np.nan_to_num(std_deg), WITHIN_SHARE * width)

    def beyond_temperatures(self, temperature_c: FloatArray) -> FloatArray:
        """(n,) how far temperatures are beyond those of the calibration, °C; 0 where these are not known."""
        if self.temperature_c is None:
            return np.zeros(len(temperature_c))
        return np.abs(temperature_c - np.clip(temperature_c, *self.temperature_c))


def _accelerometer(
    document: Mapping[str, Any], effects: Sequence[AppliedEffect]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the matrix, unless line and effects hold the axes' errors already: they are taken out once."""
    found = document.get("accelerometer")
    by_effects = any(name in HELD_BY_MATRIX for name, _ in effects)
    is_plain = document["bias_deg"] == 0.0 and document["scale"] == 1.0 and not by_effects
    return (_array(found["bias_g"], 3), _array(found["matrix"], 3, 3)) if found and is_plain else None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _array(values: Sequence[Any], *shape: int) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{array.shape} numbers where there are {shape}")
    return array


def _curve(at: Sequence[float], values: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    return _array(at, max(len(at), 1)), _array(values, len(at))
