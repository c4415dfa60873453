"""Limits on the page: written, put in order, refused where they stand, and in the verdict of a run."""

from __future__ import annotations

import pytest

from .page_help import imported

pytestmark = [pytest.mark.browser, pytest.mark.usefixtures("no_limits")]

REFUSED_422 = r"status of 422"


def fill_in(page, place, **figures):
    for key, value in figures.items():
        page.fill(f'[name="[{place}].{key}"]', str(value))


def kept(client):
    return [one["name"] for one in client.get("/api/limits").json()]


def test_limits_are_added_put_in_order_and_removed(page, client, go, expect):
    go("#/limits")
    expect(page.locator("#limits")).to_contain_text("No limits")
    page.click("#add-limit")
    expect(page.locator('[name="[0].name"]')).to_be_focused()
    fill_in(page, 0, name="flight", units="AS-*", max_error_deg=0.6)
    page.click("#add-limit")
    fill_in(page, 1, name="all", **{"scale[0]": 0.9, "scale[1]": 1.1})
    page.select_option('[name="[1].rule"]', "simple")
    expect(page.locator('[name="[1].guard"]')).to_be_hidden()
    page.click("#save-limits")
    expect(page.locator("#limits-saved")).to_contain_text("Saved")
    flight, everything = client.get("/api/limits").json()
    assert (flight["units"], flight["max_error_deg"], flight["rule"], flight["guard"]) == (
        "AS-*",
        0.6,
        "guarded",
        1,
    )
    assert (everything["units"], everything["scale"], everything["rule"]) == ("*", [0.9, 1.1], "simple")

    page.get_by_role("button", name="Move up: limit 2").click()
    expect(page.locator("#limits-saved")).to_be_empty()
    page.click("#save-limits")
    expect(page.locator("#limits-saved")).to_contain_text("Saved")
    assert kept(client) == ["all", "flight"]
    go("#/limits")
    page.get_by_role("button", name="Remove: limit 1").click()
    page.click("#save-limits")
    expect(page.locator("#limits-saved")).to_contain_text("Saved")
    assert kept(client) == ["flight"]


def test_a_limit_that_cannot_be_is_marked_where_it_stands(page, client, go, expect, forgiven):
    forgiven.append(REFUSED_422)
    client.put("/api/limits", json=[{"name": "first", "rms_deg": 1.0}])
    go("#/limits")
    page.click("#add-limit")
    fill_in(page, 1, name="second", rms_deg=-1)
    page.click("#save-limits")
    expect(page.locator("#limits-error")).to_have_text("RMS error of limit 2 must be greater than 0")
    wrong = page.locator('[name="[1].rms_deg"]')
    expect(wrong).to_have_attribute("aria-invalid", "true")
    expect(wrong).to_be_focused()
    expect(page.locator('[name="[0].rms_deg"]')).not_to_have_attribute("aria-invalid", "true")
    fill_in(page, 1, rms_deg=1, **{"bias_deg[0]": 0.5})
    page.click("#save-limits")
    expect(page.locator("#limits-error")).to_have_text("Entry 2 of bias of limit 2 is not a number")
    expect(page.locator('[name="[1].bias_deg[1]"]')).to_be_focused()
    fill_in(page, 1, name="first", **{"bias_deg[0]": ""})
    page.click("#save-limits")
    expect(page.locator("#limits-error")).to_contain_text("Limit 2 is named 'first' like another one")
    expect(page.locator('[name="[1].name"]')).to_be_focused()
    assert kept(client) == ["first"]


def test_the_verdict_of_a_run_is_coloured_by_its_answer_and_says_what_the_api_says(page, client, go, expect):
    client.put("/api/limits", json=[{"name": "strict", "scale": [0.9, 1.0]}])
    run = imported(client, "LIMITED", scale=1.01)
    said = client.get(f"/api/runs/{run['id']}").json()["verdict"]
    go(f"#/runs/{run['id']}")
    verdict = page.get_by_test_id("verdict")
    expect(verdict.locator("p")).to_have_text(said["says"])
    expect(verdict.locator("p").first).to_have_text("Fail against the limits “strict” (simple rule).")
    assert "poor" in verdict.get_attribute("class").split()


def test_that_no_unit_can_pass_is_said_in_the_form_before_it_starts(page, client, go, expect):
    limit = {"name": "tight", "units": "AS-*", "max_error_deg": 0.1, "rule": "guarded"}
    client.put("/api/limits", json=[limit])
    go("#/")
    page.fill("#unit", "AS-1")
    expect(page.locator("#plan-warnings")).to_be_hidden()
    page.focus("#rig")
    expect(page.locator("#plan-warnings")).to_contain_text("No unit can pass on this stage")
    page.fill("#unit", "B-1")
    page.focus("#rig")
    expect(page.locator("#plan-warnings")).to_be_hidden()
