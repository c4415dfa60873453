"""Draw a figure of points as SVG for paper, from the part of plotly's JSON that calrig's figures use.

No browser is needed. Supported are markers against one x axis and any number of stacked y axes, with ticks,
titles, annotations and a legend; any other figure is refused.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import unescape
from typing import Any
from xml.sax.saxutils import escape

from calrig.figures.parts import APPROACHES, GREY, Figure, as_text, axis_of, layout_of, points_of

FONT = "font-family='Libertinus Serif, DejaVu Serif, serif' font-size='11'"
INK = "#24292f"
LEFT, RIGHT, TOP, BOTTOM = 62.0, 10.0, 34.0, 40.0
"""Margins, in the picture's own units."""
WIDTH, BAND = 680.0, 110.0
"""Of the picture; the height that each y axis gets."""
MARKS = {
    "triangle-up": ((0.0, -1.1), (1.0, 0.7), (-1.0, 0.7)),
    "triangle-down": ((0.0, 1.1), (1.0, -0.7), (-1.0, -0.7)),
}
"""Corners, in radii."""


def svg_of(figure: Figure) -> str:
    """Return the picture.

    Raises:
        ValueError: a trace is not one of markers.
    """
    layout = figure["layout"]
    axes = {key: value for key, value in layout.items() if key.startswith("yaxis")}
    height = TOP + BOTTOM + BAND * len(axes)
    frame = (LEFT, WIDTH - RIGHT, TOP, height - BOTTOM)
    traces = figure["data"]
    if any(trace.get("mode") != "markers" for trace in traces):
        raise ValueError("only figures of points are drawn as SVG")
    x_ends = _ends(x for trace in traces for x in trace["x"])
    body = [*_x_axis(layout["xaxis"], x_ends, frame)]
    for key, axis in axes.items():
        name = key.replace("axis", "")
        own = [trace for trace in traces if trace.get("yaxis", "y") == name]
        body += _band(axis, own, x_ends, frame)
    body += _annotations(layout.get("annotations", ()), frame)
    body += _legend(traces, frame)
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {WIDTH:g} {height:g}' width='{WIDTH:g}' "
        f"height='{height:g}' {FONT}>{''.join(body)}</svg>\n"
    )


_Frame = tuple[float, float, float, float]
"""Left, right, top and bottom of where things are drawn."""


def _band(
    axis: Mapping[str, Any], traces: Sequence[Mapping[str, Any]], x_ends: tuple[float, float], frame: _Frame
) -> Iterator[str]:
    left, right, top, bottom = frame
    low, high = axis.get("domain", (0.0, 1.0))
    below, above = (bottom - share * (bottom - top) for share in (low, high))
    ends = _ends(y for trace in traces for y in trace["y"])
    for tick, text in _ticks(*ends, most=7):
        y = _at(tick, ends, below, above)
        colour = GREY if tick == 0.0 else "#d9dde2"
        yield f"<path d='M{left:g} {y:.2f}H{right:g}' stroke='{colour}' stroke-width='0.7'/>"
        yield _text(left - 6, y + 3.5, text, anchor="end")
    title = axis["title"]["text"]
    yield _text(14, (below + above) / 2, title, turned=True)
    for trace in traces:
        mark = trace["marker"]
        for x, y in zip(trace["x"], trace["y"], strict=True):
            yield _mark(_at(x, x_ends, left, right), _at(y, ends, below, above), mark)


def _x_axis(axis: Mapping[str, Any], ends: tuple[float, float], frame: _Frame) -> Iterator[str]:
    left, right, _, bottom = frame
    for tick, text in _ticks(*ends, most=13):
        x = _at(tick, ends, left, right)
        yield f"<path d='M{x:.2f} {bottom:g}v4' stroke='{GREY}' stroke-width='0.7'/>"
        yield _text(x, bottom + 16, text, anchor="middle")
    yield _text((left + right) / 2, bottom + 33, axis["title"]["text"], anchor="middle")


def _annotations(notes: Iterable[Mapping[str, Any]], frame: _Frame) -> Iterator[str]:
    left, right, top, bottom = frame
    for note in notes:
        x, y = left + note["x"] * (right - left), bottom - note["y"] * (bottom - top)
        yield _text(x, y - 5, unescape(note["text"]), weight="bold")


