"""Changes, comparison, check units and due dates over HTTP."""

from __future__ import annotations

import pytest
from dated_runs import at, gave, lay, ran
from prometheus_client.parser import text_string_to_metric_families
from support import imported, running_service, serving

from calrig.store import Store
from calrig.store.tables import CheckUnitTable

WOBBLE = ((0.0, 0.02, -0.01), (0.01, -0.02, 0.0), (-0.02, 0.0, 0.01), (0.02, 0.01, -0.01), (0.0, -0.01, 0.02))


def fill(store: Store) -> None:
    """Five units that repeat, and `MOVED`, whose scale moved between its two runs."""
    runs = [
        (f"U{k}", 30.0 * n + k, gave(0.5 + k + wobble, 1 + wobble / 100), {})
        for k, wobbles in enumerate(WOBBLE)
        for n, wobble in enumerate(wobbles)
    ]
    lay(store, *runs, ("MOVED", 10.0, gave(0.8, 1.0), {}), ("MOVED", 40.0, gave(0.8, 1.02), {}))


@pytest.fixture(scope="module")
def told(rig, tmp_path_factory):
    """A client of a service whose store is so filled."""
    path = tmp_path_factory.mktemp("changes") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        fill(service.store)
        yield client


def test_changes_are_those_of_the_contract(told):
    (change,) = told.get("/api/units/MOVED/changes").raise_for_status().json()
    assert {"from", "to", "days", "bias_deg", "bias_sigma", "scale", "scale_sigma"} <= change.keys()
    assert (change["verdict"], change["days"], change["effects"]) == ("changed", 30.0, None)
    assert change["scale_sigma"] > 10
    assert change["p_value"] < 0.001
    assert "Scale moved by" in change["says"]
    assert {one["verdict"] for one in told.get("/api/units/U1/changes").json()} == {"unchanged"}
    assert told.get("/api/units/nope/changes").status_code == 404


def test_a_change_has_the_differences_of_rms_error_and_gyro(rig, store_path):
    gyros = [
        {"bias_dps": [0.1, 0.2, None], "bias_std_dps": [0.03, 0.03, None], "scale": 1.0, "scale_std": 0.003},
        {"bias_dps": [0.4, 0.1, 0.5], "bias_std_dps": [0.04, 0.04, 0.04], "scale": 1.02, "scale_std": 0.004},
    ]
    runs = [
        ("G", 10.0 * k, gave(0.8, 1.0, gyro=gyro, rms_calibrated_deg=0.01 + 0.02 * k), {})
        for k, gyro in enumerate([*gyros, gave()["gyro"]])
    ]
    with running_service(store_path, rig) as service, serving(service) as client:
        lay(service.store, *runs)
        first, second = client.get("/api/units/G/changes").raise_for_status().json()
    assert (first["rms_deg"], second["rms_deg"]) == pytest.approx((0.02, 0.02))
    gyro = first["gyro"]
    assert gyro["bias_dps"][:2] == pytest.approx([0.3, -0.1]) and gyro["bias_dps"][2] is None
    assert gyro["bias_std_dps"][:2] == pytest.approx([0.05, 0.05]) and gyro["bias_std_dps"][2] is None
    assert (gyro["scale"], gyro["scale_std"]) == pytest.approx((0.02, 0.005))
    assert second["gyro"] is None, "the last run has no gyro figures"


def test_every_unit_compared_has_a_verdict_those_with_one_run_too(rig, store_path):
    with running_service(store_path, rig) as service, serving(service) as client:
        fill(service.store)
        run = imported(client, "ONCE")
        client.post("/api/units/ONCE/calibrations/1/release", json={"reason": "a test"})
        units = {one["unit"]: one for one in client.get("/api/compare").raise_for_status().json()["units"]}
    assert {serial: one["verdict"] for serial, one in units.items()} == {
        "MOVED": "changed",
        "ONCE": "not_known",
        **dict.fromkeys([f"U{k}" for k in range(5)], "unchanged"),
    }
    in_force = units["ONCE"]["in_force"]
    assert (in_force["answer"], in_force["left"]) == (run["verdict"]["answer"], run["verdict"]["left"])


def test_a_get_of_changes_changes_nothing(told):
    before = told.get("/api/runs?unit=MOVED").json()
    told.get("/api/units/MOVED/changes").raise_for_status()
    assert told.get("/api/runs?unit=MOVED").json() == before


