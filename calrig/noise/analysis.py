"""Analyse a static log: the noise of each channel, its colour, and whether the sensor was at rest."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.model.noise import SpectralLine, TemperatureDependence
from calrig.noise.allan import KINDS, AllanCurve, allan_curve, variance_of
from calrig.noise.coefficients import Coefficients, coefficients
from calrig.noise.distribution import Distribution, distribution_of, knocks_of
from calrig.noise.resampling import UniformLog, uniform_log
from calrig.noise.spectral_lines import find_lines
from calrig.noise.spectrum import Psd, PsdSlope, psd_of, psd_slope
from calrig.noise.temperature import temperature_of
from calrig.noise.units import accelerometer_channels, unit_of

LEAST_TURN_DEG = 5.0
"""Of gravity in the sensor: 87 mg, more than offsets drift by."""
MEAN_OVER_S = 1.0


def turn_deg(channels: Mapping[str, FloatArray], rate_hz: float, segments: Sequence[slice]) -> float | None:
    """Return how far gravity turns in the sensor, from means of a second, about its mean direction over all.

    `channels` (N,) are by name with its unit; `segments` are without gaps.

    Returns:
        The largest angle; None without three axes of an accelerometer in one unit, or without a whole second.
    """
    axes = accelerometer_channels(channels, "xyz")
    if axes is None:
        return None
    count = max(1, round(MEAN_OVER_S * rate_hz))
    means = np.column_stack(
        [np.concatenate([_means(channels[axis][s], count) for s in segments]) for axis in axes]
    )
    if not len(means):
        return None
    size = np.linalg.norm(means, axis=1)
    if not (size > 0.0).all():
        return None
    units = means / size[:, None]
    middle = units.mean(axis=0)
    along = units @ middle / max(float(np.linalg.norm(middle)), np.finfo(np.float64).tiny)
    return float(np.degrees(np.arccos(np.clip(along, -1.0, 1.0)).max()))


def _means(values: FloatArray, count: int) -> FloatArray:
    whole = len(values) // count
    return np.asarray(values[: whole * count].reshape(whole, count).mean(axis=1), dtype=np.float64)


Colour: TypeAlias = Literal["white", "pink", "brown", "quantisation-limited", "lines", "mixed"]

_WORDS: tuple[Colour, ...] = ("quantisation-limited", "white", "pink", "brown")
"""In the order of `KINDS`."""
_ADF_SLOPES = np.array([-1.0, -0.5, 0.0, 0.5])
_PSD_SLOPES = np.array([2.0, 0.0, -1.0, -2.0])
RULES = 0.75
"""Share of the octaves of τ in which a kind must be the largest for the noise to be called after it."""
NEAR_ADF, NEAR_PSD = 0.2, 0.6
"""How far a measured slope may be from a kind's own."""


def colour_of(
    curve: AllanCurve, coefficients: Coefficients, psd_slope: float | None, lines: Sequence[SpectralLine]
) -> Colour | None:
    """Return what to call the noise; None where there is none, or nothing to tell it by.

    - A log with a line is `lines`, `mixed` if what is under the line is not white.
    - `white`, `pink` (flicker), `brown` (random walk) or `quantisation-limited` (quantisation): that kind is
      the largest in three quarters of the octaves of τ, or where no coefficient was found, the only one that
      the slopes allow; and neither slope is far from its own: that of the Allan deviation up to 1 s from
      −1/2, 0, 1/2 or −1, that of the spectrum from 0, −1, −2 or 2.
    - `mixed` is the rest. A ramp is no noise and has no colour.
    """
    if not (curve.deviation > 0.0).any():
        return None
    ruling = _ruling(curve, coefficients)
    if lines:
        return "lines" if ruling in {None, "white"} else "mixed"
    fitting = _fitting(curve.adf_slope, psd_slope)
    if ruling is not None:
        return ruling if ruling in fitting else "mixed"
    if curve.adf_slope is None and psd_slope is None:
        return None
    return fitting[0] if len(fitting) == 1 else "mixed"


def _ruling(curve: AllanCurve, coefficients: Coefficients) -> Colour | None:
    """The kind that is the largest in most octaves; `mixed` where none is, None without coefficients."""
    found = [getattr(coefficients, kind) for kind in KINDS]
    if not any(found):
        return None
    squares = np.array([one.value**2 if one else 0.0 for one in found])
    octaves = np.arange(0.0, np.log2(curve.tau_s[-1] / curve.tau_s[0]) + 1e-9)
    largest = np.argmax(variance_of(curve.tau_s[0] * 2.0**octaves) * squares, axis=1)
    share = np.bincount(largest, minlength=len(KINDS)) / len(largest)
    return _WORDS[int(np.argmax(share))] if share.max() >= RULES else "mixed"


def _fitting(adf_slope: float | None, psd_slope: float | None) -> list[Colour]:
    """Return the words whose slopes are near those measured."""
    near = np.ones(len(_WORDS), dtype=np.bool_)
    if adf_slope is not None:
        near &= np.abs(adf_slope - _ADF_SLOPES) <= NEAR_ADF
    if psd_slope is not None:
        near &= np.abs(psd_slope - _PSD_SLOPES) <= NEAR_PSD
    return [word for word, fits in zip(_WORDS, near, strict=True) if fits]


