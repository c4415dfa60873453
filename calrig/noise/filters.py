"""The filters side by side on one log, the tuned one from the noise that the same log shows at rest."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.estimation.filter_comparison import FilterComparison, compare_filters, tuned_against_paper
from calrig.estimation.gains import gain_schedule, samples_to_steady_state, steady_state_gain
from calrig.estimation.innovation import InnovationCheck, innovation_check
from calrig.estimation.intervals import find_intervals
from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.tuning import midpoint_rate_dps, tuned_noise
from calrig.noise.allan import allan_curve
from calrig.noise.coefficients import coefficients
from calrig.noise.resampling import UniformLog, uniform_log
from calrig.noise.units import accelerometer_channels, unit_of

GYRO, ELEVATION = "gyro_x_dps", "elevation_deg"
STARTS_AN_OCTAVE = 4
"""Of the gains before they are steady, by sample: near enough for straight lines between them."""
LONGEST_START_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class FilterStudy:
    """The comparison, and the filter that was tuned for it; rate and duration as of `UniformLog`.

    Attributes:
        tuned: noise of the tuned filter; None where the log does not tell it.
        check: whether its innovation at rest is what that noise says; None without it.
        notes: what was done to the log and why a filter could not be tuned, one sentence each.
    """

    rate_hz: float
    duration_s: float
    comparison: FilterComparison
    tuned: KalmanNoise | None
    check: InnovationCheck | None
    notes: tuple[str, ...]


def study_filters(
    channels: dict[str, FloatArray],
    time_s: FloatArray | None = None,
    rate_hz: float | None = None,
    *,
    gyro_scale: float = 1.0,
) -> FilterStudy:
    """Run every filter over a log of a sensor that stands and is turned about its x axis.

    The tuned filter's noise is that of the log's own static intervals (`tuned_noise`).

    Args:
        channels: (N,) each, by name with its unit (CONTRACT section 4): `accel_y_*`, `accel_z_*` of one unit,
            and `gyro_x_dps` where it is known.
        time_s: (N,) as logged; None without any.
        rate_hz: wins over `time_s`.
        gyro_scale: the unit's, of its calibration.

    Raises:
        ValueError: the log has no elevation, no rate or no sample; says what to do.
    """
    axes = accelerometer_channels(channels)
    if axes is None:
        raise ValueError("the log has no accel_y and accel_z of one unit, from which the elevation comes")
    used = dict(zip("yz", (channels[axis] for axis in axes), strict=True))
    if GYRO in channels:
        used[GYRO] = channels[GYRO]
    log = uniform_log(used, time_s, rate_hz)
    log = replace(log, channels=_angles(log))
    notes = list(log.notes)
    elevation, rate = log.channels[ELEVATION], log.channels.get(GYRO)
    if rate is None:
        notes.append(f"There is no {GYRO}, so no Kalman filter was run (gyro in counts: give --gyro-range).")
    at_rest = _at_rest(log)
    tuned = None if rate is None else _tuned(at_rest, notes)
    return FilterStudy(
        rate_hz=log.rate_hz,
        duration_s=log.duration_s,
        comparison=compare_filters(_times(log), elevation, rate, tuned=tuned, gyro_scale=gyro_scale),
        tuned=tuned,
        check=None if tuned is None else _check(at_rest, tuned, gyro_scale),
        notes=tuple(notes),
    )


def filters_document(study: FilterStudy) -> dict[str, Any]:
    """Return what `calrig filters --json` prints; a number that is not known is None."""
    comparison = study.comparison
    return {
        "rate_hz": study.rate_hz,
        "duration_s": study.duration_s,
        "n_moves": len(comparison.moves),
        "reference": comparison.reference or None,
        "filters": [row.as_dict() for row in comparison.rows],
        "tuned": _tuned_document(study),
        "summary": list(_sentences(study)),
    }


def _angles(log: UniformLog) -> dict[str, FloatArray]:
    """Elevation, continuous within each segment, and the rate if there is one."""
    elevation = np.degrees(np.arctan2(log.channels["y"], log.channels["z"]))
    for segment in log.segments:
        elevation[segment] = np.unwrap(elevation[segment], period=360.0)
    rate = log.channels.get(GYRO)
    return {ELEVATION: elevation} if rate is None else {ELEVATION: elevation, GYRO: rate}


def _times(log: UniformLog) -> FloatArray:
    """Return (N,) seconds since the first sample."""
    times = [
        start_s + np.arange(segment.stop - segment.start) / log.rate_hz
        for segment, start_s in zip(log.segments, log.start_s, strict=True)
    ]
    return np.concatenate(times)


def _at_rest(log: UniformLog) -> UniformLog:
    """Return the log's static intervals as its segments."""
    times, rate = _times(log), log.channels.get(GYRO)
    static = tuple(
        interval
        for segment in log.segments
        for interval in find_intervals(times, log.channels[ELEVATION], rate, segment).static
    )
    return replace(log, segments=static, start_s=tuple(float(times[one.start]) for one in static))


