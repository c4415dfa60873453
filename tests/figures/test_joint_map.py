"""The picture of a stage's map has gaps where the map is null."""

from __future__ import annotations

from calrig.figures.joint import joint_figure


def test_the_map_breaks_where_it_is_null():
    error_deg = [None, 0.1, 0.2, None, 0.3, None, 0.5, 0.6]
    found = {
        "stage_deg": list(range(8)),
        "error_deg": error_deg,
        "std_deg": [None if value is None else 0.01 for value in error_deg],
    }
    poses = {"mount": [], "dial_deg": [], "on_map_deg": []}
    traces = joint_figure("map", {"stage": {"map": found}, "mounts": []}, poses)["data"]
    curves = [trace for trace in traces if "fill" not in trace]
    bands = [trace for trace in traces if "fill" in trace]
    assert [(curve["x"], curve["y"]) for curve in curves] == [
        ([1, 2], [0.1, 0.2]),
        ([4], [0.3]),
        ([6, 7], [0.5, 0.6]),
    ]
    assert [curve["mode"] for curve in curves] == ["lines", "markers", "lines"]
    assert [sorted(set(band["x"])) for band in bands] == [[1, 2], [4], [6, 7]]
    assert sum(trace["showlegend"] for trace in traces) == 1
