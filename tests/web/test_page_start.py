"""The first page: serial, rig, a plan of one line, Start; and what helps where a run does not complete."""

from __future__ import annotations

import pytest
from support import LONG, ended

from .page_help import unfold_plan

pytestmark = pytest.mark.browser


@pytest.fixture
def forgiven():
    return ["status of 409"]


def test_the_plan_is_one_line_with_its_presets_and_fields_folded_behind_it(page, go, expect):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed").Axe()
    go("#/")
    line = page.locator("#plan-summary")
    expect(line).to_contain_text("52 poses, −60° to 60°, about")
    for field in ("#start_deg", "#sweeps", "#preset-quick", "#operator", "#note"):
        expect(page.locator(field)).to_be_hidden()
    unfold_plan(page)
    expect(page.locator("#preset-standard")).to_have_attribute("aria-pressed", "true")
    page.click("#preset-quick")
    expect(line).to_contain_text("14 poses")
    page.click("#preset-three-mounts")
    expect(line).to_contain_text("156 poses, −60° to 60°, jitter ±5°, about")
    expect(page.locator("#jitter_deg")).to_have_value("5")
    expect(page.locator("#jitter-why")).to_be_visible()
    assert axe.run(page).violations_count == 0
    page.fill("#sweeps", "3")
    expect(page.locator(".presets [aria-pressed=true]")).to_have_count(0)


def test_a_field_behind_the_line_that_is_refused_is_unfolded(page, client, go, expect):
    go("#/")
    page.fill("#unit", "S-FOLD")
    unfold_plan(page)
    page.fill("#sweeps", "")
    unfold_plan(page)
    expect(page.locator("#sweeps")).to_be_hidden()
    page.click("#start")
    expect(page.locator("#sweeps")).to_be_focused()
    assert client.get("/api/runs?unit=S-FOLD").json()["items"] == []


def test_jitter_that_several_mounts_switch_on_is_seen_beside_the_range(page, go, expect):
    go("#/?mounts=0,120")
    expect(page.locator("#plan-summary")).to_contain_text("jitter ±5°")
    unfold_plan(page)
    expect(page.locator("#jitter_deg")).to_be_visible()


def test_a_busy_rig_links_its_run_and_offers_the_queue(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "S-1", "plan": LONG}).raise_for_status().json()
    go("#/")
    page.fill("#unit", "S-2")
    page.click("#start")
    busy = page.locator("#rig-busy")
    expect(busy).to_contain_text("Rig bench-1 is busy with run")
    expect(busy.get_by_role("link")).to_have_attribute("href", f"#/runs/{run['id']}")
    page.click("#queue-run")
    page.wait_for_url("**/#/runs/*")
    expect(page.locator("#status")).to_have_text("queued")
    waiting = client.get("/api/runs?unit=S-2").json()["items"]
    assert [one["status"] for one in waiting] == ["queued"]
    client.post(f"/api/runs/{waiting[0]['id']}/abort").raise_for_status()


def test_a_run_that_did_not_complete_is_started_again_as_it_was(page, client, go, expect):
    body = {"unit": "S-3", "plan": {**LONG, "settle_s": 1.5}, "note": "second try"}
    run = client.post("/api/runs", json=body).raise_for_status().json()
    client.post(f"/api/runs/{run['id']}/abort").raise_for_status()
    assert ended(client, run["id"])["status"] == "aborted"
    go(f"#/runs/{run['id']}")
    page.click("#start-again")
    expect(page.locator("#unit")).to_have_value("S-3")
    expect(page.locator("#rig")).to_have_value("bench-1")
    expect(page.locator("#settle_s")).to_have_value("1.5")
    expect(page.locator("#note")).to_have_value("second try")
    page.click("#start")
    page.wait_for_url(lambda url: "/runs/" in url and run["id"] not in url)
    again = client.get(f"/api/runs/{page.url.rpartition('/')[2]}").json()
    assert (again["unit"], again["note"]) == ("S-3", "second try")
    assert {**again["plan"], "seed": 0} == {**run["plan"], "seed": 0}


def test_start_beside_a_designed_plan_that_is_not_in_use_asks(page, client, go, expect):
    go("#/")
    page.fill("#unit", "S-4")
    unfold_plan(page)
    page.locator("#designer > summary").click()
    page.fill("#time_s", "300")
    page.click("#design")
    expect(page.locator("#use-plan")).to_be_visible()
    page.click("#start")
    expect(page.locator("dialog")).to_contain_text("Start without the designed plan?")
    page.keyboard.press("Escape")
    expect(page.locator("dialog")).to_have_count(0)
    assert client.get("/api/runs?unit=S-4").json()["items"] == []
    page.click("#use-plan")
    page.click("#start")
    page.wait_for_url("**/#/runs/*")
    assert len(client.get("/api/runs?unit=S-4").json()["items"]) == 1


def test_solve_is_in_the_menu(page, go, expect):
    go("#/")
    page.get_by_role("navigation", name="Main").get_by_role("link", name="Solve").click()
    expect(page.locator("h1")).to_have_text("Separate errors of stage and units")
