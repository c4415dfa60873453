"""Residuals step by step: plotly takes the figure, and on paper the same points are there."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import plotly.graph_objects as go
import pytest

from calrig.figures.svg import residual_steps, svg_of

SVG = "{http://www.w3.org/2000/svg}"
ELEVATION_DEG = [-60.0, 0.0, 60.0, 0.0]
APPROACH = [1, 1, -1, 0]
STEPS = [("As the <unit> reads", [1.0, 0.9, 0.8, 0.9]), ("With bias & scale", [0.01, -0.01, 0.0, 0.0])]


def texts(svg: str) -> list[str]:
    return [element.text or "" for element in ET.fromstring(svg).iter(f"{SVG}text")]


def test_plotly_takes_it_with_a_band_for_each_step():
    figure = residual_steps(ELEVATION_DEG, APPROACH, STEPS)
    drawn = go.Figure(figure)
    assert [trace.yaxis for trace in drawn.data] == ["y"] * 3 + ["y2"] * 3
    assert sum(len(trace.x) for trace in drawn.data) == 8
    assert drawn.layout.yaxis2.domain[0] == pytest.approx(0.0)


def test_on_paper_every_point_has_a_mark_and_every_step_its_title():
    svg = svg_of(residual_steps(ELEVATION_DEG, APPROACH, STEPS))
    root = ET.fromstring(svg)
    triangles = [one for one in root.iter(f"{SVG}path") if one.get("fill")]
    circles = list(root.iter(f"{SVG}circle"))
    assert (len(triangles), len(circles)) == (2 * 3 + 2, 2 * 1 + 1)  # and those of the legend
    assert {title for title, _ in STEPS} <= set(texts(svg))
    assert {"−60", "60", "0", "elevation (°)", "downward"} <= set(texts(svg))


def test_residuals_that_are_all_alike_still_have_a_scale():
    svg = svg_of(residual_steps([0.0, 0.0], [0, 0], [("flat", [0.0, 0.0])]))
    assert "nan" not in svg and len(texts(svg)) > 4


def test_a_figure_of_lines_is_refused():
    with pytest.raises(ValueError, match="only figures of points"):
        svg_of({"data": [{"mode": "lines", "x": [], "y": []}], "layout": {"yaxis": {}, "xaxis": {}}})
