"""A static log → all that is said of the noise of its channels, one channel after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.noise.allan import AllanCurve, allan_curve
from calrig.noise.at_rest import LEAST_TURN_DEG, turn_deg
from calrig.noise.coefficients import Coefficients, coefficients
from calrig.noise.colour import Colour, colour_of
from calrig.noise.distribution import Distribution, distribution_of
from calrig.noise.resampling import UniformLog, uniform_log
from calrig.noise.spectral_lines import Line, find_lines
from calrig.noise.spectrum import Psd, PsdSlope, psd_of, psd_slope
from calrig.noise.temperature import Temperature, temperature_of
from calrig.noise.units import unit_of

ELEVATION = "elevation_deg"
TEMPERATURE = "temperature_c"


@dataclass(frozen=True, slots=True, eq=False)
class ChannelNoise:
    """The noise of one channel, in its unit.

    Attributes:
        name: the channel's.
        unit: as a person writes it.
        allan: overlapping Allan deviation.
        coefficients: fitted to it.
        psd: one-sided power spectral density.
        psd_slope: its slope with the lines left out; None where the log is too short.
        lines: spectral lines, strongest first.
        distribution: mean, standard deviation, histogram, and whether a Gaussian fits.
        temperature: dependence on it; None where the log does not tell.
        colour: in one word; None where there is no telling.
    """

    name: str
    unit: str
    allan: AllanCurve
    coefficients: Coefficients
    psd: Psd
    psd_slope: PsdSlope | None
    lines: tuple[Line, ...]
    distribution: Distribution
    temperature: Temperature | None
    colour: Colour | None


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """The noise of a unit, as one static log shows it.

    Attributes:
        rate_hz: samples a second.
        duration_s: of the log, gaps included.
        gaps: how often samples were missing.
        not_finite: samples left out since one of their values was not known.
        notes: what was done to put the log's samples on a uniform grid, and whether the sensor moved.
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
    """Analyses a log of a sensor at rest.

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
    log = uniform_log(channels, time_s, rate_hz)
    y_and_z = _elevation_axes(log)
    names = [*log.channels, *([ELEVATION] if y_and_z else [])]
    analysed: dict[str, ChannelNoise] = {}
    for done, name in enumerate(names, start=1):
        if y_and_z is not None and name == ELEVATION:
            with_it = {**log.channels, ELEVATION: static_elevation_deg(*y_and_z)}
            log = replace(log, channels=with_it)
        analysed[name] = _channel(log, name)
        if progress is not None:
            progress(done / len(names))
    notes = (*log.notes, *_of_rest(log))
    return Noise(log.rate_hz, log.duration_s, log.gaps, log.not_finite, notes, analysed)


def _of_rest(log: UniformLog) -> tuple[str, ...]:
    """What is to be said of a log that is not of a sensor at rest."""
    turn = turn_deg(log.channels, log.rate_hz, log.segments)
    if turn is None or turn < LEAST_TURN_DEG:
        return ()
    return (
        f"This is no sensor at rest: gravity turns by {turn:.0f}° in it, so what follows is of its motion, "
        "not of its noise. Cut out a stretch in which it stood still.",
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


def _elevation_axes(log: UniformLog) -> tuple[FloatArray, FloatArray] | None:
    """The accelerometer's y and z, of one unit."""
    for unit in ("g", "lsb"):
        y, z = (log.channels.get(f"accel_{axis}_{unit}") for axis in "yz")
        if y is not None and z is not None:
            return y, z
    return None


def static_elevation_deg(accel_y: FloatArray, accel_z: FloatArray) -> FloatArray:
    """(N,) elevation atan2(y, z) in degrees of a sensor at rest, without a jump at ±180°."""
    middle_deg = float(np.degrees(np.arctan2(accel_y.mean(), accel_z.mean())))
    elevation_deg = np.arctan2(accel_y, accel_z)
    np.degrees(elevation_deg, out=elevation_deg)
    elevation_deg -= middle_deg
    if np.abs(elevation_deg).max() > 180.0:
        elevation_deg = wrap_deg(elevation_deg)
    elevation_deg += middle_deg
    return elevation_deg
