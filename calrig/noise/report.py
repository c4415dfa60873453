"""CONTRACT section 7's document of a unit's noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from calrig.estimation.angles import FloatArray
from calrig.noise.analysis import ChannelNoise, Noise, analyse
from calrig.noise.summary import summarise

COEFFICIENTS = ("quantisation", "white", "flicker", "random_walk", "ramp")


def report(
    channels: dict[str, FloatArray],
    time_s: FloatArray | None = None,
    rate_hz: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Analyses a log and says what was found; arguments and errors as of `analyse`."""
    return noise_document(analyse(channels, time_s, rate_hz, progress))


def noise_document(noise: Noise) -> dict[str, Any]:
    """What `calrig noise --json` prints; a number that is not known is None."""
    return {
        "rate_hz": noise.rate_hz,
        "duration_s": noise.duration_s,
        "dropped": {"gaps": noise.gaps, "not_finite": noise.not_finite},
        "channels": {name: _channel(one) for name, one in noise.channels.items()},
        "summary": summarise(noise),
    }


def said_first(warnings: Sequence[str], document: dict[str, Any]) -> dict[str, Any]:
    """A document whose summary begins with what was said of the file it came from, as sentences."""
    said = [f"{warning[0].upper()}{warning[1:]}." for warning in warnings]
    return {**document, "summary": [*said, *document["summary"]]}


def _channel(one: ChannelNoise) -> dict[str, Any]:
    curve, spread = one.allan, one.distribution
    return {
        "mean": spread.mean,
        "std": spread.std,
        "adf_slope": curve.adf_slope,
        "psd_slope": None if one.psd_slope is None else one.psd_slope.slope,
        "colour": one.colour,
        "allan": {
            "tau_s": curve.tau_s.tolist(),
            "deviation": curve.deviation.tolist(),
            "low": curve.low.tolist(),
            "high": curve.high.tolist(),
        },
        "coefficients": {
            kind: None if (found := getattr(one.coefficients, kind)) is None else asdict(found)
            for kind in COEFFICIENTS
        },
        "lines": [
            {"frequency_hz": line.frequency_hz, "amplitude": line.amplitude, "p_value": line.p_value}
            for line in one.lines
        ],
        "distribution": {
            "gaussian": spread.gaussian,
            "p_value": spread.p_value,
            "skewness": spread.skewness,
            "kurtosis": spread.kurtosis,
            "outliers": spread.outliers,
        },
        "temperature": None
        if one.temperature is None
        else {"per_c": one.temperature.per_c, "std": one.temperature.std},
    }