def _legend(traces: Sequence[Mapping[str, Any]], frame: _Frame) -> Iterator[str]:
    right, x = frame[1], frame[1]
    for trace in reversed([trace for trace in traces if trace.get("showlegend", True)]):
        name = unescape(trace["name"])
        x -= 6.2 * len(name) + 22
        yield _mark(x, 10.0, trace["marker"])
        yield _text(x + 9, 13.5, name)
    if x < right:
        yield _text(x - 12, 13.5, "approach:", anchor="end")


def _mark(x: float, y: float, marker: Mapping[str, Any]) -> str:
    radius = marker["size"] / 2.0
    corners = MARKS.get(marker["symbol"])
    if corners is None:
        return f"<circle cx='{x:.2f}' cy='{y:.2f}' r='{radius:g}' fill='{marker['color']}'/>"
    path = "L".join(f"{x + dx * radius:.2f} {y + dy * radius:.2f}" for dx, dy in corners)
    return f"<path d='M{path}Z' fill='{marker['color']}'/>"


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", weight: str = "", turned: bool = False
) -> str:
    more = f" font-weight='{weight}'" if weight else ""
    if turned:
        more += f" transform='rotate(-90 {x:.2f} {y:.2f})'"
        anchor = "middle"
    said = escape(text.replace("-", "−") if text[:1] == "-" else text)
    return f"<text x='{x:.2f}' y='{y:.2f}' fill='{INK}' text-anchor='{anchor}'{more}>{said}</text>"


def _ends(values: Iterable[float]) -> tuple[float, float]:
    """Lowest and highest, with a little room; of one value, or none, room about it."""
    known = [value for value in values if value is not None]
    low, high = min(known, default=0.0), max(known, default=0.0)
    room = 0.06 * (high - low) or max(abs(high), 1.0) * 0.05
    return low - room, high + room


def _ticks(low: float, high: float, *, most: int) -> Iterator[tuple[float, str]]:
    """Round numbers between two ends, at most so many."""
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        yield k * step, f"{k * step:.{decimals}f}" if k else "0"


def _at(value: float, ends: tuple[float, float], begin: float, end: float) -> float:
    return begin + (value - ends[0]) / (ends[1] - ends[0]) * (end - begin)


GAP = 0.35
"""Between bands, as a share of a band: room for the title of the one below."""


def residual_steps(
    elevation_deg: Sequence[float],
    approach: Sequence[int],
    steps: Sequence[tuple[str, Sequence[float]]],
) -> Figure:
    """Return what is left against elevation, marked by approach; each band has its own scale.

    Args:
        elevation_deg: (n,) of the poses.
        approach: (n,) +1, −1; 0 where it is not known.
        steps: title, and (n,) degrees that are left after it; the first one is drawn on top.
    """
    layout = layout_of("elevation (°)", "")
    del layout["yaxis"]
    layout["legend"]["title"] = {"text": "approach"}
    layout["annotations"] = []
    data = []
    band = 1.0 / (len(steps) + GAP * (len(steps) - 1))
    for k, (title, left_deg) in enumerate(steps):
        axis = "y" if k == 0 else f"y{k + 1}"
        high = 1.0 - k * (1.0 + GAP) * band
        low = high - band
        layout[f"yaxis{'' if k == 0 else k + 1}"] = {
            **axis_of("residual (°)"),
            "domain": [max(low, 0.0), high],
        }
        layout["annotations"].append(
            {"text": as_text(title), "xref": "paper", "yref": "paper", "x": 0.0, "y": high}
            | {"xanchor": "left", "yanchor": "bottom", "showarrow": False}
        )
        for sense, (name, symbol, colour) in APPROACHES.items():
            chosen = [i for i, one in enumerate(approach) if one == sense]
            if chosen:
                x, y = [elevation_deg[i] for i in chosen], [left_deg[i] for i in chosen]
                marker = {"color": colour, "symbol": symbol, "size": 5}
                more = {"yaxis": axis, "showlegend": k == 0, "hoverinfo": "skip"}
                data.append(points_of(name, x, y, marker, **more))
    layout["xaxis"]["anchor"] = "y" if len(steps) == 1 else f"y{len(steps)}"
    layout["margin"]["t"] = 40
    return {"data": data, "layout": layout}
