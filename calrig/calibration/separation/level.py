"""The level of a unit: the angle of its sensor in its case, by reversal.

A seat on the stage's table stands at σ where the dial is at 0. In σ is all that is not the unit's: the zero
of the dial, a base out of level about the stage's axis, the mean of the map, the face of the seat. A unit
is put on it with its x along the axis (+), and with the same face turned by 180° about the vertical (−,
`mount_axis` −x). The table turns by t = dial + map(dial). About an x that points the other way the same turn
counts the other way, and the sensor is turned by λ in its case, about the case's own x, both times:

    elevation of the sensor (+) = +(t + σ) + λ = +t + A₊,    A₊ = λ + σ
    elevation of the sensor (−) = −(t + σ) + λ = −t + A₋,    A₋ = λ − σ

The fit finds A₊ and A₋; half their sum is λ, and σ with all that is in it is gone. What stays:

* the seat and the face do not meet twice alike: A of each clamping has an error of its own, std s, which no
  pose tells from the angle. Of one reversal λ has s/√2 of it. It is stated, or estimated from reversals that
  are repeated; what a face does each time alike (it rocks, it is bent) no repetition shows;
* a base that moved between the two is taken for the unit's, by half of it;
* an axis that is out of level along itself by δ puts sin δ of gravity along the unit's x. By itself that
  shortens y and z by one factor, the common gain; but of a unit that lies askew to the axis by ξ it is δ·ξ on
  y or z (0.3 mg where both are 1°), with the other sign once the unit is reversed, and no parameter has that.
  Beside mounts at 120° and 240° most of it is left of the poses, and some 0.001° of it in the level.

So the calibrated elevation is that of the sensor less λ: that of the case, against gravity.
(Estler, J. Res. NIST 103, 1998, p. 141; Evans, Hocken & Estler, CIRP Annals 45, 1996, p. 617: reversal.)
"""

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calrig.calibration.separation.least_squares import Fit
from calrig.estimation.angles import FloatArray, Intp, wrap_deg