def _tuned(at_rest: UniformLog, notes: list[str]) -> KalmanNoise | None:
    elevation, gyro = (coefficients(allan_curve(at_rest, name), unit_of(name)) for name in (ELEVATION, GYRO))
    if elevation.white is None or gyro.white is None:
        missing = [name for name, one in ((ELEVATION, elevation), (GYRO, gyro)) if one.white is None]
        notes.append(f"No filter was tuned: the log shows no white noise of {' and '.join(missing)} at rest.")
        return None
    return tuned_noise(
        white_elevation_deg_sqrt_s=elevation.white.value,
        white_gyro_dps_sqrt_s=gyro.white.value,
        rate_hz=at_rest.rate_hz,
        random_walk_gyro_dps_per_sqrt_s=gyro.random_walk.value if gyro.random_walk else None,
        flicker_gyro_dps=gyro.flicker.value if gyro.flicker else None,
    )


def _check(at_rest: UniformLog, tuned: KalmanNoise, gyro_scale: float) -> InnovationCheck:
    """Of the longest static interval."""
    longest = max(at_rest.segments, key=lambda one: one.stop - one.start)
    elevation, rate = (at_rest.channels[name][longest] for name in (ELEVATION, GYRO))
    return innovation_check(elevation, gyro_scale * midpoint_rate_dps(rate), 1.0 / at_rest.rate_hz, tuned)


def _tuned_document(study: FilterStudy) -> dict[str, Any] | None:
    """Its noise and gains, samples counted from 1: up to the last of the start, then the steady gain."""
    if study.tuned is None:
        return None
    dt_s = 1.0 / study.rate_hz
    steady = steady_state_gain(study.tuned, dt_s)
    until = samples_to_steady_state(study.tuned, dt_s, at_most_s=LONGEST_START_S)
    octaves = math.log2(until or study.rate_hz * LONGEST_START_S)
    sample = np.unique(np.rint(2.0 ** (np.arange(octaves * STARTS_AN_OCTAVE) / STARTS_AN_OCTAVE))).astype(int)
    k_angle, k_bias = (gain[sample - 1] for gain in gain_schedule(study.tuned, dt_s, int(sample[-1])))
    return {
        **asdict(study.tuned),
        "steady_state_gain": {"angle": steady.k_angle, "bias_per_s": steady.k_bias},
        "start_gain": {"sample": sample.tolist(), "angle": k_angle.tolist(), "bias_per_s": k_bias.tolist()},
        "samples_to_steady_state": until,
        "innovation": None if study.check is None else asdict(study.check),
    }


def _sentences(study: FilterStudy) -> Iterator[str]:
    yield from study.notes
    comparison = study.comparison
    if comparison.reference:
        yield f"{len(comparison.moves)} moves are compared with {comparison.reference}."
    reasons = {reason: None for row in comparison.rows for reason in row.reasons}
    for reason in reasons:
        yield f"{reason[0].upper()}{reason[1:]}."
    if study.tuned is not None:
        steady = steady_state_gain(study.tuned, 1.0 / study.rate_hz)
        yield (
            f"Tuned from the noise at rest: Q_angle {study.tuned.q_angle:.3g} deg²/s, Q_bias "
            f"{study.tuned.q_bias:.3g} (deg/s)²/s, R {study.tuned.r_deg2:.3g} deg²; the gain settles at "
            f"{steady.k_angle:.4g} for the angle and {steady.k_bias:.4g}/s for the bias."
        )
    if study.check is not None:
        yield study.check.sentence
    verdict = tuned_against_paper(comparison)
    if verdict is not None:
        yield verdict
