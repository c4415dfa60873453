"""Pictures of runs: what was read while they went on, and the residual of each pose."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from calrig.calibration.poses import Pose
from calrig.estimation.angles import wrap_deg
from calrig.figures.parts import (
    APPROACHES,
    GREY,
    PALETTE,
    Figure,
    as_text,
    axis_of,
    colours_of,
    dimmed,
    error_bars,
    layout_of,
    line_of,
    points_of,
)

MAX_POINTS = 4000
"""Of one line: more than a screen has columns, few enough to draw in a blink."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One unit's poses and the calibration that applies to them, for residual curves laid over each other."""

    name: str
    poses: Sequence[Pose]
    bias_deg: float
    scale: float | None


def timeline(
    time_s: Sequence[float],
    stage_deg: Sequence[float | None],
    reading_deg: Sequence[float | None],
    time_scale: float = 1.0,
) -> Figure:
    """Stage and reading against time, thinned to at most `MAX_POINTS` points a line.

    A board's clock is the only one of its samples, so that the axis is its time. Of a simulated rig whose
    clocks run faster the axis is the time on the wall, which is what the run took.

    Args:
        time_s: (n,) seconds of the rig's clock since the run began, increasing.
        stage_deg: (n,) elevation the stage reported, in degrees.
        reading_deg: (n,) filtered elevation, in degrees.
        time_scale: seconds of the rig's clocks for one on the wall; the page divides live readings by it.
    """
    stride = max(1, -(-len(time_s) // MAX_POINTS))
    time = [at_s / time_scale for at_s in time_s[::stride]]
    hover = "%{x:.1f} s: %{y:.3f}°"
    stage = line_of("stage", time, list(stage_deg[::stride]), PALETTE[1], hover)
    reading = line_of("reading", time, list(reading_deg[::stride]), PALETTE[0], hover)
    stage["line"]["width"] = 4
    stage["opacity"] = 0.55
    title = "time (s)" if time_scale == 1.0 else f"time (s), simulated clocks {time_scale:g}× faster"
    layout = {**layout_of(title, "elevation (°)"), "meta": {"time_scale": time_scale}}
    return {"data": [stage, reading], "layout": layout}


def residual(
    poses: Sequence[Pose],
    *,
    left_deg: Sequence[float | None] | None = None,
    scale: float | None = None,
    excluded: Collection[int] = (),
    what: str = "calibrated",
) -> Figure:
    """Return residual of each pose against elevation: uncorrected above, corrected below, marked by approach.

    Args:
        poses: in the order measured.
        left_deg: of each pose, once calibrated; None while it is not known, which leaves the lower half out.
        scale: of the calibration, which standard errors are divided by; None counts as 1.
        excluded: indices of poses that are out of the result; drawn as crosses.
        what: the lower half shows, in words.
    """
    layout = layout_of("elevation (°)", "reading − stage (°)", zeroline=True)
    layout["legend"]["title"] = {"text": "approach", "side": "left", "font": {"size": 12}}
    raw_deg = [_residual_deg(pose, 0.0, 1.0) for pose in poses]
    data = _residual_traces(poses, raw_deg, 1.0, excluded, "raw")
    if left_deg is None:
        return {"data": data, "layout": layout}
    lower = _residual_traces(poses, left_deg, 1.0 if scale is None else scale, excluded, what)
    for trace in lower:
        trace.update(yaxis="y2", showlegend=False)
    layout["yaxis"]["domain"] = [0.54, 1.0]
    layout["yaxis"]["title"] = {"text": "raw (°)"}
    layout["yaxis2"] = {**axis_of(f"{what} (°)"), "domain": [0.0, 0.46], "zeroline": True}
    layout["xaxis"]["anchor"] = "y2"
    return {"data": [*data, *lower], "layout": layout}


def residuals_overlaid(curves: Sequence[Curve], chosen: Collection[str] = ()) -> Figure:
    """Calibrated residual against elevation, one colour a unit: a line through the means, points behind.

    Where units are more than colours, those that are not among the `chosen` are grey lines alone.
    """
    layout = layout_of("elevation (°)", "calibrated residual (°)", zeroline=True)
    data: list[dict[str, Any]] = []
    colours = colours_of([curve.name for curve in curves], chosen)
    for k, curve in enumerate(sorted(curves, key=lambda curve: colours[curve.name] != GREY)):
        colour = colours[curve.name]
        scale = 1.0 if curve.scale is None else curve.scale
        points = [(p.theta_deg, _residual_deg(p, curve.bias_deg, scale)) for p in curve.poses]
        means = _means_by_target(curve.poses, [y for _, y in points])
        group = {"legendgroup": str(k), "name": as_text(curve.name)}
        line = line_of(curve.name, [x for x, _ in means], [y for _, y in means], colour)
        line = {**line, **group, "hovertemplate": "%{x:.2f}°: %{y:.4f}°"}
        if colour == GREY:
            data.append(dimmed(line))
            continue
        x, y = [x for x, _ in points], [y for _, y in points]
        marker = {"color": colour, "size": 5, "opacity": 0.4}
        behind = points_of(curve.name, x, y, marker, hoverinfo="skip", showlegend=False)
        data += [{**behind, **group}, line]
    return {"data": data, "layout": layout}


def _residual_deg(pose: Pose, bias_deg: float, scale: float) -> float:
    return wrap_deg(pose.reading_deg - bias_deg - scale * pose.theta_deg) / scale


def _residual_traces(
    poses: Sequence[Pose],
    left_deg: Sequence[float | None],
    scale: float,
    excluded: Collection[int],
    what: str,
) -> list[dict[str, Any]]:
    traces = []
    for approach, (name, symbol, colour) in APPROACHES.items():
        kept = [k for k, p in enumerate(poses) if (p.approach or 0) == approach and k not in excluded]
        if kept:
            traces.append(_residual_points(poses, left_deg, kept, scale, (name, symbol, colour), what))
    out = sorted(k for k in excluded if k < len(poses))
    if out:
        traces.append(_residual_points(poses, left_deg, out, scale, ("excluded", "x-thin", GREY), what))
    return traces


def _residual_points(
    poses: Sequence[Pose],
    left_deg: Sequence[float | None],
    chosen: Sequence[int],
    scale: float,
    look: tuple[str, str, str],
    what: str,
) -> dict[str, Any]:
    name, symbol, colour = look
    errors = [poses[k].reading_stderr_deg for k in chosen]
    return points_of(
        name,
        [poses[k].theta_deg for k in chosen],
        [left_deg[k] for k in chosen],
        {"color": colour, "symbol": symbol, "size": 8, "line": {"color": colour, "width": 1}},
        customdata=list(chosen),
        error_y=error_bars([None if e is None else e / abs(scale) for e in errors], colour),
        hovertemplate=f"pose %{{customdata}} at %{{x:.2f}}°: {what} %{{y:.4f}}°<extra></extra>",
    )


def _means_by_target(poses: Sequence[Pose], values: Sequence[float]) -> list[tuple[float, float]]:
    """Mean elevation and mean value of the poses at each commanded elevation, in order of elevation."""
    groups: dict[float, list[tuple[float, float]]] = {}
    for pose, value in zip(poses, values, strict=True):
        groups.setdefault(round(pose.target_deg, 3), []).append((pose.theta_deg, value))
    return [
        (sum(x for x, _ in group) / len(group), sum(y for _, y in group) / len(group))
        for _, group in sorted(groups.items())
    ]