def test_the_unit_that_moved_comes_first_and_spoils_nothing(told):
    comparison = told.get("/api/compare").json()
    first, *others = comparison["units"]
    assert (first["unit"], first["changed"]) == ("MOVED", True)
    assert first["change"]["scale_sigma"] > 10
    assert not any(one["changed"] for one in others)
    assert all(one["p_value"] > first["p_value"] for one in others)
    assert comparison["spread"]["scale"]["within_unit_std"] < 0.0005
    assert "MOVED" in comparison["spread"]["scale"]["says"]
    assert comparison["repeatability"]["false_discovery_rate"] == 0.05
    assert "5 %" in comparison["repeatability"]["rule"]
    assert "MOVED" in comparison["repeatability"]["says"]


def test_whether_a_unit_changed_does_not_depend_on_which_are_asked_for(told):
    (alone,) = told.get("/api/compare?unit=MOVED").json()["units"]
    everywhere = told.get("/api/compare").json()["units"][0]
    assert alone == everywhere


def test_units_that_did_not_change_stay_in_the_order_asked_for(told):
    asked = "/api/compare?unit=U3&unit=U1&unit=MOVED&unit=U2"
    assert [one["unit"] for one in told.get(asked).json()["units"]] == ["MOVED", "U3", "U1", "U2"]


def test_every_unit_says_when_it_is_due(told):
    moved = next(one for one in told.get("/api/units").json() if one["serial"] == "MOVED")
    assert (moved["due_at"][:10], moved["due_method"]) == ("2026-02-10", "interval")
    assert told.get("/api/units/MOVED").json()["due_at"] == moved["due_at"]
    compared = told.get("/api/compare?unit=MOVED").json()["units"][0]
    assert (compared["due_at"], compared["overdue"]) == (moved["due_at"], moved["overdue"])


def test_units_overdue_are_a_metric(told):
    def overdue():
        families = text_string_to_metric_families(told.get("/api/metrics").text)
        return {one.name: one.samples for one in families}["calrig_units_overdue"][0].value

    listed = sum(one["overdue"] for one in told.get("/api/units").json())
    assert overdue() == listed


def test_an_interval_of_ones_own_counts(rig, store_path):
    with running_service(store_path, rig) as service, serving(service, interval_days=10.0) as client:
        ran(service.store, "A", 0)
        (unit,) = client.get("/api/units").json()
        assert unit["due_at"][:10] == "2025-01-11"
        assert unit["overdue"]


def test_charts_of_units_and_of_chosen_ones(told):
    figure = told.get("/api/units/U1/figures/chart").raise_for_status().json()
    assert [len(trace["x"]) for trace in figure["data"]] == [3, 3, 3, 3]
    assert told.get("/api/compare/figures/bias?chosen=U1").status_code == 200


def test_a_rig_is_checked_by_a_unit(told, rig):
    """Its own service's rig; the runs laid in the store are of it."""
    path = f"/api/rigs/{rig.name}/check-unit"
    assert told.get(path).status_code == 404
    assert told.put(path, json={"unit": "nope", "interval_days": 7}).status_code == 404
    assert told.put(path, json={"unit": "U0", "interval_days": 0}).status_code == 422
    assert told.put("/api/rigs/nope/check-unit", json={"unit": "U0"}).status_code == 404
    named = told.put(path, json={"unit": "U0", "interval_days": 7}).raise_for_status().json()
    assert (named["unit"], named["interval_days"], named["state"]) == ("U0", 7.0, "passed")
    assert told.get(path).json() == named
    assert told.get(f"/api/rigs/{rig.name}/figures/check-unit").json()["data"]
    assert told.delete(path).status_code == 204
    assert told.get(path).status_code == 404
    assert told.delete(path).status_code == 404


def test_runs_are_suspect_wherever_they_are_shown(rig, store_path):
    with running_service(store_path, rig) as service, serving(service) as client:
        fill(service.store)
        client.put(f"/api/rigs/{rig.name}/check-unit", json={"unit": "U0"}).raise_for_status()
        with service.store._database.writing() as session:
            session.get_one(CheckUnitTable, rig.name).named_at = at(70)
        during = ran(service.store, "U1", 80, 1.5)
        assert client.get(f"/api/runs/{during.id}").json()["suspect"] is None
        failed = ran(service.store, "U0", 90, 3.0)
        listed = {run["id"]: run["suspect"] for run in client.get("/api/runs").json()["items"]}
        assert listed[during.id]["check_run_id"] == failed.id
        assert "check unit U0 failed" in listed[during.id]["reason"]
        since = sum(one is not None for one in listed.values())
        assert since == 6, "four units on days 61 to 64, after the pass on day 60, and these two"
        assert client.get(f"/api/runs/{during.id}").json()["suspect"] == listed[during.id]
        of_unit = client.get("/api/units/U1").json()["runs"]
        assert [run["suspect"] for run in of_unit if run["id"] == during.id] == [listed[during.id]]
        (compared,) = client.get("/api/compare?unit=U1").json()["units"]
        assert compared["runs"][-1]["suspect"] == listed[during.id]
