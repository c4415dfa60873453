"""Pictures of a diagnosis: the error before and after, and the partial residuals of its effects."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calrig.calibration.diagnosis import DrawnResiduals, PartialResidual
from calrig.calibration.effects import EFFECTS, UNNAMED, covariate_of
from calrig.calibration.line import rms
from calrig.calibration.results import numbers_of
from calrig.estimation.angle_text import angle_text
from calrig.estimation.angles import FloatArray
from calrig.figures.files import Rows
from calrig.figures.parts import (
    APPROACHES,
    GREY,
    PALETTE,
    Figure,
    as_text,
    error_bars,
    layout_of,
    line_of,
    points_of,
)

CURVE_POINTS = 400
ROOM = 1.2
"""Beside the longest bar, for its figure."""
ROUGH = 1.0
"""Mean squared step between neighbours over the variance: about this where a cycle has six points."""
MANY_PERIODS = 6.0
MOST_TURNS = 2
"""From up to down or back, of what follows temperature alone."""


def before_and_after(diagnosis: Mapping[str, Any]) -> Figure:
    """Error on held-out poses before and after, with the noise floor; what is not known is left out.

    `diagnosis` is a document of CONTRACT section 5.
    """
    fresh = diagnosis["confirmed_by"] or {}
    bars = [
        ("before", diagnosis["base"]["held_out_rms_deg"], PALETTE[1]),
        ("after", diagnosis["final"]["held_out_rms_deg"], PALETTE[0]),
        ("fresh run, before", fresh.get("before_rms_deg"), PALETTE[1]),
        ("fresh run, after", fresh.get("after_rms_deg"), PALETTE[0]),
        ("noise floor", diagnosis["noise"]["floor_deg"], GREY),
    ]
    known = [(name, value, colour) for name, value, colour in bars if value is not None]
    layout = layout_of("RMS (°)", "")
    layout.update(showlegend=False, bargap=0.3, hovermode=False)
    layout["xaxis"]["range"] = [0.0, ROOM * max((value for _, value, _ in known), default=1.0)]
    layout["yaxis"].update(autorange="reversed", showgrid=False, ticks="")
    trace = {
        "type": "bar",
        "orientation": "h",
        "y": [name for name, _, _ in known],
        "x": [value for _, value, _ in known],
        "text": [angle_text(value) for _, value, _ in known],
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {"color": [colour for _, _, colour in known]},
    }
    return {"data": [trace], "layout": layout}


def partial_residual(found: PartialResidual, wave: Mapping[str, float] | None = None) -> Figure:
    """Return the partial residual of one effect against its covariate, with the fitted effect through it.

    The effect is a line where it is a function of the covariate, points where it depends on more than that.

    `wave` has `amplitude_deg`, `phase_deg` and `period_deg` of a wave of the angle; the poses of many periods
    are laid over each other in one.
    """
    layout = layout_of(as_text(_axis(found.covariate)), "partial residual (°)", zeroline=True)
    at = found.at
    is_folded = wave is not None and np.ptp(at) > MANY_PERIODS * wave["period_deg"]
    if wave is not None and is_folded:
        at = np.mod(at, wave["period_deg"])
        layout["xaxis"]["title"]["text"] += f", in one period of {wave['period_deg']:.5g}°"
    if found.covariate == "approach":
        at = _spread_by_elevation(found)
        senses = [int(sense) for sense in np.unique(found.at)]
        names = [APPROACHES[sense][0] for sense in senses]
        layout["xaxis"].update(tickvals=senses, ticktext=names, range=[-1.6, 1.6])
    points = points_of(
        "poses",
        at.tolist(),
        found.residual_deg.tolist(),
        {"color": PALETTE[0], "size": 6, "opacity": 0.7},
        customdata=found.theta_deg.tolist(),
        hovertemplate="at %{customdata:.2f}°: %{y:.4f}°<extra></extra>",
    )
    fitted = _one_period(wave) if wave is not None and is_folded else _fitted(found, at)
    return {"data": [points, fitted], "layout": layout}


def _one_period(wave: Mapping[str, float]) -> dict[str, Any]:
    turn = np.linspace(0.0, 1.0, CURVE_POINTS)
    effect_deg = wave["amplitude_deg"] * np.sin(2.0 * np.pi * turn + np.radians(wave["phase_deg"]))
    line = line_of("fitted effect", (turn * wave["period_deg"]).tolist(), effect_deg.tolist(), PALETTE[1])
    return {**line, "line": {"color": PALETTE[1], "width": 3}}


def diagnosis_figures(found: DrawnResiduals, diagnosis: Mapping[str, Any]) -> Rows:
    """Return residuals before and after, by angle and by time, and each effect with its partial residual.

    `diagnosis` is the document, with its effects in the order of `found.effects`.
    """
    is_good = diagnosis["reference"] == "good"
    rows = [
        [
            (f"{when}, by {along}: RMS {angle_text(rms(left_deg))}", _left(at, left_deg, axis, colour))
            for along, at, axis in _along(found)
        ]
        for when, left_deg, colour in (
            ("Bias and scale", found.before_deg, PALETTE[1]),
            ("With effects", found.after_deg, PALETTE[0]),
        )
    ]
    cells = [
        (_caption(effect, reference_is_good=is_good), partial_residual(part, _wave(effect)))
        for effect, part in zip(diagnosis["effects"], found.effects, strict=True)
    ]
    return [*rows, *(cells[k : k + 2] for k in range(0, len(cells), 2))]


def _along(found: DrawnResiduals) -> list[tuple[str, FloatArray, str]]:
    """Return what residuals are drawn along: its name, (n,) values, and the title of the axis."""
    by_angle = ("angle", found.theta_deg, "elevation (°)")
    if found.time_s is None:
        if (np.diff(found.theta_deg) >= 0.0).all():
            return [by_angle]
        return [by_angle, ("row", np.arange(len(found.theta_deg), dtype=np.float64), "row of the table")]
    return [by_angle, ("time", found.time_s, "time (s)")]


def _left(at: FloatArray, left_deg: FloatArray, axis: str, colour: str) -> Figure:
    layout = layout_of(axis, "residual (°)", zeroline=True)
    layout["showlegend"] = False
    marker = {"color": colour, "size": 5, "opacity": 0.7}
    hover = "%{x:.2f}: %{y:.5f}°<extra></extra>"
    points = points_of("poses", at.tolist(), left_deg.tolist(), marker, hovertemplate=hover)
    return {"data": [points], "layout": layout}


def _caption(effect: Mapping[str, Any], *, reference_is_good: bool) -> str:
    if effect["name"] == UNNAMED:
        return as_text(
            f"Something that follows {covariate_of(effect['covariate']).title} ({effect['verdict']})"
        )
    words, wave = EFFECTS[effect["name"]].wording(reference_is_good=reference_is_good), _wave(effect)
    of_period = f", period {wave['period_deg']:.5g}°" if wave else ""
    return f"{words.title}{of_period} ({effect['verdict']})"


def _wave(effect: Mapping[str, Any]) -> dict[str, float] | None:
    numbers = numbers_of(effect["parameters"])
    is_wave = {"amplitude_deg", "phase_deg", "period_deg"} <= numbers.keys() and not effect.get("changed")
    return numbers if is_wave else None


def _axis(name: str) -> str:
    """Return the title of the axis of a covariate, with its unit."""
    covariate = covariate_of(name)
    if name == "approach":
        return f"{covariate.title}, spread by elevation"
    return f"{covariate.title} ({covariate.unit})" if covariate.unit else covariate.title


def error_map(
    stage_deg: Sequence[float], approach: Sequence[int], error_deg: Sequence[float], std_deg: Sequence[float]
) -> Figure:
    """Return the rig error map by angle of the dial, one line an approach, with standard errors."""
    layout = layout_of("angle of the dial (°)", "elevation less dial (°)", zeroline=True)
    data = []
    for sense, (name, symbol, colour) in APPROACHES.items():
        rows = [k for k, a in enumerate(approach) if a == sense]
        if rows:
            x, y = [stage_deg[k] for k in rows], [error_deg[k] for k in rows]
            trace = line_of(name, x, y, colour, "%{x:.0f}°: %{y:.4f}°")
            trace["line"]["width"] = 1.5
            marker = {"color": colour, "symbol": symbol, "size": 7}
            errors = error_bars([std_deg[k] for k in rows], colour)
            data.append({**trace, "mode": "lines+markers", "marker": marker, "error_y": errors})
    return {"data": data, "layout": layout}


def _fitted(found: PartialResidual, at: FloatArray) -> dict[str, Any]:
    order = np.argsort(at, kind="stable")
    x, y = at[order], found.effect_deg[order]
    trace = {"type": "scatter", "name": "fitted effect", "hoverinfo": "skip"}
    if found.covariate == "approach":
        return {**trace, "mode": "lines", "line": {"color": PALETTE[1], "width": 3}, **_levels(found, at)}
    if _is_rough(y) or (found.covariate == "temperature_c" and _turns_often(y)):
        line = {"color": PALETTE[1], "width": 2}
        marker = {"color": PALETTE[1], "symbol": "x-thin", "size": 8, "line": line}
        return {**trace, "mode": "markers", "x": x.tolist(), "y": y.tolist(), "marker": marker}
    stride = max(1, -(-len(x) // CURVE_POINTS))
    line = {"color": PALETTE[1], "width": 3}
    return {**trace, "mode": "lines", "x": x[::stride].tolist(), "y": y[::stride].tolist(), "line": line}


def _spread_by_elevation(found: PartialResidual) -> FloatArray:
    """Return poses of one approach beside each other by elevation, so that they do not lie on one line."""
    largest = max(float(np.abs(found.theta_deg).max()), 1.0)
    return np.asarray(found.at + 0.45 * found.theta_deg / largest, dtype=np.float64)


def _levels(found: PartialResidual, at: FloatArray) -> dict[str, list[float | None]]:
    """Return a level line for each approach, with gaps between them."""
    x: list[float | None] = []
    y: list[float | None] = []
    for approach in np.unique(found.at):
        side = np.flatnonzero(found.at == approach)
        ends = side[[at[side].argmin(), at[side].argmax()]]
        x += [*at[ends].tolist(), None]
        y += [float(np.median(found.effect_deg[side]))] * len(ends) + [None]
    return {"x": x[:-1], "y": y[:-1]}


def _turns_often(y: FloatArray) -> bool:
    """Whether it goes up and down: at one temperature it differs with elevation, or on the way back."""
    steps = np.sign(np.diff(y))
    return int(np.count_nonzero(np.diff(steps[steps != 0]))) > MOST_TURNS


def _is_rough(y: FloatArray) -> bool:
    variance = float(y.var())
    return variance > 0.0 and float((np.diff(y) ** 2).mean()) > ROUGH * variance
