"""Figures: what is drawn is what was measured, in plotly's own terms."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from itertools import product

import numpy as np
import plotly.graph_objects as go
import pytest

from calrig import figures
from calrig.calibration.diagnosis.report import PartialResidual
from calrig.calibration.poses import Pose
from calrig.calibration.results.pose_errors import residuals


def poses(bias_deg=0.8, scale=1.01, sweeps=2):
    """Readings that are exactly bias + scale·θ on a stage that stands beside its targets."""
    return [
        Pose(
            target_deg=target,
            stage_deg=target + 0.02,
            reading_deg=bias_deg + scale * (target + 0.02),
            reading_stderr_deg=0.01,
            sweep=sweep,
            approach=1 if sweep % 2 == 0 else -1,
        )
        for sweep in range(sweeps)
        for target in (-40.0, 0.0, 40.0)
    ]


def runs(n=3, **changes):
    """Runs of one unit, a day apart, the newest first, as the comparison has them."""
    first = datetime(2025, 3, 1, tzinfo=UTC)
    made = [
        {
            "run_id": str(k),
            "finished_at": first + timedelta(days=k),
            "bias_deg": 0.8 + 0.01 * k,
            "bias_std_deg": 0.004,
            "scale": 1.002,
            "scale_std": 0.0003,
            "rms_raw_deg": 0.9,
            "rms_calibrated_deg": 0.05,
            **changes,
        }
        for k in range(n)
    ]
    return made[::-1]


def diagnosis(before=0.07, after=0.016, floor=0.012, confirmed_by=None):
    """What a figure needs of a diagnosis."""
    return {
        "base": {"held_out_rms_deg": before},
        "final": {"held_out_rms_deg": after},
        "noise": {"floor_deg": floor},
        "confirmed_by": confirmed_by,
    }


def effect(covariate="temperature_c", at=(3.0, 1.0, 2.0), effect_deg=(0.3, 0.1, 0.2), off_deg=0.01):
    """An effect whose poses lie beside the fitted curve by off_deg."""
    fitted = np.array(effect_deg)
    return PartialResidual(covariate, np.array(at), np.linspace(-60, 60, len(at)), fitted + off_deg, fitted)


ALL = {
    "timeline": figures.timeline([0.0, 0.1], [0.0, None], [0.1, 0.2]),
    "residual": figures.residual(poses(), left_deg=residuals(poses(), 0.8, 1.01), excluded={1}),
    "history": figures.history(runs()),
    "bias": figures.compare("bias", {"A": runs(), "B": []}),
    "scale": figures.compare("scale", {"A": runs(scale=None, scale_std=None)}),
    "rms": figures.compare("rms", {"A": runs()}),
    "residuals": figures.residuals_overlaid([figures.Curve("A", poses(), 0.8, 1.01)]),
    "before and after": figures.before_and_after(diagnosis()),
    "nothing is known": figures.before_and_after(diagnosis(None, None, None)),
    "partial residual against temperature": figures.partial_residual(effect()),
    "partial residual against the approach": figures.partial_residual(
        effect("approach", [1, -1, 1], [0.1, -0.1, 0.1])
    ),
    "error map": figures.error_map([-40, 40, 40], [1, 1, -1], [0.01, 0.02, 0.03], [0.001, 0.002, 0.003]),
    "no error map": figures.error_map([], [], [], []),
}


@pytest.mark.parametrize("name", ALL)
def test_plotly_itself_takes_every_property_of_a_figure_and_no_number_is_nan(name):
    go.Figure(ALL[name])  # raises on any property that plotly does not know
    json.dumps(ALL[name], allow_nan=False)


def test_raw_residual_is_reading_minus_stage_and_a_true_calibration_leaves_nothing():
    measured = poses(bias_deg=0.8, scale=1.01)
    figure = figures.residual(measured, left_deg=residuals(measured, 0.8, 1.01), scale=1.01)
    raw = [t for t in figure["data"] if t.get("yaxis") is None]
    calibrated = [t for t in figure["data"] if t.get("yaxis") == "y2"]
    for trace in raw:
        np.testing.assert_allclose(trace["y"], 0.8 + 0.01 * np.array(trace["x"]), atol=1e-12)
    for trace in calibrated:
        np.testing.assert_allclose(trace["y"], 0, atol=1e-12)
        np.testing.assert_allclose(trace["error_y"]["array"], 0.01 / 1.01)


def test_each_axis_of_a_residual_is_named_after_what_is_drawn_along_it():
    measured = poses(bias_deg=0.8, scale=1.01)
    stage = np.array([pose.stage_deg for pose in measured])
    reading = np.array([pose.reading_deg for pose in measured])
    along = {
        "elevation (°)": stage,
        "raw (°)": reading - stage,
        "calibrated (°)": (reading - 0.7) / 1.02 - stage,
    }
    figure = figures.residual(measured, left_deg=residuals(measured, 0.7, 1.02), scale=1.02)
    for trace in figure["data"]:
        for axis in ("x", "y"):
            title = figure["layout"][trace.get(f"{axis}axis", axis).replace(axis, f"{axis}axis")]["title"][
                "text"
            ]
            np.testing.assert_allclose(trace[axis], along[title][trace["customdata"]], atol=1e-12)
    lower, upper = figure["layout"]["yaxis2"], figure["layout"]["yaxis"]
    assert lower["domain"][1] < upper["domain"][0]
    titles = [figures.residual(measured)["layout"][axis]["title"]["text"] for axis in ("xaxis", "yaxis")]
    assert titles == ["elevation (°)", "reading − stage (°)"]


def test_each_axis_of_a_history_is_named_after_what_is_drawn_along_it():
    figure = figures.history(runs(3))
    keys = {
        "bias (°)": ["bias_deg"],
        "scale (1)": ["scale"],
        "RMS (°)": ["rms_raw_deg", "rms_calibrated_deg"],
    }
    for trace in figure["data"]:
        title = figure["layout"][trace.get("yaxis", "y").replace("y", "yaxis")]["title"]["text"]
        key = keys[title].pop(0)
        assert trace["y"] == [run[key] for run in runs(3)[::-1]]
    assert [trace["name"] for trace in figure["data"][2:]] == ["RMS raw", "RMS calibrated"]


def test_poses_are_marked_by_approach_and_excluded_ones_as_such():
    figure = figures.residual(poses(), excluded={4})
    assert {t["name"]: t["customdata"] for t in figure["data"]} == {
        "upward": [0, 1, 2],
        "downward": [3, 5],
        "excluded": [4],
    }


def test_before_there_is_a_calibration_only_the_raw_residual_is_drawn():
    figure = figures.residual(poses())
    assert "yaxis2" not in figure["layout"]
    assert all("yaxis" not in trace for trace in figure["data"])


def test_where_the_stage_said_nothing_the_target_stands_in():
    figure = figures.residual([Pose(target_deg=10.0, reading_deg=10.5)])
    assert (figure["data"][0]["x"], figure["data"][0]["y"]) == ([10.0], [0.5])


def test_a_long_timeline_is_thinned_uniformly_from_its_first_point():
    time_s = np.arange(50_000) / 20
    figure = figures.timeline(time_s.tolist(), time_s.tolist(), time_s.tolist())
    for line in figure["data"]:
        assert figures.MAX_POINTS / 2 < len(line["x"]) <= figures.MAX_POINTS
        assert line["x"][0] == 0
        assert len(set(np.diff(line["x"]).round(9))) == 1


def test_runs_are_drawn_in_the_order_they_finished_and_unfinished_ones_are_not():
    unfinished = {**runs(1)[0], "finished_at": None}
    bias = figures.history([unfinished, *runs(3)])["data"][0]
    assert bias["customdata"] == ["0", "1", "2"]
    assert bias["y"] == pytest.approx([0.8, 0.81, 0.82])
    assert bias["error_y"]["array"] == [0.004] * 3


def test_an_overlaid_curve_runs_through_the_mean_residual_at_each_elevation():
    measured = [
        Pose(target_deg=target, reading_deg=target + off) for target in (20.0, -20.0) for off in (0.1, 0.3)
    ]
    points, line = figures.residuals_overlaid([figures.Curve("A", measured, 0.0, None)])["data"]
    assert len(points["x"]) == 4
    assert line["x"] == [-20.0, 20.0]
    np.testing.assert_allclose(line["y"], 0.2)


def test_before_and_after_stand_beside_the_noise_floor_and_what_is_not_known_is_left_out():
    (bars,) = figures.before_and_after(diagnosis(0.07, 0.016, 0.012))["data"]
    assert dict(zip(bars["y"], bars["x"], strict=True)) == {
        "before": 0.07,
        "after": 0.016,
        "noise floor": 0.012,
    }
    fresh = {"run_id": "2", "before_rms_deg": 0.08, "after_rms_deg": 0.02}
    (bars,) = figures.before_and_after(diagnosis(floor=None, confirmed_by=fresh))["data"]
    assert bars["y"] == ["before", "after", "fresh run, before", "fresh run, after"]


def test_the_fitted_effect_is_drawn_through_the_poses_in_the_order_of_its_covariate():
    at = np.array([3.0, 1.0, 5.0, 2.0, 4.0])
    points, curve = figures.partial_residual(effect(at=at, effect_deg=0.1 * at, off_deg=0.01))["data"]
    assert (curve["mode"], curve["x"]) == ("lines", [1.0, 2.0, 3.0, 4.0, 5.0])
    np.testing.assert_allclose(curve["y"], [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(points["y"], 0.1 * at + 0.01)


def test_an_effect_that_depends_on_more_than_its_covariate_is_drawn_as_points():
    zigzag = effect(at=np.arange(20.0), effect_deg=np.tile([0.1, -0.1], 10))
    assert figures.partial_residual(zigzag)["data"][1]["mode"] == "markers"
    # smooth from pose to pose, and yet no function of temperature alone
    warming = np.linspace(20.0, 30.0, 52)
    with_elevation = effect(at=warming, effect_deg=np.sin(warming * 3.0))
    assert figures.partial_residual(with_elevation)["data"][1]["mode"] == "markers"


def test_backlash_is_a_level_for_each_approach_with_gaps_between_them():
    approach = np.array([0.0, *np.tile([1.0, -1.0], 6)])
    _, levels = figures.partial_residual(effect("approach", approach, 0.1 * approach))["data"]
    assert levels["y"] == [-0.1, -0.1, None, 0.0, 0.0, None, 0.1, 0.1]
    assert max(levels["x"][:2]) < min(levels["x"][6:])


def test_a_covariate_calrig_has_never_heard_of_is_text_to_plotly():
    layout = figures.partial_residual(effect("<b>supply_v</b>"))["layout"]
    assert layout["xaxis"]["title"]["text"] == "&lt;b&gt;supply_v&lt;/b&gt;"


def test_an_error_map_has_a_line_for_each_approach_with_standard_errors():
    upward, downward = figures.error_map([-40, 40, 40], [1, 1, -1], [0.01, 0.02, 0.03], [0.1, 0.2, 0.3])[
        "data"
    ]
    assert (upward["x"], upward["y"], upward["error_y"]["array"]) == ([-40, 40], [0.01, 0.02], [0.1, 0.2])
    assert (downward["x"], downward["y"]) == ([40], [0.03])


def test_a_serial_number_is_text_to_plotly_and_never_markup():
    figure = figures.compare("bias", {'<a href="x">&amp;</a>': runs()})
    assert figure["data"][0]["name"] == '&lt;a href="x"&gt;&amp;amp;&lt;/a&gt;'


@pytest.mark.parametrize(("chosen", "coloured"), [((), 8), (("unit 11", "unit 3"), 2)])
def test_no_two_units_share_a_colour_but_the_grey_of_those_not_chosen(chosen, coloured):
    many = {f"unit {k}": runs() for k in range(12)}
    curves = [figures.Curve(name, poses(), 0.8, 1.01) for name in many]
    for figure in (figures.compare("bias", many, chosen), figures.residuals_overlaid(curves, chosen)):
        colours = {}
        for trace in figure["data"]:
            colours.setdefault(trace["name"], set()).add(trace.get("line", trace.get("marker"))["color"])
        own = {name: colour for name, (colour,) in colours.items() if colour in figures.PALETTE}
        assert len(colours) == 12
        assert len(own) == len(set(own.values())) == coloured
        assert own.keys() >= set(chosen)
        last = [trace["name"] for trace in figure["data"]][-1]
        assert last in own, "what has a colour is drawn over what has none"


def test_a_control_chart_has_no_limit_where_there_is_none():
    when = [datetime(2025, 1, day, tzinfo=UTC) for day in (1, 2, 3)]
    figure = figures.control_chart(when, {"bias": [0.0, 0.5, 2.0]}, [float("inf"), 0.8, 1.0])
    go.Figure(figure)
    upper, lower, bias = figure["data"]
    assert (upper["y"], lower["y"], bias["y"]) == ([None, 0.8, 1.0], [None, -0.8, -1.0], [0.0, 0.5, 2.0])


def test_every_colour_stands_out_on_light_and_on_dark():
    """WCAG 2.1, 1.4.11: at least 3:1 for what carries meaning in a graphic."""

    def luminance(hex_colour):
        channels = np.array([int(hex_colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    for colour, background in product(figures.PALETTE, ("#ffffff", "#171c21")):
        light, dark = sorted((luminance(colour), luminance(background)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 3, (colour, background)


def test_the_timeline_of_a_board_counts_its_clock_and_of_a_faster_rig_the_time_on_the_wall():
    readings = [0.0, 135.0, 270.0], [0.0, 1.0, 2.0], [0.0, 1.0, 2.0]
    board, simulated = figures.timeline(*readings), figures.timeline(*readings, time_scale=6.0)
    assert board["data"][0]["x"] == [0.0, 135.0, 270.0]
    assert board["layout"]["xaxis"]["title"]["text"] == "time (s)"
    assert simulated["data"][0]["x"] == simulated["data"][1]["x"] == [0.0, 22.5, 45.0]
    assert simulated["layout"]["xaxis"]["title"]["text"] == "time (s), simulated clocks 6× faster"


def test_a_control_chart_shows_the_limit_of_its_second_run_and_no_band_without_one():
    when = [datetime(2026, 1, day, tzinfo=UTC) for day in (1, 2)]
    averages = {"bias": [0.0, 0.4]}
    first, second, bias = figures.control_chart(when, averages, [math.inf, 0.8])["data"]
    assert (first["y"], second["y"]) == ([None, 0.8], [None, -0.8])
    assert first["mode"] == "lines+markers"  # a line alone shows no single point
    assert figures.control_chart(when[:1], {"bias": [0.0]}, [math.inf])["data"][0]["name"] == bias["name"]


def test_a_timeline_has_the_stage_and_the_reading_each_under_its_own_name():
    drawn = figures.timeline([0.0, 1.0], [10.0, 20.0], [10.8, 20.9])["data"]
    assert {line["name"]: line["y"] for line in drawn} == {"stage": [10.0, 20.0], "reading": [10.8, 20.9]}
