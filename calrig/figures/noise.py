"""Pictures of a sensor's noise: Allan deviation, spectrum, distribution (Nirmal et al. 2016, 3, 4, 9)."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.figures.parts import PALETTE, Figure, as_text, band_of, colour_of, layout_of, line_of, points_of
from calrig.noise.allan import KINDS, variance_of
from calrig.noise.analysis import ChannelNoise, Noise

SPECTRUM_POINTS = 600
"""Uniformly spaced in log frequency; below, where the spectrum has fewer, every one of its own."""
SENSORS = {"accel": "accelerometer", "gyro": "gyro", "elevation": "elevation"}


def noise_figures(noise: Noise) -> list[list[tuple[str, Figure]]]:
    """All figures of a unit's noise with captions, in rows: a column a sensor, then the distributions."""
    groups = {
        words: [one for name, one in noise.channels.items() if name.startswith(f"{sensor}_")]
        for sensor, words in SENSORS.items()
    }
    groups = {words: group for words, group in groups.items() if group}
    rows = [
        [(f"Allan deviation, {words}", allan_deviation(group)) for words, group in groups.items()],
        [(f"Power spectral density, {words}", spectrum(group)) for words, group in groups.items()],
    ]
    rows += [[(f"Distribution, {one.name}", distribution(one)) for one in group] for group in groups.values()]
    return [row for row in rows if row]


def allan_deviation(channels: Sequence[ChannelNoise]) -> Figure:
    """Overlapping Allan deviation with its confidence limits, and the fitted terms' sum through it.

    Of one channel alone, each fitted term is drawn as well.

    `channels` are of one unit.
    """
    layout = _double_log("averaging time τ (s)", f"Allan deviation ({_unit(channels)})")
    data: list[dict[str, Any]] = []
    for k, channel in enumerate(channels):
        curve, colour = channel.allan, colour_of(k)
        if len(curve.tau_s) == 0:
            continue
        tau_s, low, high = curve.tau_s.tolist(), curve.low.tolist(), curve.high.tolist()
        data.append(band_of(channel.name, tau_s, low, high, colour))
        line = line_of(channel.name, tau_s, curve.deviation.tolist(), colour)
        hover = f"τ = %{{x:.3g}} s: %{{y:.3g}} {channel.unit}"
        data.append({**line, "legendgroup": channel.name, "hovertemplate": hover})
        data += _fitted(channel, colour, apart=len(channels) == 1)
    return {"data": data, "layout": layout}


def spectrum(channels: Sequence[ChannelNoise]) -> Figure:
    """One-sided power spectral density, thinned uniformly in log frequency, with the lines that were found.

    `channels` are of one unit.
    """
    unit = _unit(channels)
    layout = _double_log("frequency (Hz)", f"PSD (({unit})²/Hz)" if "/" in unit else f"PSD ({unit}²/Hz)")
    data: list[dict[str, Any]] = []
    for k, channel in enumerate(channels):
        frequency_hz, density = _thinned(channel.psd.frequency_hz, channel.psd.density)
        if len(frequency_hz) == 0:
            continue
        line = line_of(channel.name, frequency_hz.tolist(), density.tolist(), colour_of(k))
        line["line"]["width"] = 1.2
        data.append({**line, "legendgroup": channel.name, "hovertemplate": "%{x:.3g} Hz: %{y:.3g}"})
        data += _lines(channel, frequency_hz, density, colour_of(k))
    return {"data": data, "layout": layout}


