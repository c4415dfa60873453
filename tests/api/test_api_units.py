"""The list of units over HTTP: what each is worth now, its filters, and the same as CSV."""

from __future__ import annotations

import csv
import io
from datetime import UTC, datetime, timedelta

import pytest
from dated_runs import FIRST_DAY, gave, lay
from sqlalchemy import event
from support import imported, running_service, serving
from test_api_changes import fill

LIMIT = {"name": "flight", "units": "P*", "scale": [0.9, 1.1]}


@pytest.fixture(scope="module")
def told(rig, tmp_path_factory):
    """A client of a service with units that repeat, `MOVED`, which did not, and imports of `P1`, `OTHER`."""
    path = tmp_path_factory.mktemp("units") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        fill(service.store)
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        for unit in ("P1", "OTHER", "P1"):
            imported(client, unit)
        yield client


def units(client, **query):
    return client.get("/api/units", params=query).raise_for_status().json()


def serials(client, **query):
    return [unit["serial"] for unit in units(client, **query)]


def test_a_unit_shows_its_revision_in_force_and_its_latest_calibration(told):
    (one,) = units(told, q="p1")
    (newest, _) = told.get("/api/units/P1/calibrations").json()
    released = newest["acts"][-1]["at"]
    assert (one["revision_in_force"], one["in_force_since"]) == (newest["revision"], released)
    assert (one["verdict"], one["left"]) == (newest["verdict"]["answer"], newest["verdict"]["left"])
    run = told.get(f"/api/runs/{newest['run_id']}").json()
    assert (one["last_calibrated_at"], one["last_verdict"]) == (run["finished_at"], run["verdict"]["answer"])
    assert told.get("/api/units/P1").json().items() >= one.items()


def test_a_release_again_is_what_it_is_in_force_since(told):
    before = units(told, q="p1")[0]
    told.post("/api/units/P1/calibrations/1/release", json={"reason": "as it was"}).raise_for_status()
    after = units(told, q="p1")[0]
    assert (before["revision_in_force"], after["revision_in_force"]) == (2, 1)
    assert after["in_force_since"] > before["in_force_since"]
    told.post("/api/units/P1/calibrations/2/release", json={"reason": "back"}).raise_for_status()


def test_the_latest_calibration_is_judged_by_the_limits_of_today(told):
    told.put("/api/limits", json=[{**LIMIT, "scale": [1.5, 1.6]}]).raise_for_status()
    (failing,) = units(told, q="P1")
    told.put("/api/limits", json=[LIMIT]).raise_for_status()
    (now,) = units(told, q="P1")
    assert failing["last_verdict"] == "fail"
    assert now["last_verdict"] != "fail"
    assert failing["verdict"] == now["verdict"]  # as issued


def test_the_last_change_is_that_of_the_changes(told):
    (moved,) = units(told, q="moved")
    (change,) = told.get("/api/units/MOVED/changes").json()
    run = told.get(f"/api/runs/{change['to']}").json()
    assert (moved["change"], moved["changed_at"]) == (change["verdict"], run["finished_at"])
    assert units(told, q="OTHER")[0]["change"] is None


def test_filters_narrow_the_list(told):
    repeating = [f"U{k}" for k in range(5)]
    assert serials(told) == ["MOVED", "OTHER", "P1", *repeating]
    assert serials(told, change="changed") == ["MOVED"]
    assert serials(told, change="unchanged") == ["P1", *repeating]
    assert serials(told, verdict="none") == ["MOVED", *repeating]
    assert serials(told, verdict="no_limits") == ["OTHER"]
    assert serials(told, due="later", q="o") == ["OTHER"]
    assert serials(told, due="overdue") + serials(told, due="soon") + serials(told, due="later") != []
    assert told.get("/api/units?due=sometime").status_code == 422


@pytest.mark.parametrize(("days_ago", "due"), [(400, "overdue"), (350, "soon"), (10, "later")])
def test_due_is_overdue_within_a_month_or_later(rig, store_path, days_ago, due):
    day = (datetime.now(UTC) - FIRST_DAY - timedelta(days=days_ago)).total_seconds() / 86_400
    with running_service(store_path, rig) as service, serving(service) as client:
        lay(service.store, ("A", day, gave(), {}))
        assert [serials(client, due=one) for one in (due, "none")] == [["A"], []]


def test_csv_has_the_same_units_under_the_same_names(told):
    asked = told.get("/api/units?change=changed", headers={"Accept": "text/csv"})
    assert asked.headers["content-type"] == "text/csv; charset=utf-8"
    assert asked.text == told.get("/api/units?change=changed&format=csv").text
    (row,) = csv.DictReader(io.StringIO(asked.text))
    (unit,) = units(told, change="changed")
    assert set(row) == set(unit)
    assert (row["serial"], row["n_runs"], row["verdict"]) == ("MOVED", "2", "")
    assert datetime.fromisoformat(row["changed_at"]) == datetime.fromisoformat(unit["changed_at"])


def test_the_list_takes_as_many_queries_for_forty_units_as_for_one(rig, store_path):
    with running_service(store_path, rig) as service, serving(service) as client:
        client.put("/api/limits", json=[{**LIMIT, "units": "*"}]).raise_for_status()
        counts = []
        seen = []
        engine = service.store._database._engine
        event.listen(engine, "before_cursor_execute", lambda *_: seen.append(1))
        for names in (["A0"], [f"A{k}" for k in range(1, 40)]):
            lay(service.store, *((name, k, gave(), {}) for name in names for k in (0.0, 9.0)))
            units(client)
            seen.clear()
            units(client)
            counts.append(len(seen))
    assert counts[0] == counts[1]
