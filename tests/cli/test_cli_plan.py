"""`calrig plan` as somebody uses it who has not run anything yet."""

from __future__ import annotations

import json

from command_line import calrig, reason


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
    assert "calrig solve" in reason("plan", "--target-u", "0.1", "--db", tmp_path / "none.db", status=1)
    assert "--target-u DEG, or --time S" in reason("plan", "--db", tmp_path / "none.db", status=2)
