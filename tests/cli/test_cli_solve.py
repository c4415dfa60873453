"""`calrig solve`: files with their mounts in columns, or runs of the store, solved together."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import plotly.graph_objects as go
import pytest
from clamped import HEADER, clamped, felt_g, rows_of
from command_line import calrig, reason
from support import imported, serving

from calrig import load
from calrig.calibration.results.correction import calibrated_elevation_deg


@pytest.fixture
def mounts(folder):
    """A file for each of three clampings; the fourth has them all, with labels."""
    together = [f"{HEADER},unit,mount,mount_deg"]
    for k, angle in enumerate((0, 120, 240)):
        rows = rows_of(angle, k)
        (folder / f"at{angle}.csv").write_text(
            "\n".join([f"{HEADER},mount_deg", *(f"{row},{angle}" for row in rows)])
        )
        together += [f"{row},AS-7,clamp {k},{angle}" for row in rows]
    (folder / "all.csv").write_text("\n".join(together))
    return [f"at{angle}.csv" for angle in (0, 120, 240)]


def test_one_file_with_columns_and_a_file_for_each_mount_are_one_solution(mounts):
    of_one = json.loads(calrig("solve", "all.csv", "--json").stdout)
    of_three = json.loads(calrig("solve", *mounts, "--unit", "AS-7", "--json").stdout)
    assert of_one["separable"]
    assert [mount["mount"] for mount in of_one["mounts"]] == ["clamp 0", "clamp 1", "clamp 2"]
    assert [mount["mount_deg"] for mount in of_three["mounts"]] == [0, 120, 240]
    assert of_one["units"] == of_three["units"]
    (said,) = json.loads(calrig("solve", "all.csv", "--unit", "B", "--json").stdout)["warnings"][:1]
    assert said.startswith("all.csv: --unit B")
    assert said.endswith("AS-7")
    (unit,) = of_one["units"]
    assert unit["unit"] == "AS-7"
    for name, true in (("y_mg", 50.0), ("z_mg", -30.0), ("gain_pct", 2.0)):
        assert unit["parameters"][name]["value"] == pytest.approx(
            true, abs=4.0 * unit["parameters"][name]["std"]
        )
    assert of_one["stage"]["backlash_deg"]["value"] == pytest.approx(-0.06, abs=0.03)
    shown = calrig("solve", "all.csv").stdout
    assert shown.startswith("stage and units are separable")
    assert f"{of_one['final']['held_out_rms_deg']:.4f}° with the map" in shown


def test_out_has_what_turns_readings_into_elevations(mounts, folder):
    calrig("solve", "all.csv", "--out", "solved")
    document = json.loads((folder / "solved" / "AS-7.json").read_text(encoding="utf-8"))
    elevation = np.linspace(-60.0, 60.0, 25)
    reading = np.degrees(np.arctan2(*felt_g(elevation).T))
    effects = [(effect["name"], effect["parameters"]) for effect in document["effects"]]
    found = calibrated_elevation_deg(reading, document["bias_deg"], document["scale"], effects)
    error = found - elevation
    assert np.abs(error - error.mean()).max() < 5.0 * max(document["elevation_std_deg"]["std_deg"])
    assert np.abs(reading - elevation - (reading - elevation).mean()).max() > 1.0, "believing the sensor"
    np.testing.assert_allclose(load("solved/AS-7.json").elevation_deg(reading), found, atol=1e-9)
    assert "CAL_ACC0_YOFF" in calrig("export", "solved/AS-7.json", "--format", "px4").stdout
    why = reason("export", "solved/AS-7.json", "--format", "csv", status=2)
    assert ("c-header" in why, "px4" in why, "kalibr" in why) == (True, True, False)
    on_map = json.loads((folder / "solved" / "stage-map.json").read_text(encoding="utf-8"))
    assert np.ptp(on_map["map"]["error_deg"]) == pytest.approx(
        0.3 * 2.0 * math.sin(math.radians(60.0)), abs=0.35
    )


def test_the_map_is_drawn(mounts, folder):
    calrig("solve", "all.csv", "--plot", "map.html")
    (folder / "y.csv").write_text("target_deg,reading_deg,unit,mount_axis\n0,0,A,y\n10,10,A,y\n")
    assert "nothing was solved" in reason("solve", "y.csv", "--plot", "y.html", status=2)
    page = (folder / "map.html").read_text(encoding="utf-8")
    (drawn,) = re.findall(r'<script type="application/json" id="drawn">(.*?)</script>', page, re.DOTALL)
    figure = json.loads(drawn)
    go.Figure(figure)  # raises on any property that plotly does not know
    before, after = ([t["y"] for t in figure["data"] if t["xaxis"] == axis] for axis in ("x2", "x3"))
    assert max(map(max, after)) < 0.3 * max(map(max, before))


def test_runs_of_the_store_are_solved_by_their_ids(mounts):
    ids = [calrig("import", name, "--unit", "AS-7").stdout.strip() for name in mounts]
    of_runs = json.loads(calrig("solve", *(run_id[:13] for run_id in ids), "--json").stdout)
    of_files = json.loads(calrig("solve", *mounts, "--unit", "AS-7", "--json").stdout)
    assert of_runs["units"] == of_files["units"]
    assert [mount["mount_deg"] for mount in of_runs["mounts"]] == [0, 120, 240]


def test_a_file_with_labels_is_imported_as_it_is_solved(mounts):
    run_id = calrig("import", "all.csv", "--unit", "AS-7").stdout.strip()
    of_run, of_file = (json.loads(calrig("solve", one, "--json").stdout) for one in (run_id, "all.csv"))
    for part in ("units", "stage", "before", "final", "noise", "warnings"):
        assert of_run[part] == of_file[part]
    assert of_file["mounts"][2]["angle_deg"]["value"] == pytest.approx(240.0, abs=1.0)


def test_an_imported_run_keeps_the_axis_that_it_was_clamped_by(folder):
    rows = "\n".join(f"{row},-x" for row in rows_of(0, 1))
    (folder / "reversed.csv").write_text(f"{HEADER},mount_axis\n{rows}")
    run_id = calrig("import", "reversed.csv", "--unit", "AS-7").stdout.strip()
    assert "lie the other way round (mount_axis x)?" in reason("solve", run_id, status=2)
    assert "-x along the stage's axis" in reason("diagnose", run_id, status=1)
    assert calrig("export", run_id, "--format", "csv").stdout.count(",-x\n") == 40


def test_a_running_service_solves_its_runs_and_keeps_the_solution(mounts, folder, service, monkeypatch):
    with serving(service) as client:
        ids = [clamped(client, "AS-7", angle)["id"] for angle in (0, 120, 240)]
        here = json.loads(calrig("solve", *ids, "--json", "--db", folder / "calrig.db").stdout)
        monkeypatch.setenv("CALRIG_SERVER", str(client.base_url))
        done = calrig(
            "solve", *(typed[:8] for typed in ids), "--json", "--out", "solved", "--plot", "map.html"
        )
        assert json.loads(done.stdout) == here
        (kept,) = client.get("/api/solve").json()
        assert kept["id"] in done.stderr
        for name, path in (("AS-7", "units/AS-7"), ("stage-map", "map")):
            written = (folder / "solved" / f"{name}.json").read_bytes()
            assert written == client.get(f"/api/solve/{kept['id']}/{path}").content
        assert "Residual angle with the map" in (folder / "map.html").read_text(encoding="utf-8")
        assert "there is no run 99" in reason("solve", "99", status=1)
        few = imported(client, "FEW")["id"]
        assert "4 poses are too few" in reason("solve", few, status=2)
        calrig("solve", "all.csv")
        assert len(client.get("/api/solve").json()) == 1, "files are solved here"


def test_one_mount_is_not_enough_and_what_would_help_is_said(mounts):
    found = json.loads(calrig("solve", "at0.csv", "--unit", "AS-7", "--json").stdout)
    assert found["separable"] is False
    assert found["advice"]["mounts_deg"] == [0, 120, 240]
    assert found["advice"]["says"] in calrig("solve", "at0.csv", "--unit", "AS-7").stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["at0.csv"], r"at0\.csv: column unit: it is not said whose poses these are"),
        (["at0.csv", "at0.csv", "--unit", "A"], "holds the very same poses as"),
        (["at0.csv", "at120.csv", "at240.csv", "--unit", "A", "--unit", "B"], "2 times --unit for 3 files"),
        (["at0.csv", "1"], "name files or run ids, not both"),
        (["absent.csv", "--unit", "A"], "absent.csv: cannot be read"),
        (["poses.csv", "--unit", "A"], "3 poses are too few"),
        (["all.csv", "--limits", "90", "-90"], "the lower comes first"),
        (["all.csv", "--limits", "nan", "90"], "the lower comes first"),
    ],
)
def test_what_cannot_be_solved_is_refused_in_one_line(mounts, arguments, words):
    assert re.search(words, reason("solve", *arguments, status=2))


def test_runs_that_are_not_there_fail(folder):
    calrig("import", "poses.csv", "--unit", "A")
    assert "there is no run 99" in reason("solve", "99", status=1)


def test_a_unit_that_was_reversed_has_its_level_in_its_calibration(mounts, folder):
    dial = np.linspace(-60.0, 60.0, 40)
    table = dial + 0.3 * np.sin(np.radians(dial + 40.0))
    rows = [f"{HEADER},mount_deg,mount_axis"]
    for d, (y, z) in zip(dial, felt_g(-table + 0.8), strict=True):  # 0 and 0.8: 0.4° of level, and of seat
        rows.append(f"{d:.4f},{math.degrees(math.atan2(y, z)):.5f},0,{y:.6f},{z:.6f},0,-x")
    (folder / "reversed.csv").write_text("\n".join(rows))
    given = ("solve", *mounts, "reversed.csv", "--unit", "AS-7")
    unstated = json.loads(calrig(*given, "--json").stdout)
    assert (unstated["level_known"], unstated["units"][0]["level"]["reversals"]) == (False, 1)
    shown = calrig(*given, "--seat-std", "0.01", "--out", "solved").stdout
    assert "its level +0.4" in shown
    document = json.loads((folder / "solved" / "AS-7.json").read_text(encoding="utf-8"))
    assert document["level_known"]
    assert document["bias_deg"] == pytest.approx(0.4, abs=4.0 * document["level_std_deg"])
    assert 0.01 / math.sqrt(2.0) < document["level_std_deg"] < 0.03
