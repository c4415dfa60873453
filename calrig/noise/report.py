"""The document of a unit's noise (CONTRACT section 7), with its summary in sentences."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from calrig.model.noise import Coefficients, Distribution
from calrig.noise.analysis import ELEVATION, ChannelNoise, Noise
from calrig.noise.units import bias_instability, level, quantity, white_density, white_random_walk

_SENSORS = {"accel": "Accelerometer", "gyro": "Gyro", "elevation": "Elevation"}
_COLOURS = {
    "white": "white (the error of a mean over τ falls as 1/√τ)",
    "pink": "pink (flicker: averaging longer than its floor gains nothing)",
    "brown": "brown (a random walk: averaging longer makes it worse)",
    "quantisation-limited": "limited by quantisation: the steps of the converter are as large as the noise",
    "lines": "not white: it contains a spectral line",
    "mixed": "of more than one kind",
}
MOST_LINES = 3
"""Named of one channel; the document has them all."""


def summarise(noise: Noise) -> list[str]:
    """One sentence each: what was read, then colour, size, floor, lines, distribution, temperature."""
    sentences = [f"{quantity(noise.duration_s, 's')} at {quantity(noise.rate_hz, 'Hz')}.", *noise.notes]
    for sensor, title in _SENSORS.items():
        group = {_axis(name): one for name, one in noise.channels.items() if name.startswith(f"{sensor}_")}
        if group:
            sentences += _of_sensor(title, group)
    return sentences


def _axis(name: str) -> str:
    return "" if name == ELEVATION else name.split("_")[1]


def _of_sensor(title: str, group: Mapping[str, ChannelNoise]) -> Iterator[str]:
    yield from _colours(title, group)
    yield from _figures(f"{title}: white noise", group, _white)
    yield from _figures(f"{title}: bias instability", group, _floor)
    for one in group.values():
        yield from _tones(one)
        yield from _shape(one)
        yield from _temperature(one)


def _colours(title: str, group: Mapping[str, ChannelNoise]) -> Iterator[str]:
    by_colour: dict[str, list[str]] = {}
    for axis, one in group.items():
        if one.colour is not None:
            by_colour.setdefault(one.colour, []).append(axis)
    for colour, axes in by_colour.items():
        where = "" if len(axes) == len(group) else f", {' and '.join(axes)}"
        yield f"{title}{where}: the noise is {_COLOURS[colour]}."


def _figures(
    what: str, group: Mapping[str, ChannelNoise], words: Callable[[ChannelNoise], str | None]
) -> Iterator[str]:
    said = [f"{axis} {text}".strip() for axis, one in group.items() if (text := words(one)) is not None]
    if said:
        yield f"{what} {', '.join(said)}."


def _white(one: ChannelNoise) -> str | None:
    white = one.coefficients.white
    if white is None:
        return None
    walk = white_random_walk(one.name, white.value)
    return white_density(one.name, white.value) + (f" ({walk})" if walk else "")


def _floor(one: ChannelNoise) -> str | None:
    flicker = one.coefficients.flicker
    return None if flicker is None else bias_instability(one.name, flicker.value)


def _tones(one: ChannelNoise) -> Iterator[str]:
    lines = one.lines[:MOST_LINES]
    if lines:
        tones = ", ".join(
            f"{quantity(line.frequency_hz, 'Hz')} of amplitude {level(one.name, line.amplitude)}"
            for line in lines
        )
        more = f" and {len(one.lines) - len(lines)} more" if len(one.lines) > len(lines) else ""
        yield f"{one.name} contains a spectral line at {tones}{more}: the noise is not white."


def _shape(one: ChannelNoise) -> Iterator[str]:
    found = one.distribution
    if found.gaussian is False:
        yield (
            f"{one.name} is not Gaussian (p {found.p_value:.2g}, skewness {found.skewness:+.2f}, "
            f"excess kurtosis {found.kurtosis:+.2f})."
        )
    if found.outliers:
        are = "outlier" if found.outliers == 1 else "outliers"
        yield f"{one.name} has {found.outliers} {are}, further out than chance would have them."


def _temperature(one: ChannelNoise) -> Iterator[str]:
    found = one.temperature
    if found is not None and abs(found.per_c) > 2.0 * found.std:
        slope, std = (level(one.name, value) for value in (found.per_c, found.std))
        yield f"{one.name} changes by {slope} (± {std}) a °C."


def noise_document(noise: Noise) -> dict[str, Any]:
    """Return what `calrig noise --json` prints; a number that is not known is None."""
    return {
        "rate_hz": noise.rate_hz,
        "duration_s": noise.duration_s,
        "dropped": {"gaps": noise.gaps, "not_finite": noise.not_finite},
        "channels": {name: _channel(one) for name, one in noise.channels.items()},
        "summary": summarise(noise),
    }


def said_first(warnings: Sequence[str], document: dict[str, Any]) -> dict[str, Any]:
    """Return a document whose summary begins with what was said of the file it came from, as sentences."""
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
        "allan": {name: getattr(curve, name).tolist() for name in ("tau_s", "deviation", "low", "high")},
        "coefficients": Coefficients.model_validate(one.coefficients).model_dump(),
        "lines": [line.model_dump() for line in one.lines],
        "distribution": Distribution.model_validate(spread).model_dump(),
        "temperature": None if one.temperature is None else one.temperature.model_dump(),
    }
