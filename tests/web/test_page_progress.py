"""A diagnosis that takes long, on the page: how far it is, its end on request, and that it is found again."""

from __future__ import annotations

import pytest

from calrig.analysis import diagnoses
from calrig.api import heavy

from .page_help import imported
from .slow_work import LET_GO, slow_trace

pytestmark = pytest.mark.browser


@pytest.fixture
def slow_run(client, monkeypatch):
    """A run whose diagnosis goes on until LET_GO is there, and nobody waits for."""
    monkeypatch.setattr(heavy, "AT_ONCE_S", 0.0)
    monkeypatch.setattr(diagnoses, "trace", slow_trace)
    LET_GO.unlink(missing_ok=True)
    yield imported(client, "SLOW-1", poses=30)
    LET_GO.unlink(missing_ok=True)


@pytest.fixture
def begun(page, go, expect, slow_run):
    """The page of that run, once the diagnosis has told how far it is."""
    go(f"#/runs/{slow_run['id']}")
    page.click("#diagnose")
    expect(page.locator("#diagnosis-says")).to_contain_text("40 % of the searches are done")
    expect(page.locator("#diagnosis-progress progress")).to_have_attribute("value", "0.4")
    expect(page.locator("#diagnose")).to_be_disabled()
    return page


def test_a_diagnosis_shows_how_far_it_is_and_is_found_again_by_who_was_away(
    begun, client, go, expect, slow_run
):
    go("#/")
    expect(begun.get_by_role("heading", name="Calibrate a unit")).to_be_visible()
    go(f"#/runs/{slow_run['id']}")
    expect(begun.locator("#diagnosis-says")).to_contain_text("40 %")
    begun.reload()
    expect(begun.locator("#diagnosis-says")).to_contain_text("40 %")
    LET_GO.touch()
    expect(begun.get_by_test_id("diagnosis-verdict")).to_be_visible()
    expect(begun.locator("#diagnosis-progress")).to_be_hidden()
    expect(begun.locator("#diagnose")).to_be_enabled()
    assert client.get(f"/api/runs/{slow_run['id']}/diagnosis").status_code == 200


def test_a_diagnosis_that_a_person_cancels_ends_and_may_be_asked_for_again(begun, client, expect, slow_run):
    path = f"/api/runs/{slow_run['id']}/diagnosis"
    begun.click("#diagnosis-cancel")
    expect(begun.locator("#diagnosis-state")).to_have_text("Cancelled: nothing was kept of it.")
    expect(begun.locator("#diagnosis-progress")).to_be_hidden()
    assert client.get(path).status_code == 404
    LET_GO.touch()
    begun.click("#diagnose")
    expect(begun.get_by_test_id("diagnosis-verdict")).to_be_visible()


def test_one_cancelled_before_the_service_has_named_it_is_given_up(
    page, go, client, expect, slow_run, monkeypatch
):
    monkeypatch.setattr(heavy, "AT_ONCE_S", 60.0)
    go(f"#/runs/{slow_run['id']}")
    page.click("#diagnose")
    expect(page.locator("#diagnosis-says")).to_contain_text("Searching all poses for effects")
    page.click("#diagnosis-cancel")
    expect(page.locator("#diagnosis-state")).to_have_text("Cancelled: nothing was kept of it.")
    LET_GO.touch()
    client.post("/api/imports", files={"file": ("p.csv", "x")}, data={"unit": "SLOW-2"})  # comes behind it
    assert client.get(f"/api/runs/{slow_run['id']}/diagnosis").status_code == 404
