"""Pictures of filters side by side, on a move and at rest (Nirmal et al. 2016, figures 5, 7 and 8)."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calrig.estimation.filter_comparison import FilterComparison
from calrig.estimation.transient_response import MoveReference
from calrig.figures.parts import GREY, Figure, colour_of, layout_of, line_of
from calrig.noise.filters import FilterStudy

RAW = "raw"
SMOOTHERS = ("moving_average", "savitzky_golay_1", "savitzky_golay_2", "savitzky_golay_4", "savitzky_golay_6")
KALMAN = ("kalman_paper", "kalman_tuned")
BEFORE_S = 0.25
"""Of rest, drawn before a move."""
REST_S = 5.0
"""Of rest, drawn of the longest."""


def filters_figures(study: FilterStudy) -> list[list[tuple[str, Figure]]]:
    """The figures of a comparison with their captions, in rows; without a move only that of the rest."""
    comparison = study.comparison
    rows = [[("At rest", at_rest(comparison))]]
    if comparison.moves:
        moves = [
            ("Smoothing filters during a move", on_a_move(comparison, SMOOTHERS)),
            ("Kalman filters during a move", on_a_move(comparison, KALMAN)),
        ]
        rows.insert(0, moves)
    return rows


def on_a_move(comparison: FilterComparison, names: Sequence[str]) -> Figure:
    """The largest move: the accelerometer's elevation, the reference trajectory, and the filters over them.

    Without a move in `comparison` it is empty; `names` are filters that are drawn, where they were run.
    """
    layout = layout_of("time since start of move (s)", "elevation (°)")
    if not comparison.moves:
        return {"data": [], "layout": layout}
    move = max(comparison.moves, key=lambda one: float(np.ptp(one.angle_deg)))
    begin_s = float(comparison.time_s[move.judged.start])
    drawn = slice(int(np.searchsorted(comparison.time_s, begin_s - BEFORE_S)), move.judged.stop)
    end_s = float(comparison.time_s[drawn][-1])
    traces = _traces(comparison, names, drawn, begin_s)
    return {"data": [*traces, _true(move, begin_s, end_s)], "layout": layout}


def at_rest(comparison: FilterComparison) -> Figure:
    """The beginning of the longest rest, each filter minus its mean there, with its jitter by its name."""
    layout = layout_of("time (s)", "elevation − mean (°)")
    if not comparison.static:
        return {"data": [], "layout": layout}
    longest = max(comparison.static, key=lambda one: one.stop - one.start)
    begin_s = float(comparison.time_s[longest.start])
    end = min(int(np.searchsorted(comparison.time_s, begin_s + REST_S)), longest.stop)
    names = ("moving_average", *KALMAN)
    data = _traces(comparison, names, slice(longest.start, end), begin_s, about_mean=True)
    return {"data": data, "layout": layout}


def _traces(
    comparison: FilterComparison,
    names: Sequence[str],
    drawn: slice,
    begin_s: float,
    *,
    about_mean: bool = False,
) -> list[dict[str, Any]]:
    """Return a line a filter that was run, the accelerometer's own behind them."""
    rows = {row.name: row for row in comparison.rows}
    time_s = (comparison.time_s[drawn] - begin_s).tolist()
    traces = []
    for k, name in enumerate((RAW, *names)):
        if name not in comparison.filtered_deg:
            continue
        angle = comparison.filtered_deg[name][drawn]
        label = rows[name].label
        if about_mean:
            angle = angle - np.nanmean(angle)
            jitter = rows[name].jitter
            label += "" if jitter is None else f" ({jitter.std_deg:.3f}°)"
        colour = GREY if name == RAW else colour_of(k - 1)
        known = [value if np.isfinite(value) else None for value in angle.tolist()]
        trace = line_of(label, time_s, known, colour, "%{x:.3f} s: %{y:.3f}°")
        trace["line"]["width"] = 1 if name == RAW else 2
        trace["opacity"] = 0.6 if name == RAW else 1.0
        traces.append(trace)
    return traces


def _true(move: MoveReference, begin_s: float, end_s: float) -> dict[str, Any]:
    within = (move.time_s >= begin_s - BEFORE_S) & (move.time_s <= end_s)
    time_s, angle = move.time_s[within] - begin_s, move.angle_deg[within]
    trace = line_of("reference", time_s.tolist(), angle.tolist(), GREY, "%{x:.3f} s: %{y:.3f}°")
    trace["line"].update(dash="dash", width=2)
    return trace
