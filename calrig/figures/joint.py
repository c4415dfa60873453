"""Pictures of a joint solution: the stage's map, and what the poses leave without it and with it."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from calrig.figures.files import Rows
from calrig.figures.parts import GREY, PALETTE, Figure, band_of, colours_of, layout_of, line_of, points_of
from calrig.figures.runs import MAX_POINTS

DIAL = "dial of the stage (°)"
CAPTIONS = {
    "map": "Map of the stage, two standard errors to each side",
    "before": "Residual angle without the map",
    "after": "Residual angle with the map",
}
"""What each picture shows, by its name."""
ROWS = (("map",), ("before", "after"))
"""How they lie on one sheet: the last two have one scale."""


def joint_figures(document: Mapping[str, Any], poses: Mapping[str, Sequence[Any]]) -> Rows:
    """All of them on one sheet; arguments as of `joint_figure`."""
    return [[(CAPTIONS[name], joint_figure(name, document, poses)) for name in row] for row in ROWS]


def joint_figure(name: str, document: Mapping[str, Any], poses: Mapping[str, Sequence[Any]]) -> Figure:
    """One of `CAPTIONS`.

    `document` is of CONTRACT section 8; `poses` are columns as `calrig.calibration.separation.report` gives
    them.
    """
    if name == "map":
        return _map(document, poses)
    most = 1.05 * max(map(abs, poses["before_deg"]), default=1.0)
    layout = layout_of(DIAL, "angle measured less expected (°)")
    layout["yaxis"]["range"] = [-most, most]
    values = poses["before_deg" if name == "before" else "left_deg"]
    return {"data": _points(document, poses, values), "layout": layout}


def _map(document: Mapping[str, Any], poses: Mapping[str, Sequence[Any]]) -> Figure:
    """Return the map as a band, and each pose as the map with what it leaves."""
    at, error, std = (document["stage"]["map"][name] for name in ("stage_deg", "error_deg", "std_deg"))
    points = _points(document, poses, poses["on_map_deg"])
    pieces: list[dict[str, Any]] = []
    for is_known, rows in groupby(zip(at, error, std, strict=True), key=lambda row: row[1] is not None):
        if is_known:
            pieces += _piece(list(rows), is_first=not pieces)
    return {"data": [*points, *pieces], "layout": layout_of(DIAL, "error of the stage (°)")}


def _piece(rows: list[tuple[float, float, float]], *, is_first: bool) -> list[dict[str, Any]]:
    """Return the band and the line of dial angles between two gaps of the map; the first has the legend."""
    at, error, std = ([row[k] for row in rows] for k in range(3))
    low, high = ([e + side * s for e, s in zip(error, std, strict=True)] for side in (-2.0, 2.0))
    curve = line_of("map", at, error, PALETTE[-1])
    if len(rows) == 1:
        curve["mode"] = "markers"  # a line of one point is not drawn
    return [
        band_of("map", at, low, high, PALETTE[-1]),
        {**curve, "legendgroup": "map", "showlegend": is_first},
    ]


def _points(
    document: Mapping[str, Any], poses: Mapping[str, Sequence[Any]], values_deg: Sequence[float]
) -> list[dict[str, Any]]:
    """Return the poses of each mount, at most `MAX_POINTS` of all; where mounts are many, some are named."""
    stride = max(1, -(-len(values_deg) // MAX_POINTS))
    names = [f"{mount['unit']}, {mount['mount']}" for mount in document["mounts"]]
    colours = colours_of(names)
    of_mount: list[tuple[list[float], list[float]]] = [([], []) for _ in names]
    columns = (poses["mount"], poses["dial_deg"], values_deg)
    for mount, dial_deg, value_deg in zip(*(column[::stride] for column in columns), strict=True):
        of_mount[mount][0].append(dial_deg)
        of_mount[mount][1].append(value_deg)
    return [
        points_of(name, x, y, {"color": colours[name], "size": 5}, showlegend=colours[name] != GREY)
        for name, (x, y) in zip(names, of_mount, strict=True)
    ]