ELEVATION = "elevation_deg"
TEMPERATURE = "temperature_c"


@dataclass(frozen=True, slots=True, eq=False)
class ChannelNoise:
    """The noise of one channel, in its unit.

    Attributes:
        unit: as a person writes it.
        psd_slope: its slope with the lines left out; None where the log is too short.
        lines: spectral lines, strongest first.
        temperature: dependence on it; None where the log does not tell.
        colour: in one word; None where there is no telling.
    """

    name: str
    unit: str
    allan: AllanCurve
    coefficients: Coefficients
    psd: Psd
    psd_slope: PsdSlope | None
    lines: tuple[SpectralLine, ...]
    distribution: Distribution
    temperature: TemperatureDependence | None
    colour: Colour | None


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """The noise of a unit, as one static log shows it; what is not said here is as of `UniformLog`.

    Attributes:
        notes: which knocks were left out, what was done to put the samples on a uniform grid, and whether
            the sensor moved.
        channels: by name; the log's in its order, then `elevation_deg`.
    """

    rate_hz: float
    duration_s: float
    gaps: int
    not_finite: int
    notes: tuple[str, ...]
    channels: dict[str, ChannelNoise]


def analyse(
    channels: dict[str, FloatArray],
    time_s: FloatArray | None = None,
    rate_hz: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Noise:
    """Analyse a log of a sensor at rest.

    Where the log has accel_y and accel_z of one unit, the elevation of each sample, atan2(y, z), is analysed
    as one more channel.

    Args:
        channels: (N,) each, by name with its unit (CONTRACT section 4); NaN where not known.
        time_s: (N,) as logged; None without any.
        rate_hz: wins over `time_s`.
        progress: told the share done, from 0 to 1.

    Raises:
        ValueError: there is no rate or no sample; says what to do.
    """
    knocks = knocks_of(channels)
    log = uniform_log(channels, time_s, rate_hz, [one for found in knocks.values() for one in found])
    axes = accelerometer_channels(log.channels)
    names = [*log.channels, *([ELEVATION] if axes else [])]
    analysed: dict[str, ChannelNoise] = {}
    for done, name in enumerate(names, start=1):
        if axes is not None and name == ELEVATION:
            elevation_deg = static_elevation_deg(*(log.channels[axis] for axis in axes))
            log = replace(log, channels={**log.channels, ELEVATION: elevation_deg})
        analysed[name] = _channel(log, name)
        if progress is not None:
            progress(done / len(names))
    notes = (*_of_knocks(knocks), *log.notes, *_of_rest(log))
    return Noise(log.rate_hz, log.duration_s, log.gaps, log.not_finite, notes, analysed)


def _of_rest(log: UniformLog) -> tuple[str, ...]:
    turn = turn_deg(log.channels, log.rate_hz, log.segments)
    if turn is None or turn < LEAST_TURN_DEG:
        return ()
    return (
        f"This is no sensor at rest: gravity turns by {turn:.0f}° in it, so what follows is of its motion, "
        "not of its noise. Cut out a stretch in which it stood still.",
    )


def _of_knocks(knocks: Mapping[str, Sequence[slice]]) -> tuple[str, ...]:
    return tuple(
        f"{name} lies far from its other samples for a moment, as of a knock: samples "
        f"{', '.join(f'{one.start + 1} to {one.stop}' for one in found)} are left out of every channel."
        for name, found in knocks.items()
    )


def _channel(log: UniformLog, name: str) -> ChannelNoise:
    """One channel's noise; what is as long as the log is gone when it returns."""
    x, unit, temperature_c = log.channels[name], unit_of(name), log.channels.get(TEMPERATURE)
    curve, psd = allan_curve(log, name), psd_of(x, log.rate_hz, log.segments)
    lines = find_lines(x, log.rate_hz, log.segments, log.start_s)
    slope = psd_slope(psd, [line.frequency_hz for line in lines])
    found = coefficients(curve, unit, [(line.frequency_hz, line.amplitude) for line in lines])
    warmth = None
    if name != TEMPERATURE:
        warmth = temperature_of(x, temperature_c, log.rate_hz, log.segments, log.start_s)
    return ChannelNoise(
        name=name,
        unit=unit,
        allan=curve,
        coefficients=found,
        psd=psd,
        psd_slope=slope,
        lines=lines,
        distribution=distribution_of(x),
        temperature=warmth,
        colour=colour_of(curve, found, slope.slope if slope else None, lines),
    )


def static_elevation_deg(accel_y: FloatArray, accel_z: FloatArray) -> FloatArray:
    """Return (N,) elevation atan2(y, z) in degrees of a sensor at rest, without a jump at ±180°."""
    middle_deg = float(np.degrees(np.arctan2(accel_y.mean(), accel_z.mean())))
    elevation_deg = np.arctan2(accel_y, accel_z)
    np.degrees(elevation_deg, out=elevation_deg)
    elevation_deg -= middle_deg
    if np.abs(elevation_deg).max() > 180.0:
        elevation_deg = wrap_deg(elevation_deg)
    elevation_deg += middle_deg
    return elevation_deg
