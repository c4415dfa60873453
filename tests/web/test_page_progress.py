"""What takes long, on the page: how far it is, its end on request, and that it is found again."""

from __future__ import annotations

import logging
from threading import Event

import pytest
from support import PATIENCE_S, wait_for

from calrig.analysis import diagnoses
from calrig.api import jobs, noise, solve
from calrig.api.errors import CLIENT_LEFT

from .page_help import cancelled_by_who_comes_back, imported
from .slow_work import LET_GO, slow_design, slow_study, slow_trace

IMPORT = "**/api/imports?wait=false"
pytestmark = pytest.mark.browser


@pytest.fixture
def slow(monkeypatch):
    """What goes on until LET_GO is there, and nobody waits for."""
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    monkeypatch.setattr(diagnoses, "traced", slow_trace)
    monkeypatch.setattr(noise, "study_file", slow_study)
    monkeypatch.setattr(solve, "answer", slow_design)
    LET_GO.unlink(missing_ok=True)
    yield
    LET_GO.unlink(missing_ok=True)


@pytest.fixture
def slow_run(client, slow):
    """A run whose diagnosis takes so long."""
    return imported(client, "SLOW-1", poses=30)


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
    expect(begun.locator("#diagnosis-fold")).to_be_visible()
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
    expect(begun.locator("#diagnosis-fold")).to_be_visible()


def test_one_cancelled_before_the_service_has_named_it_is_given_up(
    page, go, client, expect, slow_run, monkeypatch, caplog
):
    caplog.set_level(logging.INFO, "calrig.api.origin_check")
    monkeypatch.setattr(jobs, "AT_ONCE_S", PATIENCE_S)
    received, answer = Event(), jobs.BackgroundWork.answer

    def noting(*args, **options):
        received.set()
        return answer(*args, **options)

    monkeypatch.setattr(jobs.BackgroundWork, "answer", noting)
    go(f"#/runs/{slow_run['id']}")
    page.click("#diagnose")
    expect(page.locator("#diagnosis-says")).to_contain_text("Searching all poses for effects")
    assert received.wait(PATIENCE_S), "a request that the browser gives up before it is sent, no service sees"
    page.click("#diagnosis-cancel")
    expect(page.locator("#diagnosis-state")).to_have_text("Cancelled: nothing was kept of it.")
    wait_for(
        lambda: f"/diagnosis: {CLIENT_LEFT}" in caplog.text, "the service's word that nobody waits for it"
    )
    LET_GO.touch()
    assert client.get(f"/api/runs/{slow_run['id']}/diagnosis").status_code == 404


def test_a_joint_solution_that_a_person_cancels_keeps_nothing(page, client, go, expect, slow_run):
    before = client.get("/api/solve").json()
    go(f"#/solve?rig=&run={slow_run['id']}")
    page.click("#solve")
    expect(page.locator("#solve-says")).to_contain_text("40 % of it is done")
    page.click("#solve-cancel")  # named by the service or not yet: what is seen of it is the same
    expect(page.locator("#solve-suggestion")).to_have_text("Cancelled: nothing was kept of it.")
    expect(page.locator("#solve")).to_be_enabled()
    assert client.get("/api/solve").json() == before


def test_a_log_shows_how_much_of_it_is_done_and_is_cancelled_by_who_comes_back(
    page, client, go, expect, slow
):
    before = client.get("/api/log-studies").json()
    go("#/noise")
    page.set_input_files("#log", {"name": "log.csv", "mimeType": "text/csv", "buffer": b"accel_x_g\n0.1\n"})
    page.click("#analyse")
    cancelled_by_who_comes_back(page, expect, "log")
    assert client.get("/api/log-studies").json() == before


@pytest.fixture
def sending(page, go, expect):
    """A file that a person has sent, up to a request of the browser."""

    def sending(up_to):
        go("#/import")
        page.set_input_files(
            "#file", {"name": "p.csv", "mimeType": "text/csv", "buffer": b"target_deg,reading_deg\n"}
        )
        page.fill("#unit", "TAKEN-BACK")
        with page.expect_request(up_to):
            page.click("#import")
        expect(page.locator("#import-says")).to_contain_text("Sending the file: 0 % of it is sent.")

    return sending


def test_a_file_on_its_way_is_taken_back(page, expect, sending):
    page.route(IMPORT, lambda route: None)  # a service that is slow to take it
    sending(IMPORT)
    page.click("#import-cancel")
    expect(page.locator("#import-told")).to_have_text("Cancelled: nothing was kept of it.")
    expect(page.locator("#import")).to_be_enabled()


def test_a_file_that_waits_for_the_code_that_sends_it_is_taken_back(page, expect, sending):
    asked, code = [], []
    page.route(IMPORT, lambda route: asked.append(route))  # noqa: PLW0108 (Playwright marks handlers)
    page.route("**/upload.js", lambda route: code.append(route))  # noqa: PLW0108
    sending("**/upload.js")
    page.click("#import-cancel")
    code[0].continue_()
    expect(page.locator("#import-told")).to_have_text("Cancelled: nothing was kept of it.")
    assert asked == []
