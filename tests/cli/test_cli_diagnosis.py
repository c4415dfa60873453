"""`calrig diagnose` and `calrig gravity`: a document for programs, the verdict first for people."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
from command_line import calrig, reason
from support import serving

from calrig.cli.output import print_diagnosis
from calrig.model.diagnosis import Diagnosis


@pytest.fixture
def warming(folder):
    """Poses of a unit whose reading drifts with temperature, which comes and goes."""
    rng = np.random.default_rng(3)
    target_deg = rng.permutation(np.linspace(-60.0, 60.0, 24))
    temperature_c = 25.0 + 3.0 * np.sin(np.arange(24) / 3.0)
    reading_deg = 0.4 + target_deg + 0.05 * (temperature_c - 25.0) + rng.normal(0.0, 0.01, 24)
    rows = (
        ",".join(f"{value:.5f}" for value in row)
        for row in zip(target_deg, reading_deg, temperature_c, strict=True)
    )
    (folder / "warming.csv").write_text("\n".join(["target_deg,reading_deg,temperature_c", *rows]))
    return "warming.csv"


def test_a_file_is_diagnosed_and_a_run_made_of_it_likewise(warming):
    of_file = json.loads(calrig("diagnose", warming, "--json").stdout)
    assert [effect["name"] for effect in of_file["effects"]] == ["temperature_bias"]
    assert of_file["runs"] == [warming]
    run_id = calrig("import", warming, "--unit", "A").stdout.strip()
    assert json.loads(calrig("diagnose", run_id[:6], "--json").stdout)["runs"] == [run_id]
    shown = calrig("diagnose", run_id).stdout
    assert shown.startswith("named: reading = bias + scale·θ + temperature_bias")
    before, after = (f"{of_file[model]['held_out_rms_deg']:.4f}°" for model in ("base", "final"))
    assert re.search(rf"held-out poses +│ +{before} │ +{after}", shown)
    lines = shown.splitlines()
    assert {f"held out: {of_file['held_out']['how']}", *of_file["says"][1:]} <= set(lines)
    scale = f"{of_file['base']['scale']:.5f}"
    assert re.search(rf"before: bias −?[0-9.]+°, scale {scale}; RMS in degrees of elevation", shown)


def test_what_follows_the_stage_only_with_its_effect_is_said_why_it_has_no_error_before(folder):
    noise = np.random.default_rng(1).normal(0.0, 0.02, 49)
    rows = [f"{t},{abs(t + n):.4f}" for t, n in zip(np.linspace(-60.0, 60.0, 49), noise, strict=True)]
    (folder / "bent.csv").write_text("\n".join(["target_deg,reading_deg", *rows]))
    said = calrig("diagnose", "bent.csv").stdout
    assert "not known" in said
    assert "with bias and scale alone the readings do not follow the stage" in said


@pytest.mark.parametrize("has_accelerometer", [False, True])
def test_only_poses_with_an_accelerometer_get_hints_about_it_and_files_none_about_calls(
    folder, has_accelerometer
):
    """An eccentricity and an offset of the sensor look alike within ±60°, unless |a| is known."""
    draw = np.random.default_rng(5)
    lines = ["target_deg,reading_deg" + ",accel_y_g,accel_z_g" * has_accelerometer]
    for target in np.linspace(-60.0, 60.0, 41):
        reading = np.radians(target + 1.5 * np.sin(np.radians(target + 40.0)) + draw.normal(0.0, 0.02))
        vector = (1.0 + draw.normal(0.0, 0.02)) * np.array([np.sin(reading), np.cos(reading)])
        accel = f",{vector[0]:.6f},{vector[1]:.6f}" * has_accelerometer
        lines.append(f"{target:.1f},{np.degrees(reading):.4f}{accel}")
    (folder / "poses.csv").write_text("\n".join([*lines, ""]))
    said = calrig("diagnose", "poses.csv").stdout
    assert "indistinguishable from" in said
    assert ("accelerometer" in said) == has_accelerometer
    assert not re.search(r"/api|POST|HTTP", said)


@pytest.mark.parametrize(
    ("column", "cells", "says"),
    [
        ("mount_axis", ("y", "y"), "is y, and this is of elevations about x; `calrig solve` takes it"),
        ("unit", ("7", "8"), "line 3, column unit: '8' after '7'"),
    ],
)
def test_poses_about_another_axis_or_of_two_units_are_no_diagnosis(folder, column, cells, says):
    rows = [f"{k},{k},{cell}" for k, cell in enumerate(cells)]
    (folder / "others.csv").write_text("\n".join([f"target_deg,reading_deg,{column}", *rows]))
    assert says in reason("diagnose", "others.csv", status=2)


def test_gravity_finds_that_the_axes_are_not_square(folder):
    rng = np.random.default_rng(4)
    true_g = rng.normal(size=(30, 3))
    true_g /= np.linalg.norm(true_g, axis=1, keepdims=True)
    skewed = true_g + 0.02 * true_g[:, [1, 2, 0]] * [1.0, 1.0, 0.0]
    samples_g = np.repeat(skewed, 300, axis=0) + rng.normal(0.0, 0.001, (30 * 300, 3))
    table = np.column_stack([np.arange(len(samples_g)) / 100.0, samples_g])
    header = "time_s,accel_x_g,accel_y_g,accel_z_g"
    np.savetxt("log.csv", table, fmt="%.6f", delimiter=",", header=header, comments="")
    found = json.loads(calrig("gravity", "log.csv", "--json").stdout)
    assert [effect["name"] for effect in found["effects"]] == ["misalignment"]
    shown = calrig("gravity", "log.csv").stdout
    assert shown.startswith("named: bias, scale, misalignment\n")
    xy_mrad = found["effects"][0]["parameters"]["xy_mrad"]
    bias_mg, std_mg = (1e3 * found["final"][key][2] for key in ("bias_g", "bias_std_g"))
    for heading, value, std in (("z", bias_mg, std_mg), ("xy", xy_mrad["value"], xy_mrad["std"])):
        cells = next(line for line in shown.splitlines() if re.match(rf"│ {heading} ", line)).split("│")
        assert float(cells[2]) == pytest.approx(value, abs=0.1 * std)
        assert float(cells[3]) == pytest.approx(std, rel=0.1)
    assert f"{found['final']['held_out_rms_mg']:.2f} mg" in shown


def test_gravity_reads_one_row_a_position_names_a_bad_line_and_takes_a_rate(folder):
    rng = np.random.default_rng(5)
    rows_g = rng.normal(size=(60, 3))
    rows_g /= np.linalg.norm(rows_g, axis=1, keepdims=True)
    rows_g[40] *= 1.2
    np.savetxt("rows.csv", rows_g + rng.normal(0.0, 0.001, (60, 3)), delimiter=",", fmt="%.5f")
    table = "accel_x_g,accel_y_g,accel_z_g\n" + (folder / "rows.csv").read_text()
    (folder / "rows.csv").write_text(table)
    found = json.loads(calrig("gravity", "rows.csv", "--json", "--rate", "100").stdout)
    assert found["n_poses"] == 59
    assert any(re.match("line 42: .* left out", warning) for warning in found["warnings"])
    assert "line 42: " in calrig("gravity", "rows.csv").stdout
    assert "above 0" in reason("gravity", "rows.csv", "--rate", "0", status=2)


@pytest.mark.parametrize(
    ("command", "content", "words"),
    [
        ("diagnose", "target_deg,reading_deg\n0,0.1\n10,x\n", r"bad.csv: .*line 3, column reading_deg"),
        ("diagnose", "target_deg,reading_deg\n0,0.1\n10,10.1\n", r"2 poses are too few"),
        ("gravity", "accel_x_g,accel_y_g,accel_z_g\n0,0,one\n", r"bad.csv: .*line 2, column accel_z_g"),
        ("gravity", "accel_x_g,accel_y_g\n0,0\n", r"bad.csv: .*accel_z"),
        ("gravity", "accel_x_g,accel_y_g,accel_z_g\n0,0,1\n", r"bad.csv: .*"),
    ],
)
def test_a_bad_file_is_one_line_and_status_2(folder, command, content, words):
    (folder / "bad.csv").write_text(content, encoding="utf-8")
    assert re.search(words, reason(command, "bad.csv", status=2))


@pytest.mark.parametrize("run_id", ["17", "3f0c9e", "3f0c9e52-8d1b-4b7a-9c56-0e1a7d2b4c88"])
def test_files_and_runs_are_not_mixed_and_a_file_of_that_name_is_meant(folder, run_id):
    said = reason("diagnose", "poses.csv", run_id, status=2)
    assert said == "calrig: diagnose: name files or run ids, not both"
    calrig("import", "poses.csv", "--unit", "A")
    assert reason("diagnose", run_id, status=1) == f"calrig: there is no run {run_id}"
    (folder / run_id).write_text("target_deg,reading_deg\n0,0.1\n10,x\n")
    assert f"{run_id}: line 3, column reading_deg" in reason("diagnose", run_id, status=2)


@pytest.mark.parametrize("period", ["0", "-7.2", "360.5", "nan", "inf"])
def test_a_period_that_no_axis_has_is_wrong_usage(warming, period):
    assert "period" in reason("diagnose", warming, f"--period={period}", status=2)


def test_what_was_assumed_is_in_the_document_and_the_residuals_are_drawn(warming, folder):
    asked = ("--reference", "good", "--period", "30", "--period", "7.2", "--plot", "left.html")
    found = json.loads(calrig("diagnose", warming, "--json", *asked).stdout)
    assert (found["reference"], found["known_periods_deg"]) == ("good", [7.2, 30.0])
    assert "Bias and scale, by angle" in (folder / "left.html").read_text()


@pytest.mark.parametrize("reference", ["stage", "good"])
def test_headings_of_effects_and_rivals_blame_the_stage_only_without_a_good_reference(
    folder, capsys, reference
):
    """Its words alone differ: whose error map corrects a backlash does not."""
    theta_deg = np.tile([*range(-60, 61, 10), *range(60, -61, -10)], 2)
    approach = np.tile([1] * 13 + [-1] * 13, 2)
    reading_deg = theta_deg + 0.1 * approach + np.random.default_rng(2).normal(0.0, 0.01, 52)
    rows = [f"{t},{y:.5f},{a}" for t, y, a in zip(theta_deg, reading_deg, approach, strict=True)]
    (folder / "play.csv").write_text("\n".join(["target_deg,reading_deg,approach", *rows]))
    document = json.loads(calrig("diagnose", "play.csv", "--reference", reference, "--json").stdout)
    (effect,) = document["effects"]
    assert (effect["name"], effect["origin"], effect["corrects"]) == ("backlash", "stage", "rig")
    effect["confusable_with"] = ["stage_eccentricity"]
    print_diagnosis(Diagnosis.model_validate(document), of_files=True)
    (heading,) = (line for line in capsys.readouterr().out.splitlines() if "Eccentricity" in line)
    assert ("stage" in heading, "sensor" in heading) == (reference == "stage", reference == "good")


def test_a_figure_as_png_is_drawn_by_a_browser_where_there_is_one(warming, folder):
    pytest.importorskip("kaleido", reason="the extra calrig[png] is not installed")
    if not any(map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))):
        pytest.skip("no browser that kaleido could draw with is installed")
    calrig("diagnose", warming, "--plot", "left.png")
    assert (folder / "left.png").read_bytes().startswith(b"\x89PNG\r\n")


def assert_an_import_may_state_that_its_reference_is_good(file):
    run_id = calrig("import", file, "--unit", "A", "--reference", "good").stdout.strip()
    assert json.loads(calrig("diagnose", run_id, "--json").stdout)["reference"] == "good"
    asked = calrig("diagnose", run_id, "--json", "--reference", "stage").stdout
    assert json.loads(asked)["reference"] == "stage"


def test_diagnoses_of_an_import_assume_what_it_stated_unless_asked_otherwise(warming):
    assert_an_import_may_state_that_its_reference_is_good(warming)


def test_a_service_keeps_what_an_import_stated_of_its_reference(warming, service, monkeypatch):
    with serving(service) as client:
        monkeypatch.setenv("CALRIG_SERVER", str(client.base_url))
        assert_an_import_may_state_that_its_reference_is_good(warming)
