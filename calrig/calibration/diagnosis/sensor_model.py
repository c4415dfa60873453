"""Fit the model through atan2 itself: the nonlinear part of effects on the sensor's axes and on the gyro.

An offset of 80 mg is 0.18° off to first order, another 0.06° where the mount is 0.8° off level, and 0.14°
with a gain error of 3 %. The gyro's gain acts on moves that effects add as well: it measures a slip of 20° as
20.1°. Gauss and Newton's iteration (Björck, Numerical Methods for Least Squares Problems, 1996, section 9.2)
takes columns linear about the parameters found, and responses less their nonlinear part, so that search,
ranking and report work with a linear fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    model_columns,
    own_columns,
    replaced,
    shares_at,
)
from calrig.calibration.regression.channels import ANGLE, MOVE, NORM, READING, SCALE_UNIT_DEG
from calrig.calibration.regression.effect import (
    TURNS_THE_SENSOR,
    Applied,
    Circumstances,
    VectorError,
    sin_cos,
    turned_vector,
)
from calrig.calibration.regression.noise_model import Fit, fit
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.run_changes import since
from calrig.estimation.angles import FloatArray

STEP = 1e-3
"""Of a coefficient, to see what it does there."""


class NonlinearTerms:
    """The responses beside what is linear in them, of all coefficients (p,).

    `own` is where the coefficients of each member lie among all.
    """

    def __init__(self, r: Responses, members: Sequence[Candidate], own: Sequence[slice]) -> None:
        self._r = r
        self._bent = [
            (member.effect.not_linear, at)
            for member, at in zip(members, own, strict=True)
            if member.effect.not_linear is not None and not member.shape.is_linear and member.changed is None
        ]
        self.bends = bool(self._bent)

    def over(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) what they add."""
        over = np.zeros_like(self._r.values)
        for not_linear, at in self._bent:
            over += self._r.columns(not_linear(self._r, beta[at]))[:, :, 0]
        return over

    def slope(self, beta: FloatArray) -> FloatArray:
        """Return (n, J, p) its derivative, by central differences."""
        slope = np.zeros((*self._r.values.shape, len(beta)))
        for _, at in self._bent:
            for k in range(at.start, at.stop):
                change = np.zeros(len(beta))
                change[k] = STEP
                slope[:, :, k] = (self.over(beta + change) - self.over(beta - change)) / (2.0 * STEP)
        return slope


DELAY_STEP = 1e-5
"""Of a delay, to see what it does there."""


