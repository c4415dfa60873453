"""The page designs a plan for an uncertainty, shows what is to be expected of it, and the form takes it."""

from __future__ import annotations

import pytest

from calrig.api import jobs, plans

from .slow_work import LET_GO, slow_answer

pytestmark = pytest.mark.browser

PHONE = {"width": 390, "height": 800}


def test_a_plan_is_designed_taken_by_the_form_and_ends_once_it_is_good_enough(
    page, client, go, expect, forgiven
):
    forgiven.append("status of 422")
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    go("#/")
    page.set_viewport_size(PHONE)
    page.fill("#unit", "AS-D")
    page.locator("#designer summary").click()
    page.fill("#target_u_deg", "0.1")
    page.press("#target_u_deg", "Enter")
    expect(page.locator("#design-refused")).to_contain_text("stage")
    page.fill("#target_u_deg", "0.55")
    page.check("#stop-early")
    page.uncheck("#may-sweep")  # of a rig whose time runs faster than its machine's
    page.click("#design")
    expect(page.locator("#designed")).to_contain_text("Lower bound of the time")
    expect(page.locator("#design-suspects tbody tr")).to_have_count(9)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    found = axe.Axe().run(page, context="#designer")
    assert found.violations_count == 0, found.generate_report()
    page.click("#use-plan")
    expect(page.locator("#plan-summary")).to_contain_text("28 poses, at most about")
    page.fill("#settle_s", "0.3")
    page.click("#start")
    expect(page.locator("#status")).to_have_text("completed")
    run = client.get(f"/api/runs/{page.url.rpartition('/')[2]}").json()
    assert run["plan"]["until"]["expanded_uncertainty_deg"] == 0.55
    assert run["result"]["stopped_by"] == "until"
    assert run["result"]["n_poses"] < 28


def test_a_design_that_takes_long_shows_how_far_it_is_and_may_be_cancelled(page, go, expect, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    monkeypatch.setattr(plans, "answer", slow_answer)
    LET_GO.unlink(missing_ok=True)
    go("#/")
    page.locator("#designer summary").click()
    page.fill("#time_s", "900")
    page.click("#design")
    expect(page.locator("#design-says")).to_contain_text("40 % of the designs are tried")
    page.click("#design-cancel")
    expect(page.locator("#designed")).to_have_text("Cancelled.")
    expect(page.locator("#design-progress")).to_be_hidden()
    LET_GO.touch()
    page.click("#design")
    expect(page.locator("#designed")).to_contain_text("traverses")
    LET_GO.unlink()
    page.click("#use-plan")
    expect(page.locator("#as-turns")).to_be_checked()
    expect(page.locator("#plan-summary")).to_contain_text("poses, about")
