"""The stage map: the error of the stage's angle over its dial, as a rig's reference and by its series.

    map(ψ, approach) = Σ (a_k·cos kψ + b_k·sin kψ) + backlash/2·approach

There is no k = 0: a constant belongs to the mounts. An order need not be a whole number: a worm gear of
period P has order 360°/P.

A `StageMap` is the series with the covariance of its coefficients. An elevation is then dial + map(dial,
approach). What remains uncertain is the map's own error δ: one smooth curve that all poses share, correlated
between them by the covariance. √n does not shrink it; only its shape over these very poses does. The map's
mean over its dial is no part of it, because each clamping has another one (level_known false): it is taken
off values and covariance alike.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.regression.terms import covered
from calrig.calibration.uncertainty.conformity import deg
from calrig.canonical_json import sha256_of
from calrig.estimation.angles import FloatArray
from calrig.model.result import Reference

TURN_DEG = 360.0
HIGHEST_ORDER = 24
LARGEST_RAD = np.radians(8.0)
"""Amplitudes of 0.1° to 8° are on record of real axes."""
LARGEST_BACKLASH_RAD = np.radians(5.0)
ROUND_DEG = 330.0
"""Dial angles over such an arc go round: the orders of the turn come apart."""
SAME_DIAL_DEG = 0.01
GRID_DEG = 2.0
MAP_SCHEMA = "calrig.stage-map/1"
MARGIN_DEG = 1.0
"""A pose may stand so far beyond the dial angles that the map was made over: half of its own steps."""
TAPER_DEG = 2.0
"""Beyond the margin of a region, over which its standard deviation falls to nothing."""
WIDEST_GAP_DEG = TURN_DEG / HIGHEST_ORDER / 2.0
"""Half a wave of the highest order: what the stage does in a wider gap, no pose beside it shows."""
NEAR_DEG = 0.5
"""From a visited angle, within which the map is given at the side of a wider gap."""
_RESTS = ("units", "unit"), ("solved_from", "run")
_LEAST_EIGENVALUE = -1e-9
"""Of a covariance, as a share of its greatest: what rounding leaves."""


def basis(dial_deg: FloatArray, approach: FloatArray, orders: Sequence[float]) -> FloatArray:
    """(n, 2m + 1) columns of the map: cosine and sine of each order, then half the approach."""
    turn = np.radians(dial_deg)[:, None] * np.asarray(orders, dtype=np.float64)
    waves = np.stack([np.cos(turn), np.sin(turn)], axis=2).reshape(len(dial_deg), -1)
    return np.concatenate([waves, 0.5 * approach[:, None]], axis=1)


def goes_round(dial_deg: FloatArray) -> bool:
    """Whether the angles leave no wide gap on the dial."""
    return covered(dial_deg) >= ROUND_DEG


def resolved_orders(dial_deg: FloatArray) -> list[float]:
    """Whole orders of a map that such poses can tell, each by itself."""
    highest = min(HIGHEST_ORDER, highest_identifiable_order(dial_deg))
    return [float(order) for order in range(1, int(highest) + 1)]


def highest_identifiable_order(dial_deg: FloatArray) -> float:
    """The highest order that such poses can tell by itself: half the density of the angles."""
    arc_deg = covered(dial_deg)
    apart = np.unique(np.round(np.mod(dial_deg, TURN_DEG) / SAME_DIAL_DEG))
    spacing_deg = max(arc_deg, SAME_DIAL_DEG) / max(len(apart) - 1, 1)
    return (TURN_DEG / spacing_deg - 1.0) / 2.0


def dial_grid_deg(dial_deg: FloatArray) -> FloatArray:
    """(m,) angles over the part of the dial where poses stood: a turn once, an arc with both its ends."""
    if goes_round(dial_deg):
        return np.arange(-TURN_DEG / 2.0, TURN_DEG / 2.0, GRID_DEG)
    low, high = dial_deg.min(), dial_deg.max()
    if high - low >= TURN_DEG:  # an arc across the turn's end, counted from where no pose stood
        at = np.sort(np.mod(dial_deg, TURN_DEG))
        first = int(np.diff(at, append=at[0] + TURN_DEG).argmax()) + 1
        low = at[first % len(at)]
        high = low + covered(dial_deg)
    return np.linspace(low, high, max(round((high - low) / GRID_DEG), 1) + 1)


def undetermined_gaps(dial_deg: FloatArray) -> tuple[tuple[float, float], ...]:
    """Parts of the dial between visited angles that lie too far apart to show the map between them."""
    at = np.unique(np.mod(dial_deg + TURN_DEG / 2.0, TURN_DEG)) - TURN_DEG / 2.0
    at = np.append(at, at[0] + TURN_DEG)
    wide = np.flatnonzero(np.diff(at) > WIDEST_GAP_DEG)
    if not goes_round(dial_deg):  # beyond the arc there is no map at all
        wide = wide[wide != np.diff(at).argmax()]
    return tuple((float(at[k]) + NEAR_DEG, float(at[k + 1]) - NEAR_DEG) for k in wide)


def inside_gaps(
    dial_deg: FloatArray, gaps_deg: Sequence[tuple[float, float]]
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(n,) whether angles lie in such a gap."""
    found = np.zeros(len(dial_deg), dtype=np.bool_)
    for low, high in gaps_deg:
        beyond = np.mod(dial_deg - low, TURN_DEG)
        found |= (beyond > 0.0) & (beyond < high - low)
    return found


