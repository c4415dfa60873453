"""`calrig noise` and `calrig filters` as a person or script uses them."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
from command_line import calrig, reason
from rich.console import Console
from support import QUICK, ended

from calrig.cli import progress
from calrig.cli.progress import Notice
from calrig.model.run import Progress


@pytest.fixture
def log(folder):
    """Half a minute at 100 Hz of a sensor whose x axis hums at 8 Hz."""
    rng = np.random.default_rng(5)
    time_s = np.arange(3000) / 100.0
    accel = rng.normal(0.0, 0.003, (3, 3000))
    accel[2] += 1.0
    accel[0] += 0.002 * np.sin(2.0 * np.pi * 8.0 * time_s)
    gyro_x = rng.normal(0.5, 0.05, 3000)
    header = "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps"
    table = np.column_stack([time_s, *accel, gyro_x])
    np.savetxt("log.csv", table, fmt="%.6f", delimiter=",", header=header, comments="")
    return "log.csv"


def test_ranges_make_units_of_counts(folder):
    counts = np.random.default_rng(6).normal(100.0, 20.0, 500).round()
    np.savetxt("log.csv", counts, fmt="%d", header="gyro_x_lsb", comments="")
    arguments = ("noise", "log.csv", "--rate", 100, "--json")
    as_counted = json.loads(calrig(*arguments).stdout)["channels"]["gyro_x_lsb"]
    channel = json.loads(calrig(*arguments, "--gyro-range", 250).stdout)["channels"]["gyro_x_dps"]
    assert as_counted["std"] == pytest.approx(counts.std())
    assert channel["std"] == pytest.approx(counts.std() * 250 / 32768)
    assert channel["coefficients"]["white"]["unit"] == "°/s·√s"


def test_a_person_reads_a_table_and_that_a_tone_is_not_white(log):
    done = calrig("noise", log)
    assert re.search(r"│ gyro_x_dps +│ +−0\.\d\d │ +[+−]0\.\d\d │", done.stdout)
    said = re.search(r"contains a spectral line at 8 Hz of amplitude ([\d.]+) mg: (.*)", done.stdout)
    assert float(said[1]) == pytest.approx(2.0, abs=0.3)
    assert said[2] == "the noise is not white."
    assert done.stderr == ""


def test_a_rate_that_is_given_wins_and_the_disagreement_is_said(log):
    found = json.loads(calrig("noise", log, "--rate", 50, "--json").stdout)
    assert found["rate_hz"] == 50
    assert found["duration_s"] == pytest.approx(60.0)
    assert any("100" in sentence and "50" in sentence for sentence in found["summary"])


@pytest.mark.parametrize("command", ["noise", "filters"])
def test_the_figures_go_into_a_file_that_stands_by_itself(log, folder, command):
    json.loads(calrig(command, log, "--json", "--plot", "figures.html").stdout)
    page = (folder / "figures.html").read_text(encoding="utf-8")
    assert "Plotly.newPlot" in page
    assert not re.search(r"<script[^>]+src=", page)


@pytest.mark.parametrize(
    ("arguments", "content", "words"),
    [
        (
            ["noise"],
            "time_s,accel_x_g\n0,1\n1,x\n",
            r"bad\.csv: line 3, column accel_x_g: 'x' is not a number",
        ),
        (["noise"], "accel_x_g\n1\n2\n", r"bad\.csv: .*--rate"),
        (["noise", "--rate", "0"], "accel_x_g\n1\n2\n", r"bad\.csv: the rate is 0"),
        (["noise", "--plot", "figure.pdf"], "", r"figure\.pdf: name it \.html or \.png"),
        (["noise", "--plot", "no/figure.html"], "", r"there is no folder no"),
        (["filters"], "time_s,accel_x_g\n0,1\n", r"bad\.csv: .*accel_y and accel_z"),
    ],
)
def test_bad_input_is_one_line_and_status_2(folder, arguments, content, words):
    (folder / "bad.csv").write_text(content, encoding="utf-8")
    assert re.search(words, reason(arguments[0], "bad.csv", *arguments[1:], status=2))


def test_filters_of_a_run_are_compared_on_its_moves(client, store_path):
    run = client.post("/api/runs", json={"unit": "A", "plan": QUICK | {"dwell_s": 3.0}}).json()
    assert ended(client, run["id"])["status"] == "completed"
    found = json.loads(calrig("filters", run["id"], "--db", store_path, "--json").stdout)
    rows = {row["name"]: row for row in found["filters"]}
    assert found["n_moves"] >= 3
    assert rows["kalman_paper"]["jitter_deg"] < rows["raw"]["jitter_deg"]
    shown = calrig("filters", run["id"], "--db", store_path).stdout
    assert rows["kalman_paper"]["label"] in shown
    assert reason("filters", 99, "--db", store_path, status=1) == "calrig: there is no run 99"


def bar_after(patience_s, monkeypatch):
    """What a terminal has got when half of some work is done."""
    screen = io.StringIO()
    terminal = Console(file=screen, force_terminal=True, width=80)
    monkeypatch.setattr(progress, "Console", lambda **_: terminal)
    with progress.late_bar("log.csv", patience_s) as show:
        show(0.5)
        show(0.5)
    return screen.getvalue()


def test_no_name_is_cut_where_a_run_is_followed_on_eighty_columns(monkeypatch):
    screen, unit = io.StringIO(), "AS-0042-" + 100 * "x"
    terminal = Console(file=screen, force_terminal=True, width=80)
    monkeypatch.setattr(progress, "Console", lambda **_: terminal)

    class Run:
        id, status, is_over = "6c5969b4-0000-4000-8000-000000000000", "running", False
        progress = Progress(poses_done=0, poses_total=52, fraction=0.0, remaining_s=None)

    with progress.run_bar(Run(), unit) as show:
        show(Notice("the service does not answer"))
    shown = screen.getvalue()
    assert f"run {Run.id} of unit {unit}" in shown
    assert "calrig: the service does not answer" in shown
    assert "…" not in shown


def test_a_bar_shows_what_takes_long_and_only_that(monkeypatch):
    assert "50%" in bar_after(0.0, monkeypatch)
    assert bar_after(60.0, monkeypatch) == ""
