"""Limits over HTTP: kept, refused in words, in every verdict; what no unit can pass is said before a run."""

from __future__ import annotations

import pytest
from support import ended, imported, running_service, serving

from calrig.analysis.limits import keep_configured
from calrig.settings import load_settings

FLIGHT = {"name": "flight", "units": "AS-*", "max_error_deg": 0.6, "rule": "guarded"}
ALL = {"name": "all", "units": "*", "scale": [0.9, 1.1]}


def put(client, *limits):
    return client.put("/api/limits", json=list(limits))


def test_limits_are_replaced_as_a_whole_and_say_what_they_do_not_ask(client):
    assert client.get("/api/limits").json() == []
    kept = put(client, FLIGHT, ALL).raise_for_status().json()
    assert kept == client.get("/api/limits").json()
    assert kept[0] == {
        "name": "flight",
        "units": "AS-*",
        "rig": None,
        "max_error_deg": 0.6,
        "bias_deg": None,
        "scale": None,
        "rms_deg": None,
        "expanded_uncertainty_deg": None,
        "rule": "guarded",
        "guard": 1.0,
    }
    assert kept[1]["scale"] == [0.9, 1.1]
    assert put(client).json() == []


def test_run_revision_and_api_say_the_same(client, quick_plan):
    put(client, FLIGHT, ALL)
    body = {"unit": "AS-1", "plan": quick_plan.model_dump(exclude_unset=True)}
    run = ended(client, client.post("/api/runs", json=body).raise_for_status().json()["id"])
    said = run["verdict"]
    assert (said["answer"], said["limit"]) == ("pass", "flight")
    assert said["says"][0] == "Pass against the limits “flight” (guarded rule, w = 1·U)."
    assert 0.9 < said["probability_of_conformity"] <= 1.0
    (revision,) = client.get("/api/units/AS-1/calibrations").json()
    assert revision["verdict"] == said
    (listed,) = client.get("/api/runs").json()["items"]
    assert listed["verdict"] == said


def test_an_import_without_a_reference_never_passes(client):
    put(client, ALL)
    said = imported(client, "B")["verdict"]
    assert (said["answer"], said["limit"], said["probability_of_conformity"]) == (
        "undecided",
        "all",
        None,
    )


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ({"name": "x"}, "the limit 'x' asks nothing"),
        ({**ALL, "scale": [1.1, 0.9]}, "the lower end 1.1 is not below the upper one 0.9"),
        ({**ALL, "rms_deg": "small"}, "RMS error of limit 1 is not a number"),
        ({**ALL, "rms_deg": -1}, "RMS error of limit 1 must be greater than 0"),
        ({**ALL, "name": ""}, "Name of limit 1 is empty"),
        ({**ALL, "rule": "strict"}, "Decision rule of limit 1"),
        ({**ALL, "expanded_uncertainty_deg": -1}, "Expanded uncertainty of limit 1 must be"),
        ({**ALL, "speed": 1}, "speed"),
    ],
)
def test_a_limit_that_cannot_be_is_refused_by_its_name_on_the_page(client, limit, words):
    answer = put(client, limit)
    assert answer.status_code == 422
    assert words in answer.json()["detail"]


def test_two_limits_of_one_name_are_refused(client):
    answer = put(client, ALL, ALL)
    assert (answer.status_code, "Limit 2 is named 'all'" in answer.json()["detail"]) == (422, True)


def test_limits_of_the_configuration_are_shown_and_changed_there(tmp_path, store_path, rig):
    config = tmp_path / "calrig.toml"
    config.write_text('[[limit]]\nname = "flight"\nunits = "AS-*"\nmax_error_deg = 0.3\n')
    settings = load_settings(str(config))
    with running_service(store_path, rig) as service:
        keep_configured(settings, service.store)
        with serving(service, limits_kept_in=str(settings.file)) as client:
            assert [one["name"] for one in client.get("/api/limits").json()] == ["flight"]
            answer = put(client, ALL)
            assert answer.status_code == 409
            assert str(config) in answer.json()["detail"]


def test_that_no_unit_can_pass_on_this_stage_is_said_before_it_moves(client):
    put(client, {**FLIGHT, "max_error_deg": 0.4})

    def warned(unit):
        return client.post("/api/plans/estimate", json={"unit": unit}).json()["warnings"]

    (said,) = warned("AS-1")
    assert said.startswith("No unit can pass on this stage: w = 1·U with U = 0.48° of the stage alone")
    assert warned("B") == []
    put(client, FLIGHT)
    assert warned("AS-1") == []
