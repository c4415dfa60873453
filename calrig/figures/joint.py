"""Pictures of a joint solution: the stage's map, and what the poses leave without it and with it."""

from __future__ import annotations

from typing import Any

import numpy as np

from calrig.calibration.joint.held_out import believing_the_stage
from calrig.calibration.joint.least_squares import Fit
from calrig.calibration.joint.mapped import mapped
from calrig.calibration.joint.solution import Solution
from calrig.calibration.joint.stage_map import basis
from calrig.estimation.angles import FloatArray
from calrig.figures.files import Rows
from calrig.figures.parts import GREY, PALETTE, Figure, as_text, band_of, colours_of, layout_of, line_of

DIAL = "dial of the stage (°)"


def joint_figures(solution: Solution) -> Rows:
    """The map with its poses; below it what is left believing the stage, and with its map, on one scale."""
    fit = solution.fit
    before, after = np.degrees(believing_the_stage(fit).left()), np.degrees(fit.left())
    most = 1.05 * float(np.abs(before[fit.kept]).max())
    return [
        [("Map of the stage, two standard errors to each side", _map(fit, after))],
        [
            ("Left of the angle, believing the stage", _left(fit, before, most)),
            ("Left with its map", _left(fit, after, most)),
        ],
    ]


def _map(fit: Fit, left_deg: FloatArray) -> Figure:
    """The map as a band, and each pose as the map with what it leaves."""
    found, orders = mapped(fit), fit.problem.orders
    at, waves = found.stage_deg.tolist(), found.coefficients[:-1]
    level = (basis(found.stage_deg, np.zeros(len(at)), orders)[:, :-1] @ waves).mean()
    points = _points(fit, fit.problem.columns[:, :-1] @ waves - level + left_deg)
    low, high = (found.error_deg + side * found.std_deg for side in (-2.0, 2.0))
    band = band_of("map", at, low.tolist(), high.tolist(), PALETTE[-1])
    curve = {**line_of("map", at, found.error_deg.tolist(), PALETTE[-1]), "legendgroup": "map"}
    return {"data": [*points, band, curve], "layout": layout_of(DIAL, "error of the stage (°)")}


def _left(fit: Fit, left_deg: FloatArray, most: float) -> Figure:
    layout = layout_of(DIAL, "angle measured less expected (°)")
    layout["yaxis"]["range"] = [-most, most]
    return {"data": _points(fit, left_deg), "layout": layout}


def _points(fit: Fit, values_deg: FloatArray) -> list[dict[str, Any]]:
    """The poses of each mount that were not left out."""
    table = fit.problem.table
    names = [f"{table.units[mount.unit]}, {mount.name}" for mount in table.mounts]
    colours = colours_of(names)
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "name": as_text(name),
            "x": table.dial_deg[own].tolist(),
            "y": values_deg[own].tolist(),
            "marker": {"color": colours.get(name, GREY), "size": 5},
        }
        for name, own in ((name, (table.mount == k) & fit.kept) for k, name in enumerate(names))
    ]