def distribution(channel: ChannelNoise) -> Figure:
    """Histogram of one channel's noise, and the Gaussian of its mean and standard deviation over it."""
    found = channel.distribution
    layout = layout_of(f"{as_text(channel.name)} ({channel.unit})", "samples")
    layout.update(showlegend=False, bargap=0)
    edges, counts = found.edges, found.counts
    middle = (edges[1:] + edges[:-1]) / 2.0
    bars = {
        "type": "bar",
        "name": as_text(channel.name),
        "x": middle.tolist(),
        "y": counts.tolist(),
        "width": np.diff(edges).tolist(),
        "marker": {"color": PALETTE[0], "opacity": 0.6},
        "hovertemplate": f"%{{x:.4g}} {channel.unit}: %{{y}}",
    }
    data = [bars]
    if found.std:
        x = np.linspace(edges[0], edges[-1], 200)
        bell = np.exp(-0.5 * ((x - found.mean) / found.std) ** 2) / (found.std * math.sqrt(2.0 * math.pi))
        scale = counts.sum() * float(np.diff(edges).mean())
        data.append(line_of("Gaussian", x.tolist(), (scale * bell).tolist(), PALETTE[1]))
    return {"data": data, "layout": layout}


def _double_log(x_title: str, y_title: str) -> dict[str, Any]:
    layout = layout_of(x_title, y_title)
    for axis in ("xaxis", "yaxis"):
        layout[axis].update(type="log", exponentformat="power", dtick=1)
    return layout


def _unit(channels: Sequence[ChannelNoise]) -> str:
    return channels[0].unit if channels else ""


def _fitted(channel: ChannelNoise, colour: str, *, apart: bool) -> list[dict[str, Any]]:
    """Return the sum of the fitted terms as a dashed line, and each by itself as a dotted one if `apart`."""
    tau_s, found = channel.allan.tau_s, channel.coefficients
    kinds = dict(zip(KINDS, variance_of(tau_s).T, strict=True)) | {"ramp": tau_s**2 / 2.0}
    terms = {
        kind: term.value**2 * shape
        for kind, shape in kinds.items()
        if (term := getattr(found, kind)) is not None
    }
    if not terms:
        return []
    total = _dashed(
        f"{channel.name}, fitted", tau_s, sum(terms.values(), np.zeros(len(tau_s))), colour, "dash"
    )
    total |= {"legendgroup": channel.name, "showlegend": apart}
    if not apart:
        return [total]
    each = (
        _dashed(kind.replace("_", " "), tau_s, variance, colour_of(k), "dot")
        for k, (kind, variance) in enumerate(terms.items(), start=1)
    )
    return [total, *each]


def _dashed(name: str, tau_s: FloatArray, variance: FloatArray, colour: str, dash: str) -> dict[str, Any]:
    trace = line_of(name, tau_s.tolist(), np.sqrt(variance).tolist(), colour)
    trace["line"].update(dash=dash, width=1.2)
    trace["hoverinfo"] = "skip"
    return trace


def _lines(
    channel: ChannelNoise, frequency_hz: FloatArray, density: FloatArray, colour: str
) -> list[dict[str, Any]]:
    """Return where the spectral lines stand, at the height of what is drawn there."""
    if not channel.lines:
        return []
    at = [line.frequency_hz for line in channel.lines]
    height = [float(density[int(np.abs(frequency_hz - one).argmin())]) for one in at]
    marker = {"color": colour, "symbol": "triangle-down", "size": 11}
    points = points_of("line", at, height, marker, legendgroup=channel.name, showlegend=False)
    points["customdata"] = [line.amplitude for line in channel.lines]
    points["hovertemplate"] = f"line at %{{x:.4g}} Hz, amplitude %{{customdata:.3g}} {channel.unit}"
    return [points]


def _thinned(frequency_hz: FloatArray, density: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The spectrum above 0 Hz, averaged within bins of equal log width where those hold more than one."""
    frequency_hz, density = frequency_hz[1:], density[1:]
    if len(frequency_hz) <= SPECTRUM_POINTS:
        return frequency_hz, density
    edges = np.geomspace(frequency_hz[0], frequency_hz[-1], SPECTRUM_POINTS)
    first = np.unique(np.searchsorted(frequency_hz, edges * (1.0 - 1e-12)))
    first = first[first < len(frequency_hz)]
    count = np.diff(np.append(first, len(frequency_hz)))
    return np.add.reduceat(frequency_hz, first) / count, np.add.reduceat(density, first) / count
