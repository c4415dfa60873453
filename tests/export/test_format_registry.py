"""A format is one module: whatever lists formats finds it there, and the documentation says what it says."""

from __future__ import annotations

import json
import re
from importlib.resources import files

import pytest
from command_line import POSES, calrig, reason
from dummy_format import DUMMY, added_format
from issued_documents import issued
from support import imported

from calrig.cli.export import ISSUED, _completed
from calrig.export.formats import exporter_of, exporters, format_names


def test_a_module_more_is_a_choice_of_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "unit.json").write_text(json.dumps(issued()))
    unknown = ("export", "unit.json", "--format", "no-such")
    assert "dummy-ini" not in calrig(*unknown, status=2).stderr
    with added_format(tmp_path):
        assert calrig("export", "unit.json", "--format", "dummy-ini").stdout == "bias = 0.250"
        assert "dummy-ini" in calrig(*unknown, status=2).stderr
        assert "dummy-ini" in reason("export", "unit.json", "--format", "csv", status=2)
        assert _completed("dum") == ["dummy-ini"]


def test_a_module_more_is_a_value_of_the_apis_parameter_and_in_its_list(client, tmp_path):
    imported(client, "AS-1", POSES)
    path = "/api/units/AS-1/calibration"
    refused = client.get(path, params={"format": "dummy-ini"})
    assert (refused.status_code, "'vins'" in refused.json()["detail"]) == (422, True)
    with added_format(tmp_path):
        answer = client.get(path, params={"format": "dummy-ini", "revision": "latest"})
        assert answer.text == f"bias = {client.get(f'{path}?revision=latest').json()['bias_deg']:.3f}"
        assert answer.headers["content-type"].startswith("text/x-dummy")
        listed = {one["name"]: one for one in client.get("/api/calibration-formats").json()}
        assert listed["dummy-ini"]["file_name"] == "dummy.ini"
        assert {name for name, one in listed.items() if one["source"] == "noise"} == {"kalibr", "vins"}


@pytest.mark.parametrize(
    ("text", "why"),
    [("", "lacks EXPORTER"), (DUMMY.replace("dummy-ini", "other"), "describes 'other'")],
    ids=["none", "of another name"],
)
def test_a_module_that_describes_no_format_is_named(tmp_path, text, why):
    with added_format(tmp_path, text), pytest.raises(TypeError, match=rf"dummy_ini.*{why}"):
        exporter_of("dummy-ini")


def test_a_format_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(LookupError, match="ardupilot"):
        exporter_of("gazebo")


def test_the_documentations_table_is_the_registrys():
    page = (files("calrig") / "docs" / "reference" / "export-formats.md").read_text("utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    of_formats = {f"| `{one.name}` | {one.contents} | {one.about_one_axis} |" for one in exporters()}
    assert of_formats <= set(rows)
    named = [name for row in rows for name in re.findall("`([^`]+)`", row.split("|")[1])]
    assert sorted(named) == sorted([*ISSUED, *format_names()])
    assert len({one.file_name for one in exporters()}) == len(of_formats)
