"""Pictures over time: one unit's history, units beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, Literal

from calrig.figures.parts import PALETTE, Figure, axis_of, colour_of, error_bars, layout_of, line_of

Run = Mapping[str, Any]
"""A run as CONTRACT section 2's comparison lists it: `run_id, finished_at, bias_deg, bias_std_deg, …`."""

_DATES = {"type": "date", "nticks": 4, "tickangle": 0}  # few and level: they must fit a phone too
_QUANTITIES = {
    "bias": ("bias_deg", "bias_std_deg", "bias (°)"),
    "scale": ("scale", "scale_std", "scale (1)"),
    "rms": ("rms_calibrated_deg", None, "calibrated RMS (°)"),
}


def history(runs: Sequence[Run]) -> Figure:
    """Bias, scale and RMS of one unit's runs over time, one above the other, with standard errors."""
    done = _finished(runs)
    layout = layout_of("finished (UTC)", "")
    layout["xaxis"].update(_DATES, anchor="y3")
    layout["yaxis"] = {**axis_of("bias (°)"), "domain": [0.72, 1.0]}
    layout["yaxis2"] = {**axis_of("scale (1)"), "domain": [0.36, 0.64]}
    layout["yaxis3"] = {**axis_of("RMS (°)"), "domain": [0.0, 0.28]}
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
    layout = layout_of("finished (UTC)", title)
    layout["xaxis"].update(_DATES)
    data = [
        _over_time(serial, _finished(runs), key, std_key, colour_of(k))
        for k, (serial, runs) in enumerate(units.items())
    ]
    return {"data": data, "layout": layout}


def _finished(runs: Sequence[Run]) -> list[Run]:
    return sorted((r for r in runs if r["finished_at"] is not None), key=lambda r: _iso(r["finished_at"]))


def _over_time(name: str, runs: Sequence[Run], key: str, std_key: str | None, colour: str) -> dict[str, Any]:
    trace = line_of(name, [_iso(r["finished_at"]) for r in runs], [r[key] for r in runs], colour)
    trace["mode"] = "lines+markers"
    trace["marker"] = {"color": colour, "size": 7}
    trace["customdata"] = [str(r["run_id"]) for r in runs]
    trace["hovertemplate"] = "run %{customdata}: %{y:.5f}"
    if std_key:
        trace["error_y"] = error_bars([r[std_key] for r in runs], colour)
    return trace


def _iso(moment: datetime | str) -> str:
    return moment if isinstance(moment, str) else moment.isoformat()
