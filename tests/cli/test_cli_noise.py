"""`calrig noise` and `calrig filters` as a person or script uses them."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console
from support import DATA, QUICK

from calrig.cli import terminal_noise

STATIC, WARM_UP = DATA / "mpu6050_static_100hz.csv", DATA / "mpu6050_warmup_log.csv"
measured = pytest.mark.skipif(not STATIC.exists(), reason=f"the measured data are not at {DATA}")
CONFIG = '[[rig]]\nname = "bench-1"\nsimulated = { seed = 1, time_scale = 20.0 }\n'
SIX = [f"{sensor}_{axis}" for sensor in ("accel", "gyro") for axis in "xyz"]


def calrig(*arguments, cwd):
    """Runs the command line as a person does."""
    command = [sys.executable, "-m", "calrig", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture
def log(tmp_path):
    """Half a minute at 100 Hz of a sensor whose x axis hums at 8 Hz."""
    rng = np.random.default_rng(5)
    time_s = np.arange(3000) / 100.0
    accel = rng.normal(0.0, 0.003, (3, 3000))
    accel[2] += 1.0
    accel[0] += 0.002 * np.sin(2.0 * np.pi * 8.0 * time_s)
    gyro_x = rng.normal(0.5, 0.05, 3000)
    header = "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps"
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack([time_s, *accel, gyro_x]),
        fmt="%.6f",
        delimiter=",",
        header=header,
        comments="",
    )
    return tmp_path / "log.csv"


@measured
def test_a_measured_log_in_counts_keeps_its_units_and_its_published_deviations(tmp_path):
    done = calrig("noise", STATIC, "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert list(found["channels"]) == [*(f"{name}_lsb" for name in SIX), "elevation_deg"]
    for name in SIX:
        channel = found["channels"][f"{name}_lsb"]
        at_1_s = np.interp(0.0, np.log(channel["allan"]["tau_s"]), channel["allan"]["deviation"])
        low, high = (5.0, 7.4) if name.startswith("accel") else (0.98, 1.47)
        assert low < at_1_s < high
        assert -0.51 < channel["adf_slope"] < -0.49


@measured
def test_ranges_make_units_of_counts(tmp_path):
    done = calrig("noise", STATIC, "--accel-range", 2, "--gyro-range", 250, "--json", cwd=tmp_path)
    channel = json.loads(done.stdout)["channels"]["gyro_x_dps"]
    counts = np.loadtxt(STATIC, delimiter=",", skiprows=1)[:, 4]
    assert channel["std"] == pytest.approx(counts.std() * 250 / 32768)
    assert channel["coefficients"]["white"]["unit"] == "°/s·√s"


@measured
def test_the_warm_up_log_shows_its_gaps_and_its_temperature_slopes(tmp_path):
    done = calrig("noise", WARM_UP, "--json", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert found["dropped"]["gaps"] == 378
    slopes = {axis: found["channels"][f"accel_{axis}_lsb"]["temperature"]["per_c"] for axis in "xyz"}
    assert slopes == pytest.approx({"x": 4.6, "y": -1.5, "z": -28.2}, abs=0.5)


def test_a_person_reads_a_table_and_that_a_tone_is_not_white(log, tmp_path):
    done = calrig("noise", log, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "slope of" in done.stdout
    said = re.search(r"accel_x_g carries a tone at 8 Hz of amplitude ([\d.]+) mg: (.*)", done.stdout)
    assert float(said[1]) == pytest.approx(2.0, abs=0.3)
    assert said[2] == "a log that carries a tone is not white."


def test_a_rate_that_is_given_wins_and_the_disagreement_is_said(log, tmp_path):
    found = json.loads(calrig("noise", log, "--rate", 50, "--json", cwd=tmp_path).stdout)
    assert found["rate_hz"] == 50
    assert found["duration_s"] == pytest.approx(60.0)
    assert any("100" in sentence and "50" in sentence for sentence in found["summary"])


@pytest.mark.parametrize("command", ["noise", "filters"])
def test_the_figures_go_into_a_file_that_stands_by_itself(log, tmp_path, command):
    done = calrig(command, log, "--json", "--plot", "figures.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    json.loads(done.stdout)
    page = (tmp_path / "figures.html").read_text(encoding="utf-8")
    assert "Plotly.newPlot" in page
    assert not re.search(r"<script[^>]+src=", page)


@pytest.mark.parametrize(
    ("arguments", "content", "reason"),
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
def test_bad_input_is_one_line_and_status_2(tmp_path, arguments, content, reason):
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    done = calrig(arguments[0], "bad.csv", *arguments[1:], cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert re.search(reason, done.stderr), done.stderr


def test_filters_of_a_run_are_compared_on_its_moves_and_tuned_at_its_rests(tmp_path):
    (tmp_path / "calrig.toml").write_text(CONFIG)
    (tmp_path / "plan.json").write_text(json.dumps(QUICK | {"dwell_s": 3.0}))
    ran = calrig("run", "--unit", "A", "--plan", "plan.json", "--db", "runs.db", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    done = calrig("filters", 1, "--db", "runs.db", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    rows = {row["name"]: row for row in found["filters"]}
    assert found["n_moves"] >= 3
    assert rows["kalman_tuned"]["jitter_deg"] < rows["kalman_paper"]["jitter_deg"] < rows["raw"]["jitter_deg"]
    unknown = calrig("filters", 99, "--db", "runs.db", cwd=tmp_path)
    assert (unknown.returncode, unknown.stderr) == (1, "calrig: there is no run 99\n")


def bar_after(patience_s, monkeypatch):
    """What a terminal has got when half of some work is done."""
    screen = io.StringIO()
    terminal = Console(file=screen, force_terminal=True, width=80)
    monkeypatch.setattr(terminal_noise, "Console", lambda **_: terminal)
    with terminal_noise.late_bar("log.csv", patience_s) as show:
        show(0.5)
        show(0.5)
    return screen.getvalue()


def test_a_bar_shows_what_takes_long_and_only_that(monkeypatch):
    assert "50%" in bar_after(0.0, monkeypatch)
    assert bar_after(60.0, monkeypatch) == ""
