"""A picture of what is left of each pose, one band a step: as it came, calibrated, effect after effect."""

from __future__ import annotations

from collections.abc import Sequence

from calrig.figures.parts import APPROACHES, Figure, as_text, axis_of, layout_of

GAP = 0.35
"""Between bands, as a share of a band: room for the title of the one below."""


def residual_steps(
    elevation_deg: Sequence[float],
    approach: Sequence[int],
    steps: Sequence[tuple[str, Sequence[float]]],
) -> Figure:
    """What is left against elevation, marked by approach; each band has its own scale.

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
                data.append(
                    {
                        "type": "scatter",
                        "mode": "markers",
                        "name": name,
                        "showlegend": k == 0,
                        "x": [elevation_deg[i] for i in chosen],
                        "y": [left_deg[i] for i in chosen],
                        "yaxis": axis,
                        "marker": {"color": colour, "symbol": symbol, "size": 5},
                        "hoverinfo": "skip",
                    }
                )
    layout["xaxis"]["anchor"] = "y" if len(steps) == 1 else f"y{len(steps)}"
    layout["margin"]["t"] = 40
    return {"data": data, "layout": layout}
