"""What all figures are made of: colours, lines, error bars, axes."""

from collections.abc import Collection, Sequence
from html import escape
from typing import Any

Figure = dict[str, Any]

PALETTE = ("#3b82c4", "#d0741f", "#1f9a7a", "#9063cd", "#d1495b", "#8a7d2c", "#3a93a5", "#b0589a")
GREY = "#7d8590"
GRID = "rgba(125,133,144,0.25)"
APPROACHES = {
    1: ("upward", "triangle-up", PALETTE[0]),
    -1: ("downward", "triangle-down", PALETTE[1]),
    0: ("not known", "circle", PALETTE[2]),
}
"""Name, marker and colour of each sense of the move into a pose."""


def line_of(name: str, x: list[Any], y: list[Any], colour: str, hover: str | None = None) -> dict[str, Any]:
    """Return a line through points, with what hovering over it says."""
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "name": as_text(name),
        "x": x,
        "y": y,
        "line": {"color": colour, "width": 2},
    }
    return {**trace, "hovertemplate": hover} if hover else trace


def points_of(name: str, x: list[Any], y: list[Any], marker: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return points alone, by their marker."""
    look = {"type": "scatter", "mode": "markers", "name": as_text(name), "marker": marker}
    return {**look, "x": x, "y": y, **more}


def band_of(
    name: str, x: Sequence[float], low: Sequence[float], high: Sequence[float], colour: str
) -> dict[str, Any]:
    """What lies between two limits as one closed outline, shown and hidden with the line of its name."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": as_text(name),
        "legendgroup": name,
        "showlegend": False,
        "x": [*x, *x[::-1]],
        "y": [*high, *low[::-1]],
        "fill": "toself",
        "fillcolor": colour,
        "opacity": 0.25,
        "line": {"width": 0},
        "hoverinfo": "skip",
    }


def error_bars(std: Sequence[float | None], colour: str) -> dict[str, Any]:
    """Return standard errors about points; none where one is not known."""
    return {"type": "data", "array": list(std), "color": colour, "thickness": 1.2, "width": 3}


def as_text(name: str) -> str:
    """Return a name as plain text: plotly reads a few HTML tags and entities in the names of traces."""
    return escape(name, quote=False)


def colour_of(k: int) -> str:
    """Return the k-th colour; they begin again with the first."""
    return PALETTE[k % len(PALETTE)]


def colours_of(names: Sequence[str], chosen: Collection[str] = ()) -> dict[str, str]:
    """A colour for each name; where there are more names than colours, grey for all but the chosen ones.

    No two names ever share a colour but grey. Without a choice the first ones are it.
    """
    if len(names) <= len(PALETTE):
        return dict(zip(names, PALETTE, strict=False))
    coloured = [name for name in names if name in chosen] or list(names)
    given = dict(zip(coloured, PALETTE, strict=False))
    return {name: given.get(name, GREY) for name in names}


def dimmed(trace: dict[str, Any]) -> dict[str, Any]:
    """Return a line without a colour of its own, behind the others: thin, without errors or a legend."""
    kept = {key: value for key, value in trace.items() if key != "error_y"}
    look = {"line": {"color": GREY, "width": 1}, "marker": {"color": GREY, "size": 4}}
    return {**kept, **look, "mode": "lines+markers", "opacity": 0.4, "showlegend": False}


def axis_of(title: str) -> dict[str, Any]:
    """Return an axis with its title."""
    return {
        "title": {"text": title, "standoff": 8},
        "automargin": True,
        "gridcolor": GRID,
        "linecolor": GRID,
        "zerolinecolor": GREY,
        "zerolinewidth": 1,
        "zeroline": False,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": GRID,
    }


def layout_of(x_title: str, y_title: str, *, zeroline: bool = False) -> dict[str, Any]:
    """Return the look of a figure with one pair of axes; `zeroline` is of the y axis."""
    return {
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": GREY},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 56, "r": 12, "t": 8, "b": 44},
        "hovermode": "closest",
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "uirevision": "kept",  # a zoom outlives the next update
        "xaxis": axis_of(x_title),
        "yaxis": {**axis_of(y_title), "zeroline": zeroline},
    }
