"""Pictures of several units, made from the store."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from calrig import figures
from calrig.analysis.comparison import compared_runs
from calrig.analysis.histories import histories
from calrig.analysis.stored_runs import counted_poses
from calrig.store import Store

ComparedFigure = Literal["bias", "scale", "rms", "residuals"]


def compared_figure(
    name: ComparedFigure, serials: Sequence[str] | None, chosen: Sequence[str] | None, store: Store
) -> figures.Figure:
    """Return a picture of units.

    `serials` are in the order wanted, None for all; units that are not dimmed are `chosen`, without any those
    that changed.

    Raises:
        Unknown: there is no such unit.
    """
    found = histories(store, serials)
    units = compared_runs(store, serials, found)
    coloured = chosen or found.changed_units()
    if name != "residuals":
        return figures.compare(name, units, coloured)
    latest = {serial: runs[-1] for serial, runs in units.items() if runs}
    curves = [
        figures.Curve(serial, counted_poses(store, run["run_id"]), run["bias_deg"], run["scale"])
        for serial, run in latest.items()
    ]
    return figures.residuals_overlaid(curves, coloured)
