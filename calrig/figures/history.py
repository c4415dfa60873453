"""Pictures over time: one unit's history, units beside each other."""

import math
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from typing import Any, Literal

from calrig.figures.parts import (
    GREY,
    PALETTE,
    Figure,
    axis_of,
    colours_of,
    dimmed,
    error_bars,
    layout_of,
    line_of,
)
from calrig.run_ids import short_name

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


def compare(
    quantity: Literal["bias", "scale", "rms"],
    units: Mapping[str, Sequence[Run]],
    chosen: Collection[str] = (),
) -> Figure:
    """Bias, scale or calibrated RMS over time, one line a unit, with standard errors where there are any.

    `units` are each unit's runs by its serial, `chosen` those with a colour of their own where not all can
    have one.
    """
    key, std_key, title = _QUANTITIES[quantity]
    layout = layout_of("finished (UTC)", title)
    layout["xaxis"].update(_DATES)
    colours = colours_of(list(units), chosen)
    data = []
    for serial in sorted(units, key=lambda serial: colours[serial] != GREY):  # grey hides no colour
        trace = _over_time(serial, _finished(units[serial]), key, std_key, colours[serial])
        data.append(dimmed(trace) if colours[serial] == GREY else trace)
    return {"data": data, "layout": layout}


def control_chart(
    finished_at: Sequence[datetime], averages: Mapping[str, Sequence[float | None]], limit: Sequence[float]
) -> Figure:
    """Moving averages of a unit's or a rig's history between their limits, in standard deviations.

    Args:
        finished_at: (n,) when each run finished.
        averages: (n,) of each figure by its name; None where there is none.
        limit: (n,) of all of them, above and below 0; infinite where there is none.
    """
    layout = layout_of("finished (UTC)", "moving average (σ)")
    layout["xaxis"].update(_DATES)
    when = [_iso(at) for at in finished_at]
    bound = [one if math.isfinite(one) else None for one in limit]
    data = []
    for sign in (1, -1) if any(one is not None for one in bound) else ():
        edge = line_of("limit", when, [None if one is None else sign * one for one in bound], GREY)
        edge["line"] = {"color": GREY, "width": 1, "dash": "dash"}
        edge["mode"] = "lines+markers"  # the first limit is a single point, which no line shows
        edge["marker"] = {"symbol": "line-ew", "size": 22, "line": {"color": GREY, "width": 1.5}}
        data.append({**edge, "hoverinfo": "skip", "showlegend": sign == 1})
    for k, (name, average) in enumerate(averages.items()):
        trace = line_of(name, when, list(average), PALETTE[3 * k % len(PALETTE)], "%{y:.2f} σ")
        trace["mode"] = "lines+markers"
        data.append(trace)
    return {"data": data, "layout": layout}


def _finished(runs: Sequence[Run]) -> list[Run]:
    return sorted((r for r in runs if r["finished_at"] is not None), key=lambda r: _iso(r["finished_at"]))


def _over_time(name: str, runs: Sequence[Run], key: str, std_key: str | None, colour: str) -> dict[str, Any]:
    trace = line_of(name, [_iso(r["finished_at"]) for r in runs], [r[key] for r in runs], colour)
    trace["mode"] = "lines+markers"
    trace["marker"] = {"color": colour, "size": 7}
    trace["customdata"] = [short_name(r["run_id"]) for r in runs]
    trace["hovertemplate"] = "run %{customdata}: %{y:.5f}"
    if std_key:
        trace["error_y"] = error_bars([r[std_key] for r in runs], colour)
    return trace


def _iso(moment: datetime | str) -> str:
    return moment if isinstance(moment, str) else moment.isoformat()