@dataclass(frozen=True, slots=True)
class Region:
    """A part of the dial where the stage is off locally: first and last angle, and the largest residual."""

    from_deg: float
    to_deg: float
    std_deg: float

    def stds_deg(self, dial_deg: FloatArray) -> FloatArray:
        """(n,) what the region adds at angles of the dial: full up to the margin, then falling to 0."""
        middle, half = 0.5 * (self.from_deg + self.to_deg), 0.5 * (self.to_deg - self.from_deg)
        off = np.abs(np.mod(dial_deg - middle + TURN_DEG / 2.0, TURN_DEG) - TURN_DEG / 2.0)
        return np.asarray(self.std_deg * np.clip(1.0 - (off - half - MARGIN_DEG) / TAPER_DEG, 0.0, 1.0))


class MapError(ValueError):
    """It is no stage's map that can be used; the message says what is wrong with it."""


@dataclass(frozen=True, slots=True, eq=False)
class StageMap:
    """A map that was solved for.

    Attributes:
        orders: of the series; whole numbers of the turn, or 360° over a gear's period.
        coefficients_deg: (p,) cosine and sine of each order, then the play.
        covariance_deg2: (p, p) of those.
        dial_deg: (m,) the dial's angles that it was made over, ascending by equal steps.
        sha256: of its document.
        units, sources: what it rests on.
        regions: where the stage is off locally.
        gaps_deg: parts of the dial between visited angles where the map is not determined.
    """

    orders: tuple[float, ...]
    coefficients_deg: FloatArray
    covariance_deg2: FloatArray
    dial_deg: FloatArray
    sha256: str
    units: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    regions: tuple[Region, ...] = ()
    gaps_deg: tuple[tuple[float, float], ...] = ()

    @classmethod
    def from_document(cls, document: object) -> Self:
        """The map of a `stage-map.json`.

        Raises:
            MapError: it is none, was changed since it was made, is not finite, or is not known: the poses
                that it was solved from did not part the stage from its units.
        """
        if not isinstance(document, dict) or document.get("schema") != MAP_SCHEMA:
            raise MapError(f"is no stage's map (its schema is not {MAP_SCHEMA!r})")
        try:
            if document["sha256"] != sha256_of(document):
                raise MapError("was changed since it was made: its sha256 is another one")
            if document["separable"] is not True:
                raise MapError("is of poses that do not part the stage from its units (`separable` is false)")
            dial = np.array(document["map"]["stage_deg"], dtype=np.float64)
            return cls._checked(document, np.array(document["covariance_deg2"], dtype=np.float64), dial)
        except MapError:
            raise
        except (KeyError, TypeError, ValueError) as error:
            raise MapError(f"is not as calrig makes it ({type(error).__name__}: {error})") from error

    @classmethod
    def from_frozen(cls, frozen: Mapping[str, Any]) -> Self:
        """What `frozen` gave."""
        size = len(frozen["coefficients_deg"])
        covariance = np.zeros((size, size))
        below = np.tril_indices(size)
        low, high = frozen["dial_deg"]
        covariance[below] = covariance.T[below] = frozen["covariance_deg2"]
        return cls._checked(frozen, covariance, np.linspace(low, high, frozen["dial_steps"]))

    @classmethod
    def _checked(cls, told: Mapping[str, Any], covariance: FloatArray, dial: FloatArray) -> Self:
        orders, coefficients = (
            np.array(told[key], dtype=np.float64) for key in ("orders", "coefficients_deg")
        )
        size = 2 * len(orders) + 1
        if orders.ndim != 1 or coefficients.shape != (size,) or covariance.shape != (size, size):
            raise MapError(f"has {len(orders)} orders and not the {size} coefficients that go with them")
        if dial.ndim != 1 or len(dial) < 2:
            raise MapError("does not say over which angles of the dial it was made")
        if not all(np.isfinite(part).all() for part in (orders, coefficients, covariance, dial)):
            raise MapError("has a number in it that is not finite")
        values = np.linalg.eigvalsh(covariance)
        if not np.allclose(covariance, covariance.T) or values[0] < _LEAST_EIGENVALUE * max(values[-1], 0.0):
            raise MapError("has a covariance that is none")
        dial = np.linspace(dial[0], dial[-1], len(dial))
        names = tuple(map(str, told.get("units", ()))), tuple(map(str, told.get("solved_from", ())))
        regions = tuple(
            Region(*(float(one[key]) for key in ("from_deg", "to_deg", "std_deg")))
            for one in told.get("regions", ())
        )
        gaps = tuple((float(low), float(high)) for low, high in told.get("undetermined_deg", ()))
        orders_of = tuple(orders.tolist())
        return cls(orders_of, coefficients, covariance, dial, str(told["sha256"]), *names, regions, gaps)

    def frozen(self) -> dict[str, Any]:
        """All that a run keeps of the map it was made by, so that no result ever changes; for JSON."""
        return {
            "sha256": self.sha256,
            "orders": list(self.orders),
            "coefficients_deg": self.coefficients_deg.tolist(),
            "covariance_deg2": self.covariance_deg2[np.tril_indices(len(self.coefficients_deg))].tolist(),
            "dial_deg": [float(self.dial_deg[0]), float(self.dial_deg[-1])],
            "dial_steps": len(self.dial_deg),
            "std_deg": self.std_deg,
            "units": list(self.units),
            "solved_from": list(self.sources),
            **local_document(self.regions, self.gaps_deg),
        }

    @property
    def known_deg(self) -> FloatArray:
        """Angles of its dial where it is determined; the ends of the gaps where each of them lies in one."""
        known = self.dial_deg[~inside_gaps(self.dial_deg, self.gaps_deg)]
        return known if len(known) else np.unique(np.array(self.gaps_deg))

    @property
    def std_deg(self) -> float:
        """Standard uncertainty over the dial's range, root mean square."""
        dial = self.known_deg
        return float(np.sqrt(np.mean(self.stds_deg(dial, np.zeros(len(dial))) ** 2)))

    def stds_deg(self, dial_deg: FloatArray, approach: FloatArray) -> FloatArray:
        """(n,) standard uncertainty at angles of the dial; approach 0 is the middle of the play."""
        columns = self.columns(dial_deg, approach)
        variance = np.einsum("ij,jk,ik->i", columns, self.covariance_deg2, columns)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0) + local_variance_deg2(self.regions, dial_deg)))

    def correction_deg(self, dial_deg: FloatArray, approach: FloatArray) -> FloatArray:
        """(n,) what the elevation is more than the dial says."""
        return np.asarray(self.columns(dial_deg, approach) @ self.coefficients_deg)

    def columns(self, dial_deg: FloatArray, approach: FloatArray) -> FloatArray:
        """(n, p) by its coefficients, the mean over where it is determined removed."""
        known = self.known_deg
        level = basis(known, np.zeros(len(known)), self.orders).mean(axis=0)
        return np.asarray(basis(dial_deg, approach, self.orders) - level)

    def covers(self, dial_deg: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(n,) whether the map was made there: beyond, a series is a guess that no covariance tells of."""
        low, high = float(self.dial_deg[0]), float(self.dial_deg[-1])
        step = (high - low) / (len(self.dial_deg) - 1)
        whole = all(order.is_integer() for order in self.orders)
        if whole and high - low + step >= TURN_DEG:
            return np.asarray(~inside_gaps(dial_deg, self.gaps_deg))
        beyond = dial_deg - (low - MARGIN_DEG)
        beyond = np.mod(beyond, TURN_DEG) if whole else beyond  # a gear stands otherwise a turn later
        inside = (beyond >= 0.0) & (beyond <= high - low + 2.0 * MARGIN_DEG)
        return np.asarray(inside & ~inside_gaps(dial_deg, self.gaps_deg))


def inside_regions(dial_deg: FloatArray, regions: Sequence[Region]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(n,) whether angles lie in a region or its margin."""
    found = np.zeros(len(dial_deg), dtype=np.bool_)
    for region in regions:
        beyond = np.mod(dial_deg - region.from_deg + MARGIN_DEG, TURN_DEG)
        found |= beyond <= region.to_deg - region.from_deg + 2.0 * MARGIN_DEG
    return found


def local_variance_deg2(regions: Sequence[Region], dial_deg: FloatArray) -> FloatArray:
    """(n,) what local errors add to the variance of a map, each angle for itself."""
    found = np.zeros(len(dial_deg))
    for region in regions:
        found += region.stds_deg(dial_deg) ** 2
    return found


def local_document(
    regions: Sequence[Region], gaps_deg: Sequence[tuple[float, float]]
) -> dict[str, list[Any]]:
    """Local errors and undetermined gaps for JSON; no key of what a map does not have."""
    found: dict[str, list[Any]] = {}
    if regions:
        found["regions"] = [asdict(region) for region in regions]
    if gaps_deg:
        found["undetermined_deg"] = [list(gap) for gap in gaps_deg]
    return found


def dial_of(poses: Sequence[Pose]) -> tuple[FloatArray, FloatArray]:
    """(n,) angles of the dial and (n,) approaches, 0 where one is not known."""
    dial = np.array([pose.dial_deg for pose in poses], dtype=np.float64)
    return dial, np.array([pose.approach or 0 for pose in poses], dtype=np.float64)


def with_map(poses: Sequence[Pose], stage_map: StageMap) -> list[Pose]:
    """Poses with what a map adds to the dial; those beyond it without."""
    dial, approach = dial_of(poses)
    added = stage_map.correction_deg(dial, approach).tolist()
    return [
        replace(pose, map_deg=value) if within else pose
        for pose, value, within in zip(poses, added, stage_map.covers(dial).tolist(), strict=True)
    ]


def in_words(frozen: Mapping[str, Any]) -> str:
    """What a run that keeps this of its map rests on, such as `map 1f3a9c02 of 2026-11-22, 0.0041°, …`."""
    at = f" of {frozen['solved_at'][:10]}" if frozen.get("solved_at") else ""
    low, high = (f"{end:.4g}°".replace("-", "−") for end in frozen["dial_deg"])
    rests = [f"{len(frozen[key])} {what}{'' if len(frozen[key]) == 1 else 's'}" for key, what in _RESTS]
    return (
        f"the stage's map {frozen['sha256'][:8]}{at}, {deg(frozen['std_deg'])} (k = 1) over {low} to {high} "
        f"of the dial, solved from {rests[0]} in {rests[1]}"
    )


def beyond_in_words(poses: Sequence[Pose], stage_map: StageMap) -> str:
    """Why a map was not used for a run."""
    dial, _ = dial_of(poses)
    out = dial[~stage_map.covers(dial)]
    low, high = stage_map.dial_deg[0], stage_map.dial_deg[-1]
    n = "1 pose stands" if len(out) == 1 else f"{len(out)} poses stand"
    between = " and is not determined between the angles visited" if stage_map.gaps_deg else ""
    said = (
        f"The stage's map was not used: {n} at dial angles of {out.min():.4g}° to {out.max():.4g}°, and it "
        f"was made over {low:.4g}° to {high:.4g}°{between}."
    )
    return said.replace("-", "−")


def map_reference(
    stage_map: StageMap,
    theta_deg: FloatArray,
    dial_deg: FloatArray,
    approach: FloatArray,
    *,
    level: Reference | None = None,
    bent: bool = False,
) -> Reference:
    """What the map is worth to a calibration of these very poses: type B, normal (GUM 5.2.2).

    With δ the map's error at the poses, of covariance C = B·V·Bᵀ (B its columns, V the coefficients'), the
    fit takes the least-squares line G·δ, G = pinv([1 θ]), for the unit's: (bias, scale) have scale²·G·C·Gᵀ. A
    calibrated elevation relative to its mean over the range errs by the line's slope alone; what of δ is no
    line stands in the scatter of the poses, hence in type A. Where curves were fitted to the unit as well
    (`bent`), they may have taken that up: then the elevation is given the whole of δ about its mean, since a
    projection lengthens nothing.

    Args:
        stage_map: in force.
        theta_deg: (n,) elevations of the poses.
        dial_deg: (n,) where the stage stood.
        approach: (n,) from which side it came.
        level: the stage's certificate. What it says of the mean over the range, which the map does not
            know, stays in the bias.
        bent: whether effects are taken out beside bias and scale.
    """
    columns = stage_map.columns(dial_deg, approach)
    design = np.ones((len(theta_deg), 1))
    straight = bool(np.ptp(theta_deg) > 0.0)
    if straight:
        design = np.column_stack([design, theta_deg])
    by_line = np.linalg.pinv(design) @ columns
    line = by_line @ stage_map.covariance_deg2 @ by_line.T
    local, by_pose = local_variance_deg2(stage_map.regions, dial_deg), np.linalg.pinv(design)
    line += (by_pose * local) @ by_pose.T
    if bent:
        about = columns - columns.mean(axis=0)
        variance = float(np.einsum("ij,jk,ik->", about, stage_map.covariance_deg2, about)) / len(about)
        variance += float(local.mean())
    else:
        variance = float(line[1, 1]) * float(np.ptp(theta_deg)) ** 2 / 12.0 if straight else 0.0
    whole = np.zeros((2, 2))
    whole[: len(line), : len(line)] = line
    if level is not None:
        whole[0, 0] += level.std_deg**2
    first, second = whole.tolist()
    return Reference(
        std_deg=math.sqrt(max(variance, 0.0)),
        kind="map",
        distribution="normal",
        line_covariance=((first[0], first[1]), (second[0], second[1])),
    )
