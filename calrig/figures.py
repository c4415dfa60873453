"""Every picture, drawn once: measurements in, a figure in plotly's JSON form out.

Only plain dicts and lists come out, so nothing here needs plotly itself, and what is not known is None,
which plotly leaves out of a line. Colours keep a contrast of 3:1 or more on white and on near-black alike;
a page may set text and grid to its own theme over `layout`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from calrig.calibration.pose import Pose

Figure = dict[str, Any]
Run = Mapping[str, Any]
"""A run as CONTRACT section 2's comparison lists it: `run_id, finished_at, bias_deg, bias_std_deg, …`."""

PALETTE = ("#3b82c4", "#d0741f", "#1f9a7a", "#9063cd", "#d1495b", "#8a7d2c", "#3a93a5", "#b0589a")
MAX_POINTS = 4000
"""Of one line: more than a screen has columns, few enough to draw in a blink."""

_GREY = "#7d8590"
_GRID = "rgba(125,133,144,0.25)"
_DATES = {"type": "date", "nticks": 4, "tickangle": 0}  # few and level: they must fit a phone too
_QUANTITIES = {
    "bias": ("bias_deg", "bias_std_deg", "bias (°)"),
    "scale": ("scale", "scale_std", "scale (1)"),
    "rms": ("rms_calibrated_deg", None, "RMS calibrated (°)"),
}
_APPROACHES = {
    1: ("upward", "triangle-up", PALETTE[0]),
    -1: ("downward", "triangle-down", PALETTE[1]),
    0: ("not known", "circle", PALETTE[2]),
}


@dataclass(frozen=True, slots=True)
class Curve:
    """One unit's poses and the calibration that applies to them, for residual curves laid over each other."""

    name: str
    poses: Sequence[Pose]
    bias_deg: float
    scale: float | None