class Delay:
    """What a delay adds to the responses, of all coefficients (p,): all that follows the elevation is late.

    `own` is where the coefficients of each member lie among all; `names` are of the base's columns.
    """

    def __init__(
        self, r: Responses, members: Sequence[Candidate], own: Sequence[slice], names: Sequence[str]
    ) -> None:
        placed = list(zip(members, own, strict=True))
        late = [(m, at) for m, at in placed if m.effect.late_by_deg is not None and m.changed is None]
        self.is_there = bool(late) and not r.is_delayed
        self.late: list[int] = []
        self.moved: list[tuple[Candidate, slice]] = []
        if not self.is_there:
            return
        self._r, (delay, at) = r, late[0]
        self._late_by_deg, self.at = delay.effect.late_by_deg, at.start
        channels = [name for name in (READING, ANGLE) if name in delay.shape.shares and name in r.channels]
        self.late = [r.channels.index(name) for name in channels]
        self.is_of_all: bool = ANGLE not in r.channels or ANGLE in delay.shape.shares
        self._scales = [
            (r.channels.index(name), names.index(f"{name}.scale"))
            for name in channels
            if f"{name}.scale" in names
        ]
        self.moved = [(m, at) for m, at in placed if m.shape.at_elevation is not None]
        self._last: tuple[float, FloatArray, list[FloatArray]] | None = None

    def elevation_deg(self, beta: FloatArray) -> FloatArray:
        """Return (n,) elevations that the readings stand for."""
        return self._at(float(beta[self.at]))[0]

    def _at(self, delay_s: float) -> tuple[FloatArray, list[FloatArray]]:
        """Return (n,) elevations and (n, p) shares there of each moved effect; the last delay's are kept."""
        if self._last is None or self._last[0] != delay_s:
            assert self._late_by_deg is not None  # noqa: S101 (so it was chosen)
            theta_deg = np.asarray(self._r.theta_deg - self._late_by_deg(self._r, delay_s))
            self._last = delay_s, theta_deg, [shares_at(self._r, m, theta_deg) for m, _ in self.moved]
        return self._last[1:]

    def over(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) the delay itself, what it does to the scale, and the effects that it moves."""
        theta_deg, shares = self._at(float(beta[self.at]))
        late_deg = theta_deg - self._r.theta_deg
        over = np.zeros_like(self._r.values)
        over[:, self.late] = late_deg[:, None]
        for channel, k in self._scales:
            over[:, channel] += beta[k] / SCALE_UNIT_DEG * late_deg
        for share, (_, at) in zip(shares, self.moved, strict=True):
            over[:, self.late] += (share @ beta[at])[:, None]
        return over

    def slope(self, beta: FloatArray) -> FloatArray:
        """Return (n, J, p) its derivative, that by the delay as a difference."""
        theta_deg, shares = self._at(float(beta[self.at]))
        slope = np.zeros((*self._r.values.shape, len(beta)))
        change = np.zeros(len(beta))
        change[self.at] = DELAY_STEP * max(abs(float(beta[self.at])), STEP)
        here, last = self.over(beta), self._last
        slope[:, :, self.at] = (self.over(beta + change) - here) / change[self.at]
        self._last = last
        for channel, k in self._scales:
            slope[:, channel, k] = (theta_deg - self._r.theta_deg) / SCALE_UNIT_DEG
        for share, (_, at) in zip(shares, self.moved, strict=True):
            slope[:, self.late, at] = share[:, None]
        return slope


GAIN = f"{MOVE}.gain"


class FeltMoves:
    """The gyro's response beside what is linear in it, of all coefficients (p,).

    Args:
        straight: (n, J, p) columns of the linear model, those of the base first.
        names: of the base's.
        channels: names of the J responses.
    """

    def __init__(self, straight: FloatArray, names: Sequence[str], channels: Sequence[str]) -> None:
        self._shape, self._base = straight.shape, len(names)
        self._gain_at = names.index(GAIN) if GAIN in names else None
        self._at = channels.index(MOVE) if MOVE in channels else 0
        self._effects = straight[:, self._at, self._base :]
        self.bends = self._gain_at is not None and bool(self._effects.any())

    def over(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) what the gain adds."""
        over = np.zeros(self._shape[:2])
        if self.bends:
            over[:, self._at] = self._gain(beta) * (self._effects @ beta[self._base :])
        return over

    def slope(self, beta: FloatArray) -> FloatArray:
        """Return (n, J, p) its derivative."""
        slope = np.zeros(self._shape)
        if self.bends:
            slope[:, self._at, self._base :] = self._gain(beta) * self._effects
            slope[:, self._at, self._gain_at] = self._effects @ beta[self._base :] / SCALE_UNIT_DEG
        return slope

    def _gain(self, beta: FloatArray) -> float:
        return float(beta[self._gain_at]) / SCALE_UNIT_DEG


