"""`calrig plan`, and `calrig run` where it cannot begin: plan, configuration, serial number, ports."""

from __future__ import annotations

import json
import re
import tomllib

import pytest
from command_line import RIG, calrig, reason
from serial.tools import list_ports
from simulated_devices import plug


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        pytest.param('{\n  "sweeps": 4,\n  "step_deg" 5\n}', "plan.json, line 3, column 14", id="no JSON"),
        pytest.param(
            '{\n  "sweeps": 4,\n  "stepp": 5\n}',
            "plan.json, line 3, column 3: stepp is not known here",
            id="unknown",
        ),
        pytest.param(
            '{"sweeps": "many"}',
            "plan.json, line 1, column 2: sweeps is not a whole number",
            id="wrong value",
        ),
        pytest.param('{"sweeps": 9999}', "plan.json: the plan has", id="too many poses"),
        pytest.param('{"elevations_deg": [120]}', "120", id="beyond the limits"),
        pytest.param("[]", "plan.json: is not an object", id="no object"),
        pytest.param('{"seed": ' + "1" * 5000 + "}", "plan.json: has a number in it", id="too many digits"),
        pytest.param("[" * 100_000, "plan.json: is nested too deeply", id="too deep"),
        pytest.param(
            "{} " + " " * 1_000_000, "plan.json: larger than the maximum of 1000000 bytes", id="too large"
        ),
    ],
)
def test_a_plan_at_fault_is_2_and_says_where(folder, plan, words):
    (folder / "plan.json").write_text(plan)
    assert words in reason("run", "--unit", "A", "--plan", "plan.json", status=2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        pytest.param(["--plan", "absent.json"], "absent.json", id="no plan"),
        pytest.param(["--rig", "bench-9"], "bench-9", id="unknown rig"),
        pytest.param(["--config", "absent.toml"], "absent.toml", id="no configuration"),
        pytest.param(["--unit", ""], "serial", id="empty serial"),
    ],
)
def test_wrong_input_of_a_run_is_2(folder, arguments, words):
    unit = [] if "--unit" in arguments else ["--unit", "A"]
    assert words in reason("run", *unit, *arguments, status=2)


def test_an_option_that_the_simulator_does_not_have_is_2_and_named(folder):
    (folder / "calrig.toml").write_text('[[rig]]\nname = "x"\nsimulated = { presset = "demo" }')
    said = reason("run", "--unit", "A", status=2)
    assert "rig 'x'" in said
    assert "presset" in said


def test_a_failed_run_is_1_and_json_still_says_what_happened(folder, caplog):
    done = calrig("run", "--unit", "A", "--json", status=1)
    run = json.loads(done.stdout)
    assert run["status"] == "failed"
    assert "/dev/ttyABSENT0" in run["error"]
    (line,) = done.stderr.splitlines()
    assert line == f"calrig: run {run['id']} failed: {run['error']}"
    assert run["id"] not in caplog.text, "a log that nobody has set up goes to standard error, too"


def test_that_no_unit_can_pass_is_said_before_the_stage_is_even_looked_for(folder):
    limit = '[[limit]]\nname = "flight"\nmax_error_deg = 0.3\nrule = "guarded"\n'
    (folder / "calrig.toml").write_text(limit + (folder / "calrig.toml").read_text())
    warning, failure = calrig("run", "--unit", "A", status=1).stderr.splitlines()
    assert warning.startswith("warning: No unit can pass on this stage")
    assert re.match(r"calrig: run [0-9a-f-]{36} failed", failure)


def test_a_plan_comes_as_json_for_a_run_to_take(tmp_path):
    asked = ("plan", "--target-u", "0.5", "--json", "--db", tmp_path / "none.db")
    told, stops = json.loads(calrig(*asked).stdout), json.loads(calrig(*asked, "--no-sweep").stdout)
    assert (told["plan"]["kind"], stops["plan"]["kind"]) == ("sweep", "calibration")
    assert told["expected"]["duration_s"] < stops["expected"]["duration_s"]
    assert told["expected"]["expanded_uncertainty_deg"] <= 0.5
    assert "data sheet" in told["says"][0]


def test_the_same_in_words(tmp_path):
    said = calrig("plan", "--time", "120", "--no-trace", "--db", tmp_path / "none.db").stdout
    assert "expanded uncertainty" in said


def test_what_cannot_be_reached_is_one_line(tmp_path):
    unreached = reason("plan", "--target-u", "0.1", "--db", tmp_path / "none.db", status=1)
    assert "a stage map, which Solve finds" in unreached
    assert "--target-u DEG, or --time S" in reason("plan", "--db", tmp_path / "none.db", status=2)


CONFIG = """
[[rig]]
name = "bench-1"
stage = { driver = "smc100", port = "ttyUSB0" }
imu = { driver = "calrig", port = "ttyUSB1" }

[[rig]]
name = "demo"
simulated = { preset = "demo" }
"""


def test_what_is_configured_is_listed_with_its_ports(folder):
    shown = calrig("rigs").stdout
    assert "bench-1" in shown
    assert "smc100 on /dev/ttyABSENT0" in shown
    (folder / "calrig.toml").write_text(RIG.replace("smc100", "smc10"))
    for command in (["rigs"], ["run", "--unit", "A"]):
        assert "rig 'bench-1': no stage driver is called 'smc10'" in reason(*command, status=2)
    (folder / "calrig.toml").unlink()
    assert "simulated" in calrig("rigs").stdout


def test_what_answers_on_the_configured_ports_is_shown_with_a_rig_to_paste(tmp_path, monkeypatch):
    plug(monkeypatch, ttyUSB0="zaber", ttyUSB1="calrig")
    monkeypatch.setattr(list_ports, "comports", list)  # what is configured is looked at, listed or not
    monkeypatch.setenv("COLUMNS", "200")
    config = tmp_path / "calrig.toml"
    config.write_text(CONFIG)
    done = calrig("rigs", "--scan", "--config", config)
    assert "unit AS-0042" in done.stdout
    (found,) = tomllib.loads(done.stdout[done.stdout.index("[[rig]]") :])["rig"]
    assert found["name"] == "bench-2"
    assert (found["stage"]["driver"], found["stage"]["port"]) == ("zaber", "ttyUSB0")
    assert (found["imu"]["driver"], found["imu"]["port"]) == ("calrig", "ttyUSB1")