SAME_SEAT_DEG = 5.0
"""An angle that was not stated is that of the nearest seat within this."""
STATED_ALIKE_DEG = 0.01
FARTHEST_DEG = 10.0
"""A clamping that stands farther from its seat, level and all, is not on it, whatever was stated."""
FEWEST_REPEATS = 2
"""A reversal more on the same seat: by a single clamping more it is hardly known how well they repeat."""
SEATS_DEG, STEPS = (1e-5, 20.0), 240
"""How well seats may repeat, and in how many steps the variance goes from one to the other."""
CONTRADICTS = 1e-3
"""Chance of clampings that scatter as widely, were the stated repeatability true."""
WITHIN_TWO = math.erf(math.sqrt(2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The sensor in its case about x, where the unit was reversed.

    Attributes:
        value_deg: elevation of the sensor where the case stands level.
        std_deg: its standard error; None if the repeatability of seat and face is not known.
        seat_std_deg: that repeatability, from one clamping to the next; None if it is unknown.
        seat_from: its source.
        reversals: clampings the other way round, on seats where there are both.
        by_parameters: (p,) of all the model's parameters.
        own_variance: of the level, rad², beside what comes by the parameters.
        contradicted: the clampings scatter more widely than was stated.
    """

    value_deg: float
    std_deg: float | None
    seat_std_deg: float | None
    seat_from: Literal["stated", "repeats"] | None
    reversals: int
    by_parameters: FloatArray
    own_variance: float
    contradicted: bool = False

    @property
    def is_known(self) -> bool:
        """Whether it is known how well it is known."""
        return self.std_deg is not None


def level_of(fit: Fit, unit: int, seat_std_deg: float | None = None) -> Level | None:
    """The level of a unit (by index) by its reversals; None where it was not reversed on any seat.

    `seat_std_deg` is how far a clamping scatters from the next of the same face on the same seat, if stated.
    """
    mounts, seats = _reversed_on(fit, unit)
    if not len(mounts):
        return None
    places = fit.problem.first_mount + mounts
    sense = np.array([fit.problem.table.mounts[k].sense for k in mounts], dtype=np.float64)
    # the fit has sense·A; A = sense·σ + λ, both small: the seats are counted from where they stand about
    apart_deg = sense * wrap_deg(np.degrees(fit.parameters[places]) - seats)
    on_seat = sense[:, None] * (seats[:, None] == np.unique(seats))
    clamped = _Clamped(
        np.radians(apart_deg),
        np.column_stack([on_seat, np.ones(len(mounts))]),
        np.outer(sense, sense) * fit.covariance_at(places),
    )
    found = clamped.found(seat_std_deg)
    by_parameters = np.zeros(fit.problem.size)
    by_parameters[places] = sense * found.weights
    of_fit = float(found.weights @ clamped.covariance @ found.weights)
    return Level(
        value_deg=math.degrees(found.level),
        std_deg=None if found.std is None else math.degrees(found.std),
        seat_std_deg=None if found.seat is None else math.degrees(found.seat),
        seat_from=found.seat_from,
        reversals=int((sense < 0.0).sum()),
        by_parameters=by_parameters,
        own_variance=0.0 if found.std is None else max(found.std**2 - of_fit, 0.0),
        contradicted=found.contradicted,
    )


@dataclass(frozen=True, slots=True)
class _Found:
    """The level and its standard error, and the seat's, rad; `weights` (m,) of the angles in it."""

    weights: FloatArray
    level: float
    std: float | None = None
    seat: float | None = None
    seat_from: Literal["stated", "repeats"] | None = None
    contradicted: bool = False


@dataclass(frozen=True, slots=True)
class _Solved:
    """The level at one variance of the seat: weights (m,) of the angles in it, its variance, what is left.

    `information` is what the angles tell of the seat's variance, twice Fisher's.
    """

    weights: FloatArray
    level: float
    variance: float
    squares: float
    log_likelihood: float
    information: float


@dataclass(frozen=True, slots=True, eq=False)
class _Clamped:
    """Angles A (m,) of a unit's clampings, rad, linear in where the seats stand and, last, in the level.

    Attributes:
        covariance: (m, m) by the poses alone.
    """

    angles: FloatArray
    design: FloatArray
    covariance: FloatArray

    @property
    def spare(self) -> int:
        """Clampings beside seats and level: what tells how well they repeat."""
        return int(len(self.angles) - self.design.shape[1])

    def solved(self, seat_variance: float) -> _Solved:
        """Generalised least squares; the likelihood is restricted to what seats and level leave."""
        whole = self.covariance + seat_variance * np.eye(len(self.angles))
        inverse = np.linalg.inv(whole)
        normal = self.design.T @ inverse @ self.design
        found = np.linalg.solve(normal, self.design.T @ inverse)
        left = self.angles - self.design @ (found @ self.angles)
        squares = float(left @ inverse @ left)
        left_of = inverse - inverse @ self.design @ found
        log_determinant = float(np.linalg.slogdet(whole)[1] + np.linalg.slogdet(normal)[1])
        return _Solved(
            weights=np.asarray(found[-1]),
            level=float(found[-1] @ self.angles),
            variance=float(np.linalg.inv(normal)[-1, -1]),
            squares=squares,
            log_likelihood=-0.5 * (squares + log_determinant),
            information=float((left_of * left_of.T).sum()),
        )

    def found(self, seat_std_deg: float | None) -> _Found:
        """The level, by what was stated of the seat, else by what the clampings tell of it."""
        from scipy.special import chdtrc

        if seat_std_deg is not None:
            seat = math.radians(seat_std_deg)
            one = self.solved(seat**2)
            contradicted = self.spare > 0 and float(chdtrc(self.spare, one.squares)) < CONTRADICTS
            return _Found(one.weights, one.level, math.sqrt(one.variance), seat, "stated", contradicted)
        if self.spare >= FEWEST_REPEATS:
            return self._by_repeats()
        one = self.solved(0.0)
        return _Found(one.weights, one.level)

    def _by_repeats(self) -> _Found:
        """The level where clampings are repeated.

        Few of them tell the seat's variance badly. By Jeffreys' prior of it (Tiao & Tan, Biometrika 52, 1965)
        the level is a mixture of normal distributions, Student's t where the poses tell the angles as well as
        anything: two of the standard errors hold as much of it as two of a normal distribution.
        """
        from scipy.optimize import brentq
        from scipy.special import ndtr

        variances = np.radians(np.geomspace(*SEATS_DEG, STEPS)) ** 2
        each = [self.solved(float(variance)) for variance in variances]
        log = np.array([one.log_likelihood + 0.5 * math.log(one.information) for one in each]) + np.log(
            variances
        )
        shares = np.exp(log - log.max())
        shares /= shares.sum()
        levels, stds = (
            np.array(of) for of in zip(*((o.level, math.sqrt(o.variance)) for o in each), strict=True)
        )
        value = float(shares @ levels)

        def beyond(distance: float) -> float:
            above, below = (value + distance - levels) / stds, (value - distance - levels) / stds
            return float(shares @ (ndtr(above) - ndtr(below))) - WITHIN_TWO

        seat = math.sqrt(float(variances[np.searchsorted(np.cumsum(shares), 0.5)]))
        weights = self.solved(seat**2).weights
        return _Found(weights, value, 0.5 * float(brentq(beyond, 0.0, math.pi)), seat, "repeats")


def _reversed_on(fit: Fit, unit: int) -> tuple[Intp, FloatArray]:
    """(m,) mounts on seats with the unit clamped both ways round, and (m,) where these stand, degrees."""
    table = fit.problem.table
    by_seat: dict[float, list[int]] = defaultdict(list)
    own = [k for k, mount in enumerate(table.mounts) if mount.unit == unit]
    for k in sorted(own, key=lambda k: table.mounts[k].nominal_deg is None):
        at_deg = _seat_deg(fit, k, list(by_seat))
        if abs(wrap_deg(_found_deg(fit, k) - at_deg)) < FARTHEST_DEG:
            by_seat[at_deg].append(k)
    both = {at: same for at, same in by_seat.items() if len({table.mounts[k].sense for k in same}) > 1}
    mounts = np.array([k for same in both.values() for k in same], dtype=np.intp)
    return mounts, np.array([at for at, same in both.items() for _ in same], dtype=np.float64)


def _seat_deg(fit: Fit, k: int, known: list[float]) -> float:
    """Where the seat of a mount stands at the dial's 0: as stated, else as gravity has it."""
    mount = fit.problem.table.mounts[k]
    if mount.nominal_deg is None:
        at_deg, near = _found_deg(fit, k), SAME_SEAT_DEG
    else:
        at_deg, near = float(wrap_deg(mount.nominal_deg)), STATED_ALIKE_DEG
    nearest = min(known, key=lambda other: abs(wrap_deg(at_deg - other)), default=None)
    return nearest if nearest is not None and abs(wrap_deg(at_deg - nearest)) <= near else at_deg


def _found_deg(fit: Fit, k: int) -> float:
    """Where gravity has the seat of a mount, but for the level."""
    return float(wrap_deg(np.degrees(fit.parameters[fit.problem.first_mount + k])))