def timeline(
    time_s: Sequence[float], stage_deg: Sequence[float | None], reading_deg: Sequence[float | None]
) -> Figure:
    """Stage and reading against time, thinned to at most `MAX_POINTS` points a line.

    Args:
        time_s: (n,) seconds since the run began, increasing.
        stage_deg: (n,) elevation the stage reported, in degrees.
        reading_deg: (n,) filtered elevation, in degrees.
    """
    stride = max(1, -(-len(time_s) // MAX_POINTS))
    time = list(time_s[::stride])
    hover = "%{x:.1f} s: %{y:.3f}°"
    stage = _line("stage", time, list(stage_deg[::stride]), PALETTE[1], hover)
    reading = _line("reading", time, list(reading_deg[::stride]), PALETTE[0], hover)
    stage["line"]["width"] = 4
    stage["opacity"] = 0.55
    return {"data": [stage, reading], "layout": _layout("time (s)", "elevation (°)")}


def residual(
    poses: Sequence[Pose],
    *,
    bias_deg: float | None = None,
    scale: float | None = None,
    excluded: Collection[int] = (),
) -> Figure:
    """Residual of each pose against elevation: as it came above, calibrated below, marked by approach.

    Args:
        poses: in the order measured.
        bias_deg: of the calibration; None while it is not known, which leaves the lower half out.
        scale: of the calibration; None counts as 1.
        excluded: indices of poses that are out of the result; drawn as crosses.
    """
    layout = _layout("elevation (°)", "reading − stage (°)")
    layout["yaxis"]["zeroline"] = True
    layout["legend"]["title"] = {"text": "approach", "side": "left", "font": {"size": 12}}
    data = _residual_traces(poses, 0.0, 1.0, excluded, "raw")
    if bias_deg is None:
        return {"data": data, "layout": layout}
    lower = _residual_traces(poses, bias_deg, 1.0 if scale is None else scale, excluded, "calibrated")
    for trace in lower:
        trace.update(yaxis="y2", showlegend=False)
    layout["yaxis"]["domain"] = [0.54, 1.0]
    layout["yaxis"]["title"] = {"text": "raw (°)"}
    layout["yaxis2"] = {**_axis("calibrated (°)"), "domain": [0.0, 0.46], "zeroline": True}
    layout["xaxis"]["anchor"] = "y2"
    return {"data": [*data, *lower], "layout": layout}


def history(runs: Sequence[Run]) -> Figure:
    """Bias, scale and RMS of one unit's runs over time, one above the other, with standard errors."""
    done = _finished(runs)
    layout = _layout("finished (UTC)", "")
    layout["xaxis"].update(_DATES, anchor="y3")
    layout["yaxis"] = {**_axis("bias (°)"), "domain": [0.72, 1.0]}
    layout["yaxis2"] = {**_axis("scale (1)"), "domain": [0.36, 0.64]}
    layout["yaxis3"] = {**_axis("RMS (°)"), "domain": [0.0, 0.28]}
    data = [
        {**_over_time("bias", done, "bias_deg", "bias_std_deg", PALETTE[0]), "showlegend": False},
        {
            **_over_time("scale", done, "scale", "scale_std", PALETTE[3]),
            "yaxis": "y2",
            "showlegend": False,
        },
        {**_over_time("RMS raw", done, "rms_raw_deg", None, PALETTE[1]), "yaxis": "y3"},
        {**_over_time("RMS calibrated", done, "rms_calibrated_deg", None, PALETTE[2]), "yaxis": "y3"},
    ]
    return {"data": data, "layout": layout}


def compare(quantity: Literal["bias", "scale", "rms"], units: Mapping[str, Sequence[Run]]) -> Figure:
    """Bias, scale or calibrated RMS over time, one line a unit, with standard errors where there are any.

    Args:
        quantity: which of the three.
        units: each unit's runs by its serial.
    """
    key, std_key, title = _QUANTITIES[quantity]
    layout = _layout("finished (UTC)", title)
    layout["xaxis"].update(_DATES)
    data = [
        _over_time(serial, _finished(runs), key, std_key, _colour(k))
        for k, (serial, runs) in enumerate(units.items())
    ]
    return {"data": data, "layout": layout}


def residuals_overlaid(curves: Sequence[Curve]) -> Figure:
    """Calibrated residual against elevation, one colour a unit: a line through the means, points behind."""
    layout = _layout("elevation (°)", "calibrated residual (°)")
    layout["yaxis"]["zeroline"] = True
    data: list[dict[str, Any]] = []
    for k, curve in enumerate(curves):
        scale = 1.0 if curve.scale is None else curve.scale
        points = [(p.theta_deg, _residual_deg(p, curve.bias_deg, scale)) for p in curve.poses]
        means = _means_by_target(curve.poses, [y for _, y in points])
        group = {"legendgroup": str(k), "name": _text(curve.name)}
        data.append(
            {
                **group,
                "type": "scatter",
                "mode": "markers",
                "x": [x for x, _ in points],
                "y": [y for _, y in points],
                "marker": {"color": _colour(k), "size": 5, "opacity": 0.4},
                "hoverinfo": "skip",
                "showlegend": False,
            }
        )
        line = _line(curve.name, [x for x, _ in means], [y for _, y in means], _colour(k))
        data.append({**line, **group, "hovertemplate": "%{x:.2f}°: %{y:.4f}°"})
    return {"data": data, "layout": layout}


def _residual_deg(pose: Pose, bias_deg: float, scale: float) -> float:
    return (pose.reading_deg - bias_deg) / scale - pose.theta_deg


def _residual_traces(
    poses: Sequence[Pose], bias_deg: float, scale: float, excluded: Collection[int], what: str
) -> list[dict[str, Any]]:
    traces = []
    for approach, (name, symbol, colour) in _APPROACHES.items():
        kept = [k for k, p in enumerate(poses) if (p.approach or 0) == approach and k not in excluded]
        if kept:
            traces.append(_residual_points(poses, kept, bias_deg, scale, (name, symbol, colour), what))
    out = sorted(k for k in excluded if k < len(poses))
    if out:
        traces.append(_residual_points(poses, out, bias_deg, scale, ("excluded", "x-thin", _GREY), what))
    return traces


def _residual_points(
    poses: Sequence[Pose],
    chosen: Sequence[int],
    bias_deg: float,
    scale: float,
    look: tuple[str, str, str],
    what: str,
) -> dict[str, Any]:
    name, symbol, colour = look
    errors = [poses[k].reading_stderr_deg for k in chosen]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": [poses[k].theta_deg for k in chosen],
        "y": [_residual_deg(poses[k], bias_deg, scale) for k in chosen],
        "customdata": list(chosen),
        "error_y": _error_bars([None if e is None else e / abs(scale) for e in errors], colour),
        "marker": {"color": colour, "symbol": symbol, "size": 8, "line": {"color": colour, "width": 1}},
        "hovertemplate": f"pose %{{customdata}} at %{{x:.2f}}°: {what} %{{y:.4f}}°<extra></extra>",
    }


def _means_by_target(poses: Sequence[Pose], values: Sequence[float]) -> list[tuple[float, float]]:
    """Mean elevation and mean value of the poses at each commanded elevation, in order of elevation."""
    groups: dict[float, list[tuple[float, float]]] = {}
    for pose, value in zip(poses, values, strict=True):
        groups.setdefault(round(pose.target_deg, 3), []).append((pose.theta_deg, value))
    return [
        (sum(x for x, _ in group) / len(group), sum(y for _, y in group) / len(group))
        for _, group in sorted(groups.items())
    ]


def _finished(runs: Sequence[Run]) -> list[Run]:
    return sorted((r for r in runs if r["finished_at"] is not None), key=lambda r: _iso(r["finished_at"]))


def _over_time(name: str, runs: Sequence[Run], key: str, std_key: str | None, colour: str) -> dict[str, Any]:
    trace = _line(name, [_iso(r["finished_at"]) for r in runs], [r[key] for r in runs], colour)
    trace["mode"] = "lines+markers"
    trace["marker"] = {"color": colour, "size": 7}
    trace["customdata"] = [str(r["run_id"]) for r in runs]
    trace["hovertemplate"] = "run %{customdata}: %{y:.5f}"
    if std_key:
        trace["error_y"] = _error_bars([r[std_key] for r in runs], colour)
    return trace


def _line(name: str, x: list[Any], y: list[Any], colour: str, hover: str | None = None) -> dict[str, Any]:
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "name": _text(name),
        "x": x,
        "y": y,
        "line": {"color": colour, "width": 2},
    }
    return {**trace, "hovertemplate": hover} if hover else trace


def _error_bars(std: Sequence[float | None], colour: str) -> dict[str, Any]:
    return {"type": "data", "array": list(std), "color": colour, "thickness": 1.2, "width": 3}


def _text(name: str) -> str:
    """A name as plain text: plotly reads a few HTML tags and entities in the names of traces."""
    return name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _colour(k: int) -> str:
    return PALETTE[k % len(PALETTE)]


def _iso(moment: datetime | str) -> str:
    return moment if isinstance(moment, str) else moment.isoformat()


def _axis(title: str) -> dict[str, Any]:
    return {
        "title": {"text": title, "standoff": 8},
        "automargin": True,
        "gridcolor": _GRID,
        "linecolor": _GRID,
        "zerolinecolor": _GREY,
        "zerolinewidth": 1,
        "zeroline": False,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": _GRID,
    }


def _layout(x_title: str, y_title: str) -> dict[str, Any]:
    return {
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": _GREY},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 56, "r": 12, "t": 8, "b": 44},
        "hovermode": "closest",
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "uirevision": "kept",  # a zoom outlives the next update
        "xaxis": _axis(x_title),
        "yaxis": _axis(y_title),
    }