MOST_STEPS = 8
NEGLIGIBLE = 0.03
"""Of a channel's residuals: what is less than that from being linear is as good as linear."""
DIVERGED = 1e6
"""Of any response, what bends by the coefficients: no reading is thousands of turns away."""
LARGEST_G = 0.5
"""Of an axis' error; a vector with more says nothing of the angle, and the fit stays linear."""
DISTANCE = 30.0
"""In −2 log likelihood, between two names that a search tells from each other."""
KEPT = 8
"""Models that a search may ask for again."""


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A model with its fit, linear about the parameters found.

    Attributes:
        responses, accepted: as the last step saw them; their columns are `columns` (n, J, p).
        fitted: of those; its residuals are those of the measured responses.
        is_bent: whether the last step was linear about the one before, not about none.
    """

    responses: Responses
    accepted: tuple[Candidate, ...]
    columns: FloatArray
    fitted: Fit
    is_bent: bool = False

    def columns_with(self, more: Sequence[Candidate]) -> FloatArray:
        """Return (n, J, p) its columns with some candidates beside it."""
        return model_columns(self.responses, [*self.accepted, *more])


def fitted_model(r: Responses, accepted: Sequence[Candidate]) -> Model:
    """Fit bias, scale and effects, those on the sensor's axes through atan2.

    The columns of `accepted` are linear about none.

    Returns:
        The linear fit where nothing in the model bends by more than the noise shows, or it cannot be bent.
    """
    return _fitted_model(r, tuple(accepted))


@lru_cache(maxsize=KEPT)
def _fitted_model(r: Responses, accepted: tuple[Candidate, ...]) -> Model:
    curve = Curve(r, accepted)
    straight = step = _fitted(r, accepted)
    for _ in range(MOST_STEPS):
        beta = step.fitted.beta
        if curve.is_near(beta, step.fitted.residuals):
            return step
        if not curve.is_possible(beta):
            break
        step = replace(_fitted(*curve.straightened(beta)), is_bent=True)
    return straight


def linear_about(
    r: Responses, accepted: Sequence[Candidate], elsewhere: Model
) -> tuple[Responses, tuple[Candidate, ...]]:
    """Responses and effects whose linear model is exact at the coefficients of a fit to other poses.

    Where that fit could not be bent, nor is its prediction: its coefficients have no other meaning.
    """
    curve, beta = Curve(r, accepted), elsewhere.fitted.beta
    if not elsewhere.is_bent or not curve.is_possible(beta):
        return r, tuple(accepted)
    return curve.straightened(beta)


def parts_deg(r: Responses, accepted: Sequence[Candidate], beta: FloatArray) -> list[FloatArray]:
    """Return (n,) what each of the effects adds to the readings, beside all the others."""
    curve = Curve(r, accepted)
    whole = curve.of_effects(beta)[:, 0]
    parts = []
    for own in curve.own:
        without = beta.copy()
        without[own] = 0.0
        parts.append(whole - curve.of_effects(without)[:, 0])
    return parts


def is_shift_seen(r: Responses, accepted: Sequence[Candidate], shifting: Candidate) -> bool:
    """Return whether effects of the elevation in a model tell whether a backlash or a delay shifts them."""
    moved = [m for c in accepted for m in c.members if m.shape.at_elevation is not None]
    if not moved:
        return False
    model = [*accepted, shifting]
    fitted = fitted_model(r, model).fitted
    there = r.theta_deg + r.sense * parts_deg(r, model, fitted.beta)[-1]
    members = [m for c in model for m in c.members]
    change_deg = np.zeros(len(r))
    for member, at in zip(members, own_columns(model_columns(r, model), members), strict=True):
        if member.shape.at_elevation is not None:
            change = shares_at(r, member, there) - shares_at(r, member, r.theta_deg)
            change_deg += change @ fitted.beta[at]
    noise_deg = np.hypot(fitted.residuals[:, 0].std(), r.rounding[0])
    return bool(change_deg @ change_deg > DISTANCE * noise_deg**2)


def _fitted(r: Responses, accepted: tuple[Candidate, ...]) -> Model:
    columns = model_columns(r, accepted)
    return Model(r, accepted, columns, fit(r, columns))


class Curve:
    """The responses as the function of all coefficients (p,) that they are."""

    def __init__(self, r: Responses, accepted: Sequence[Candidate]) -> None:
        self._r, self._accepted = r, tuple(accepted)
        self._members = [member for candidate in accepted for member in candidate.members]
        self._straight = model_columns(r, accepted)
        self.own = own_columns(self._straight, accepted)
        self._member_at = own_columns(self._straight, self._members)
        self._on_axes = [
            (member, at)
            for member, at in zip(self._members, self._member_at, strict=True)
            if member.effect.on_vector_g is not None and member.effect.on_reading_deg is None
        ]
        self._base_at = [k for k, name in enumerate(r.base_names) if name != replaced(accepted)]
        self._names = [r.base_names[k] for k in self._base_at]
        self._felt, self._size = self._placed()
        self.width = self._straight.shape[2]
        self._largest = np.abs(self._straight).max(axis=(0, 1))
        for _, at in self._on_axes:
            self._straight[:, :, at] = 0.0
        self._moves = FeltMoves(self._straight, self._names, r.channels)
        self._nonlinear_terms = NonlinearTerms(r, self._members, self._member_at)
        self._delay = Delay(r, self._members, self._member_at, self._names)
        if self._delay.is_there:
            self._straight[:, :, self._delay.at] = 0.0
            for _, at in self._delay.moved:
                self._straight[:, self._delay.late, at] = 0.0
        bends = (self._moves.bends, self._nonlinear_terms.bends, self._delay.is_there)
        self.bends = bool(self._on_axes) or any(bends)

    def _placed(self) -> tuple[FloatArray, FloatArray]:
        """Return (n, p) what turns the sensor itself, degrees, and what its vector is longer by, g."""
        felt, size = np.zeros((2, len(self._r), self._straight.shape[2]))
        if not self._on_axes:
            return felt, size
        bound = [k for k, name in enumerate(self._names) if not name.endswith(".first")]
        turns = [
            at
            for member, at in zip(self._members, self._member_at, strict=True)
            if member.effect.origin in TURNS_THE_SENSOR and not member.is_of_sensor(self._r)
        ]
        felt[:, bound] = self._straight[:, 0, bound]
        for at in turns:
            felt[:, at] = self._straight[:, 0, at]
        if NORM in self._r.channels:
            size[:, bound] = self._straight[:, self._r.channels.index(NORM), bound]
        return felt, size

    def is_near(self, beta: FloatArray, residuals: FloatArray) -> bool:
        """Whether residuals (n, J) of a linear fit are what the model leaves, as far as noise can show."""
        return not self.bends or self.bent_by(beta, residuals) < NEGLIGIBLE

    def bent_by(self, beta: FloatArray, residuals: FloatArray) -> float:
        """Of a channel's residuals, how far off they are at most for being those of a linear fit."""
        size = np.hypot(residuals.std(axis=0), self._r.rounding)
        return float((np.abs(self.residuals(beta) - residuals) / size).max())

    def is_possible(self, beta: FloatArray) -> bool:
        """Return whether the vector that is left tells where the sensor points, and no fit diverges."""
        return bool((np.abs(self._bent(beta)) < DIVERGED).all()) and all(
            bool((np.abs(error) < LARGEST_G).all()) for error in self._error(beta, self._felt_deg(beta))
        )

    def of_effects(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) all effects together."""
        base = len(self._names)
        return np.asarray(self._straight[:, :, base:] @ beta[base:] + self._bent(beta))

    def _bent(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) what is not linear in the coefficients."""
        bent = self._on_axes_of(beta) + self._moves.over(beta) + self._nonlinear_terms.over(beta)
        return bent + self._delay.over(beta) if self._delay.is_there else bent

    def residuals(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) what the model leaves of the measured responses."""
        left = self._r.values - self._straight @ beta - self._bent(beta)
        return np.asarray(left * self._r.known)

    def straightened(self, beta: FloatArray) -> tuple[Responses, tuple[Candidate, ...]]:
        """Responses and effects whose linear model is the exact one, and its derivative, at beta."""
        bent, slope = self._bent(beta), self._slope(beta)
        columns = self._straight + slope
        values = self._r.values - bent + slope @ beta
        base = self._r.base.copy()
        base[:, :, self._base_at] = columns[:, :, : len(self._base_at)]
        accepted = tuple(
            replace(candidate, columns=columns[:, :, at])
            for candidate, at in zip(self._accepted, self.own, strict=True)
        )
        straight = replace(self._r, values=values, base=base)
        if self._delay.is_there and self._delay.is_of_all:
            theta_deg = self._delay.elevation_deg(beta)
            straight = replace(straight, theta_deg=theta_deg, is_delayed=True)
        return straight, accepted

    def _error(self, beta: FloatArray, felt_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n,) of a_y and a_z, all effects together."""
        error_y, error_z = np.zeros((2, len(self._r)))
        for member, at in self._on_axes:
            more_y, more_z = self._error_of(member, beta[at], felt_deg)
            error_y, error_z = error_y + more_y, error_z + more_z
        return error_y, error_z

    def _error_of(self, member: Candidate, own: FloatArray, felt_deg: FloatArray) -> VectorError:
        changed = member.changed
        # of what ended the coefficients are those of the runs before, less
        signed = -own if changed is not None and changed.ended else own
        parameters = {**dict(zip(member.shape.parameters, signed.tolist(), strict=True)), **member.shape.at}
        given = Circumstances.of(self._r)
        applied = Applied(member.name, parameters, self._r.theta_deg, given, felt_deg)
        assert member.effect.on_vector_g is not None  # noqa: S101 (so they were chosen)
        error_y, error_z = member.effect.on_vector_g(applied)
        if changed is None:
            return error_y, error_z
        there = np.abs(since(self._r, changed))
        return there * error_y, there * error_z

    def _felt_deg(self, beta: FloatArray) -> FloatArray:
        theta_deg = self._r.theta_deg
        if self._delay.is_there and self._delay.is_of_all:
            theta_deg = self._delay.elevation_deg(beta)
        return np.asarray(theta_deg + self._felt @ beta)

    def _on_axes_of(self, beta: FloatArray) -> FloatArray:
        """Return (n, J) what the effects on the sensor's axes do together."""
        if not self._on_axes:
            return np.zeros_like(self._r.values)
        felt_deg = self._felt_deg(beta)
        turn_deg, length = turned_vector(felt_deg, self._error(beta, felt_deg))
        size = 1.0 + self._size @ beta
        return self._r.columns({READING: turn_deg, ANGLE: turn_deg, NORM: size * (length - 1.0)})[:, :, 0]

    def _slope(self, beta: FloatArray) -> FloatArray:
        """Return (n, J, p) its derivative by the chain rule, of the errors by central differences."""
        felt_deg, size = self._felt_deg(beta), 1.0 + self._size @ beta
        s, c = sin_cos(felt_deg)
        y, z = self._error(beta, felt_deg)
        across, along = y * c - z * s, 1.0 + y * s + z * c
        length = np.hypot(across, along)

        def follow(more: VectorError, less: VectorError, step: float) -> tuple[FloatArray, FloatArray]:
            """Return what angle (°) and length do for a change of the error."""
            by_y, by_z = ((a - b) / (2.0 * step) for a, b in zip(more, less, strict=True))
            more_across, more_along = by_y * c - by_z * s, by_y * s + by_z * c
            turned = (more_across * along - across * more_along) / length**2
            return np.degrees(turned), (across * more_across + along * more_along) / length

        turn, longer = follow(self._error(beta, felt_deg + STEP), self._error(beta, felt_deg - STEP), STEP)
        turn += along / length**2 - 1.0
        longer += np.radians(across / length)
        turns = turn[:, None] * self._felt
        lengths = (size * longer)[:, None] * self._felt + (length - 1.0)[:, None] * self._size
        for member, at in self._on_axes:
            for k in range(at.start, at.stop):
                change = np.zeros(len(beta))
                change[k] = STEP / (self._largest[k] or 1.0)
                more, less = (
                    self._error_of(member, (beta + side)[at], felt_deg) for side in (change, -change)
                )
                turned, lengthened = follow(more, less, change[k])
                turns[:, k] += turned
                lengths[:, k] += size * lengthened
        of_axes = self._r.columns({READING: turns, ANGLE: turns, NORM: lengths})
        slope = of_axes + self._moves.slope(beta) + self._nonlinear_terms.slope(beta)
        return slope + self._delay.slope(beta) if self._delay.is_there else slope
