"""A periodic error of a worm, a motor or a scale: one period, any or an order of the full turn.

Poses at angles θ show a wave of frequency f as one of f ± p wherever |Σ exp(2πi·p·θ)|/n is near 1 (spectral
window: Deeming, Astrophysics and Space Science 36, 1975). An exact grid has such p at every multiple of
1/step; jitter removes them. Where the readings are the grid, as in a table by a sensor's counts, the
elevations are uneven by the error itself: a wave near the step follows any error, and says nothing.
"""

import math
from collections.abc import Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from calrig.calibration.regression.channels import ANGLE, MOVE, READING
from calrig.calibration.regression.effect import (
    ELEVATION,
    Applied,
    Effect,
    Parameter,
    Parameters,
    Shape,
    Wording,
)
from calrig.calibration.regression.motion import kept_in_mean
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import (
    THE_TURN,
    amplitude_and_phase,
    c_wave,
    covered,
    goes_round,
    turns,
    wave_deg,
)
from calrig.estimation.angles import FloatArray

BIN_DEG, MOST_BINS = 0.05, 2**18
"""Beyond 36 turns the bins are wider: angles in another unit would take any memory."""
FINER = 4
"""Frequencies to a resolution 1/arc: enough not to miss a peak."""


def spectral_window(theta_deg: FloatArray, highest: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (m,) in cycles per degree from 0 to the highest, and the window's power (m,), 1 at 0."""
    return _of_angles(theta_deg.astype(np.float64).tobytes(), highest)


@lru_cache(maxsize=8)
def _of_angles(angles: bytes, highest: float) -> tuple[FloatArray, FloatArray]:
    """Return the window of angles, stored: a search asks for that of the same angles again and again."""
    theta_deg = np.frombuffer(angles)
    first = theta_deg.min()
    bin_deg = max(min(BIN_DEG, 1.0 / (8.0 * highest)), float(theta_deg.max() - first) / MOST_BINS)
    counts = np.bincount(np.round((theta_deg - first) / bin_deg).astype(int)).astype(float)
    length = 1 << int(FINER * len(counts) - 1).bit_length()
    window = np.fft.rfft(counts, length)
    frequencies = np.fft.rfftfreq(length, bin_deg)
    wanted = frequencies <= highest
    power = np.abs(window[wanted] / len(theta_deg)) ** 2
    return np.asarray(frequencies[wanted], dtype=np.float64), np.asarray(power, dtype=np.float64)


def window_peaks(theta_deg: FloatArray, highest: float, least: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (k,) of the window's peaks of at least some power, and their powers (k,)."""
    frequencies, power = spectral_window(theta_deg, highest)
    inner = np.arange(1, len(power) - 1)
    is_peak = (power[inner] >= power[inner - 1]) & (power[inner] > power[inner + 1]) & (power[inner] >= least)
    peaks = inner[is_peak & (frequencies[inner] > 1.0 / np.ptp(theta_deg))]
    return frequencies[peaks], power[peaks]


TURN_DEG = 360.0
EVEN_POWER = 0.9
"""Of the spectral window: where spacing is as good as even."""
GRID_SHARE = 0.3
"""Of how uneven the elevations are, by which readings that are the grid are less so."""


def spacing_deg(theta_deg: FloatArray) -> float | None:
    """Return the step of evenly spaced elevations; None where jitter or gaps tell aliases apart."""
    grid = _grid(theta_deg.astype(np.float64).tobytes())
    return None if grid is None else grid.step_deg


class _Grid(NamedTuple):
    """A step in degrees, and the standard deviation of angles about its multiples."""

    step_deg: float
    uneven_deg: float


@lru_cache(maxsize=32)
def _grid(angles: bytes) -> _Grid | None:
    theta_deg = np.frombuffer(angles)
    places = len(np.unique(theta_deg))
    if places < 3:
        return None
    arc = float(np.ptp(theta_deg))
    even, _ = window_peaks(theta_deg, 1.5 * max(places / arc, 1.0 / SHORTEST_PERIOD_DEG), EVEN_POWER)
    if not len(even):
        return None
    step = steps_of(theta_deg, 1.0 / float(even[0]))
    line = np.polyfit(step, theta_deg, 1)
    return _Grid(float(line[0]), float(np.std(theta_deg - np.polyval(line, step))))


def step_deg(r: Responses) -> float | None:
    """Return the step of evenly spaced elevations, else that of evenly spaced readings; None without one.

    Where each side comes to a grid of its own, it is the step of these.
    """
    of_all = spacing_deg(r.theta_deg)
    return max(of_all or 0.0, _step_of_sides(r)) or spacing_deg(_reading_deg(r))


@lru_cache(maxsize=8)
def _step_of_sides(r: Responses) -> float:
    """Return the narrower step where the elevations from either side are evenly spaced; else 0.

    Of rows read on the move at one speed, those do not count where the stage rests or gathers speed.
    """
    if r.approach is None:
        return 0.0
    counted = np.ones(len(r), dtype=bool)
    if step := _step_of_strokes(r):
        steps = np.abs(np.diff(r.theta_deg, prepend=r.theta_deg[0])) / step
        counted = (steps > 0.5) & (np.abs(steps - np.rint(steps)) <= ALIKE)
    sides = [r.theta_deg[counted & (r.approach == side)] for side in (-1.0, 1.0)]
    return min(spacing_deg(theta_deg) or 0.0 for theta_deg in sides)


def _reading_deg(r: Responses) -> FloatArray:
    return np.asarray(r.theta_deg + r.values[:, 0])


def _is_by_readings(r: Responses) -> bool:
    """Return whether the readings are the grid, and the elevations uneven by what they err."""
    of_readings, of_poses = (
        _grid(angles.astype(np.float64).tobytes()) for angles in (_reading_deg(r), r.theta_deg)
    )
    if of_readings is None or of_poses is None:
        return of_poses is None
    return of_readings.uneven_deg < GRID_SHARE * of_poses.uneven_deg


def steps_of(theta_deg: FloatArray, spacing_deg: float) -> FloatArray:
    """Return (n,) the whole number of steps from the lowest elevation to each."""
    return np.asarray(np.rint((theta_deg - theta_deg.min()) / spacing_deg), dtype=np.float64)


USUAL_ORDERS = (2, 3, 4, 5, 6, 7, 8, 12, 16)
"""Of the turn: what unequal channels, poles and phases make of an axis. Order 1 is an eccentricity."""
OWN_ORDERS, ONE_TURN_DEG = tuple(range(2, 17)), 1.1 * TURN_DEG
"""Of poses all along one turn, which closes: a wave as long as these is one of them."""
SHORTEST_PERIOD_DEG = 1.75
"""Unless the poses lie closer: the full step of a common motor on the axis itself is 1.8°."""
LEAST_LEFT = 0.3
"""Of a wave's power beside bias and scale, at its worst phase: longer periods are not resolved from them."""
PLACES, MOST_PLACES, PLACES_A_POSE = (3.0, 2.0), 400, 12.0
"""Frequencies scanned to a resolution of 1/arc: fewer where there are many; so many to a pose at most."""
MOST_HARMONICS = 8
"""Of a worm or a motor: more of them are what a curve is."""
LEAST_SHARE = 0.5
"""Of a period: what poses must stand in."""
AT_REST, ALIKE, MOST_STEPS = 0.01, 0.01, 0.8
"""Of the largest step from row to row, what is none; of a step, by which others are alike; their share."""
APART = 0.75
"""Of a resolution: two waves closer than that are one, and cancel each other where both are fitted."""
ALIKE_POWER, MOST_ALIKE = 0.4, 12
"""Of the spectral window: where two periods may be taken for one."""
ROUNDING = 1e-6
"""Of a frequency: so near its bound it is on it."""
SURE = 2.0
"""Standard errors within which a period is an order of the turn, where orders lie far enough apart."""


def _scan(r: Responses) -> Iterator[Parameters]:
    arc = float(np.ptp(r.theta_deg))
    for known_deg in r.known_periods_deg:
        yield from _family(r, known_deg, 1)
    if not turns(r) or arc < 3.0 * _shortest_deg(r.theta_deg):
        return
    names = _known_orders(r)
    frequencies, orders = _scanned(r), np.array(names) / TURN_DEG
    if len(frequencies):
        orders = orders[orders <= max(frequencies[-1], _highest(r))]
    if names is OWN_ORDERS:
        frequencies = frequencies[frequencies > OWN_ORDERS[-1] / TURN_DEG]
    periods = 1.0 / np.concatenate([orders, frequencies])
    resolved = _left_beside(r.base[:, 0, :], r.theta_deg, periods) >= LEAST_LEFT
    for k in np.flatnonzero(resolved):
        order = {"order": float(names[k])} if k < len(orders) else {}
        if order or not _is_curve_within_strokes(r, 1.0 / float(periods[k])):
            yield {"period_deg": float(periods[k]), **order}


def _known_orders(r: Responses) -> tuple[int, ...]:
    """Return the orders of the turn that are candidates without a scan."""
    return OWN_ORDERS if goes_round(r) and r.arc_deg < ONE_TURN_DEG else USUAL_ORDERS


def _family(r: Responses, period_deg: float, first: int) -> Iterator[Parameters]:
    """Yield a period's harmonics from the first wanted one; of even poses to what their spacing resolves."""
    step = step_deg(r)
    for harmonic in range(first, MOST_HARMONICS + 1):
        own_deg = period_deg / harmonic
        if harmonic > 1 and step is not None and own_deg < 2.0 * step:
            return
        if _left_beside(r.base[:, 0, :], r.theta_deg, np.array([own_deg]))[0] >= LEAST_LEFT:
            yield {"period_deg": own_deg, "harmonic": float(harmonic), "of_deg": period_deg}


def _harmonics(r: Responses, shape: Shape) -> Iterator[Parameters]:
    """Yield the further harmonics of a period that was found.

    Those of an order are orders, of which even poses cannot tell one from its alias.
    """
    if shape.scanned and not (shape.series and step_deg(r)):
        yield from _family(r, shape.at["period_deg"], 2)


def _shortest_deg(theta_deg: FloatArray) -> float:
    """Return the shortest period that is searched for: two steps of poses that lie close together."""
    return min(SHORTEST_PERIOD_DEG, 2.0 * float(np.ptp(theta_deg)) / len(np.unique(theta_deg)))


def turns_back(shape: Shape, beta: FloatArray) -> bool:
    """Return whether a wave with coefficients (2,) is so steep that readings turn back on the way."""
    return bool(2.0 * np.pi * np.linalg.norm(beta[:2]) >= shape.at.get("period_deg", np.inf))


def _highest(r: Responses) -> float:
    """Return the highest frequency that the spacing of the poses resolves, in cycles per degree."""
    highest, step = 1.0 / _shortest_deg(r.theta_deg), step_deg(r)
    return highest if step is None else min(highest, 1.0 / (2.0 * step) - 1.0 / float(np.ptp(r.theta_deg)))


def _scanned(r: Responses) -> FloatArray:
    """Frequencies in cycles per degree, from the turn's second order or so to the highest."""
    arc = float(np.ptp(r.theta_deg))
    lowest, highest = 1.0 / TURN_DEG + APART / arc, _highest(r)
    finer = next((f for f in PLACES if (highest - lowest) * f * arc <= MOST_PLACES), PLACES[-1])
    most = min(1.5 * MOST_PLACES, PLACES_A_POSE * len(r))
    return np.arange(lowest, min(highest, lowest + most / (finer * arc)) + 1e-9, 1.0 / (finer * arc))


def unsearched(r: Responses) -> str | None:
    """Return which periods a search leaves out; None where the poses resolve none, or somebody states one."""
    if r.known_periods_deg or not turns(r) or len(frequencies := _scanned(r)) == 0:
        return None
    if frequencies[-1] + 1.0 / float(np.ptp(r.theta_deg)) > _highest(r):
        return None
    return (
        f"these poses resolve periods below {1.0 / frequencies[-1]:.3g}°; of those, none but orders of the "
        f"turn up to {max(_known_orders(r))} was searched for: state a period that is known"
    )


def _carried(r: Responses, shape: Shape) -> bool:
    """Return whether the poses determine period, amplitude and phase of a wave together.

    A period beyond the arc is a curve, and so is one of which poses of many turns show less than half. Evenly
    spaced poses show waves near twice the spacing, or near a part of it, as one that alternates or drifts:
    amplitude and phase are one number there. Evenly spaced readings show none of less than twice the spacing.
    Where each side has an even grid of its own, such a wave is a longer one on each, and so differs by side.
    """
    frequency, arc = 1.0 / shape.at.get("period_deg", TURN_DEG), r.arc_deg
    if frequency * (1.0 + ROUNDING) < max(1.0 / TURN_DEG, 1.0 / arc):
        return False
    if covered(r.theta_deg, 1.0 / frequency) < LEAST_SHARE / frequency:
        return False
    step = step_deg(r)
    if step is None:
        return not _is_curve_within_strokes(r, frequency)
    is_told_by_sides = _step_of_sides(r) == step and not math.isclose(
        spacing_deg(r.theta_deg) or 0.0, step, rel_tol=ALIKE
    )
    is_known = shape.at.get("of_deg") in r.known_periods_deg
    if 2.0 * step * frequency > 1.0 and (_is_by_readings(r) or (is_told_by_sides and not is_known)):
        return False
    halves = max(1.0, round(2.0 * step * frequency)) / (2.0 * step)
    return abs(frequency - halves) * (1.0 + ROUNDING) >= 1.0 / arc


def _is_curve_within_strokes(r: Responses, frequency: float) -> bool:
    """Return whether a wave is no wave within a stroke, since a step from row to row is whole waves of it.

    Rows read on the move at one speed are even within a stroke, if not all together: such a wave is a curve
    on the way there and another on the way back, as what comes with direction is.
    """
    step = _step_of_strokes(r)
    whole = round(frequency * step)
    return whole > 0 and abs(frequency - whole / step) * (1.0 + ROUNDING) < 1.0 / r.arc_deg


@lru_cache(maxsize=8)
def _step_of_strokes(r: Responses) -> float:
    """Return the step that most steps from row to row are, or a multiple of; 0 without one."""
    size = np.abs(np.diff(r.theta_deg))
    moving = size[size > AT_REST * size.max()]
    if not len(moving):
        return 0.0
    usual = float(np.median(moving))
    multiple = np.rint(moving / usual)  # of a fold, which lacks every fourth row
    is_even = (multiple > 0.0) & (np.abs(moving / usual - multiple) <= ALIKE)
    return usual if is_even.mean() >= MOST_STEPS else 0.0


def _left_beside(base: FloatArray, theta_deg: FloatArray, periods: FloatArray) -> FloatArray:
    """Share of a wave's power that columns (n, p) leave of it at its worst phase, for m periods (m,)."""
    basis, _ = np.linalg.qr(base[:, base.any(axis=0)])
    phase = 2.0 * np.pi * theta_deg[:, None] / periods
    sines, cosines = (w - basis @ (basis.T @ w) for w in (np.sin(phase), np.cos(phase)))
    ss, cc, sc = (sines**2).sum(0), (cosines**2).sum(0), (sines * cosines).sum(0)
    return np.asarray((ss + cc - np.hypot(ss - cc, 2.0 * sc)) / len(theta_deg), dtype=np.float64)


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    period_deg = at.get("period_deg", 0.0)
    if period_deg == 0.0:
        return
    here = _waves(r.theta_deg, period_deg)
    felt = here - _waves(r.theta_deg - r.move_deg, period_deg)  # from middle to middle: the whole of it
    mean = here * kept_in_mean(r.stretch_deg, period_deg)[:, None]
    shares = {READING: mean, ANGLE: mean, MOVE: felt}
    names = ("amplitude_deg", "phase_deg")
    at_elevation = None if r.stretch_deg.any() else partial(_waves, period_deg=period_deg)
    if "harmonic" in at:
        of_deg, harmonic = at["of_deg"], at["harmonic"]
        known = "the known period" if of_deg in r.known_periods_deg else "the period"
        yield Shape(
            shares,
            names,
            form="harmonic",
            at={"period_deg": period_deg, "harmonic": harmonic, "of_deg": of_deg},
            says=f"{known} of {of_deg:.5g}°"
            if harmonic == 1.0
            else f"harmonic {harmonic:g} of {known} of {of_deg:.5g}°",
            at_elevation=at_elevation,
            series=f"period of {of_deg:.6g}°",
        )
        return
    if "order" not in at:
        yield Shape(
            shares,
            names,
            at={"period_deg": period_deg},
            scanned=True,
            says=_shorter_alias(r, period_deg),
            at_elevation=at_elevation,
        )
        return
    is_scanned = at["order"] not in _known_orders(r)
    said = [f"order {at['order']:g} of the turn", _shorter_alias(r, period_deg) if is_scanned else ""]
    yield Shape(
        shares,
        names,
        form="order of the turn",
        at={"period_deg": period_deg, "order": at["order"]},
        scanned=is_scanned,
        says="; ".join(filter(None, said)),
        series=THE_TURN,
        at_elevation=at_elevation,
    )


def _waves(theta_deg: FloatArray, period_deg: float) -> FloatArray:
    phase = 2.0 * np.pi * theta_deg / period_deg
    waves = np.empty((len(phase), 2))
    np.sin(phase, out=waves[:, 0])
    np.cos(phase, out=waves[:, 1])
    return waves


def _settled(at: Parameters, std: Parameters) -> Parameters:
    """Return the order of the turn that a period is, where its standard error leaves one and no other."""
    if "harmonic" in at:
        return at
    order = TURN_DEG / at["period_deg"]
    order_std = order * std["period_deg"] / at["period_deg"]
    nearest = round(order)
    if nearest > 1 and abs(order - nearest) <= SURE * order_std <= 0.25:
        return {"period_deg": TURN_DEG / nearest, "order": float(nearest)}
    return at


def _look_alikes(r: Responses, shape: Shape) -> Iterator[Parameters]:
    """Periods that the spacing of the poses may take for the one found, the longest first.

    Those of an order of the turn are no freer than that: the same wave at evenly spaced poses.
    """
    found = 1.0 / shape.at["period_deg"]
    highest = max(1.0 / SHORTEST_PERIOD_DEG, found)
    peaks, power = window_peaks(r.theta_deg, 2.0 * highest, ALIKE_POWER)
    peaks = peaks[np.argsort(-power, kind="stable")]
    alike = np.unique(np.round(np.abs(np.stack([peaks - found, peaks + found], 1).ravel()), 9)[:MOST_ALIKE])
    resolved, grid = APART / float(np.ptp(r.theta_deg)), _frequency_of_grid(r)
    taken = [found]
    for frequency in alike:
        is_new = min(abs(frequency - other) for other in taken) >= resolved
        if is_new and 1.0 / TURN_DEG + resolved <= frequency <= highest:
            taken.append(float(frequency))
            if not grid or "order" not in shape.at:
                yield {"period_deg": float(1.0 / frequency)}
            else:
                signed = (round((frequency - sign * found) / grid) * grid + sign * found for sign in (1, -1))
                exact = min(map(abs, signed), key=lambda one: abs(one - frequency))
                yield {"period_deg": float(1.0 / exact), "order": float(exact * TURN_DEG)}


def _shorter_alias(r: Responses, period_deg: float) -> str:
    """Say which period under two steps looks the same at even poses too close for one to be searched for."""
    step = spacing_deg(r.theta_deg)
    if step is None or not 2.0 * step <= min(SHORTEST_PERIOD_DEG, period_deg):
        return ""
    alias_deg = 1.0 / (1.0 / step - 1.0 / period_deg)
    return f"poses {step:.4g}° apart would show a period of {alias_deg:.4g}° as the same"


def _resolved(r: Responses, shape: Shape) -> float:
    """Return the frequency of a wave in the least distance that the poses resolve; an order 1 has one too.

    Evenly spaced poses do not resolve a wave from one near an alias of it.
    """
    period_deg = shape.at.get("period_deg", TURN_DEG if shape.series == THE_TURN else math.nan)
    frequency, grid = 1.0 / (period_deg or math.nan), _frequency_of_grid(r)
    if grid and not math.isnan(frequency):
        frequency = abs(frequency - grid * round(frequency / grid))
    return frequency * r.arc_deg / APART


@lru_cache(maxsize=8)
def _frequency_of_grid(r: Responses) -> float:
    """Return how many evenly spaced elevations lie in a degree; 0 where they are not evenly spaced."""
    step = spacing_deg(r.theta_deg)
    return 0.0 if step is None else 1.0 / step


def _on_reading_deg(p: Applied) -> FloatArray:
    period_deg = p.value("period_deg", None)
    wave = wave_deg(p, p.theta_deg / period_deg)
    turned_deg = p.given.get("stretch_deg")
    return wave if turned_deg is None else wave * kept_in_mean(turned_deg, period_deg)


EFFECT = Effect(
    name="stage_periodic",
    title="Periodic error of the stage",
    origin="stage",
    scope="rig",
    covariate=ELEVATION,
    parameters=(
        Parameter("amplitude_deg", "Amplitude", "°"),
        Parameter("phase_deg", "Phase", "°"),
        Parameter("period_deg", "Period", "°"),
    ),
    formula="amplitude_deg·sin(360°·θ/period_deg + phase_deg)",
    forms=_forms,
    scan=_scan,
    on_reading_deg=_on_reading_deg,
    in_c=lambda p: c_wave(p, 360.0 / p["period_deg"]),
    apart="its period: jittered elevations tell the periods apart that an even spacing confuses",
    remedy="correct by the rig error map; look at the worm, its preload, the motor's steps",
    reported=amplitude_and_phase,
    # a steeper wave would turn the axis back while its stage turns on
    place="period_deg",
    settled=_settled,
    look_alikes=_look_alikes,
    resolved=_resolved,
    as_sensor=Wording(
        "Periodic error of the sensor",
        "correct by the unit's calibration; look at how the sensor is centred, its channels and its poles",
    ),
    carried=_carried,
    harmonics=_harmonics,
)
