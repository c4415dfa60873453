"""Issued calibrations on a unit's page: what is in force, what changed since, release and withdrawal."""

from __future__ import annotations

import json

import pytest
from dummy_format import added_format

from .page_help import figures_of, imported

pytestmark = pytest.mark.browser


def in_force(client, unit):
    return client.get(f"/api/units/{unit}/calibration").json()


def confirm(page, reason):
    page.get_by_label("Reason").fill(reason)
    page.get_by_test_id("confirm").click()


def test_page_and_file_show_the_same_revision_after_effects_and_exclusions(
    page, client, go, expect, forgiven
):
    run = imported(client, "ONE-1")
    client.post(f"/api/runs/{run['id']}/poses/2/exclude", json={"reason": "knocked"}).raise_for_status()
    go("#/units/ONE-1")
    expect(page.locator("#sha256")).to_have_text(in_force(client, "ONE-1")["sha256"])
    shown = figures_of(page, "#calibration")
    document = in_force(client, "ONE-1")
    assert (shown["Revision"], document["revision"]) == ("2", 2)
    assert shown["Bias"].startswith(f"{document['bias_deg']:.4f} ± ")
    assert shown["Scale"].startswith(f"{document['scale']:.5f} ± ")
    with page.expect_download() as download:
        page.locator("#calibration-json").click()
    assert json.loads(download.value.path().read_text()) == document
    forgiven.append(r"409 \(Conflict\)")
    page.locator("[data-format='px4']").click()
    expect(page.locator("#format-refused")).to_contain_text("bias and scale of an angle")
    row = page.locator("#revisions-table [data-revision='2']")
    expect(row).to_contain_text("pose 2 of run")
    expect(page.locator("#revisions-table [data-revision='1']")).to_contain_text("superseded")


def test_a_format_that_the_service_knows_is_a_button_and_saved_under_its_name(
    page, client, go, expect, tmp_path
):
    imported(client, "FORMATS-1")
    with added_format(tmp_path):
        go("#/units/FORMATS-1")
        button = page.locator("[data-format='dummy-ini']")
        expect(button).to_have_text("Dummy program")
        with page.expect_download() as download:
            button.click()
    assert download.value.suggested_filename == "dummy.ini"
    assert download.value.path().read_text() == f"bias = {in_force(client, 'FORMATS-1')['bias_deg']:.3f}"


def test_there_is_a_way_back_and_each_step_has_a_reason(page, client, go, expect):
    imported(client, "BACK-1")
    imported(client, "BACK-1", bias_deg=0.7)
    go("#/units/BACK-1")
    first = page.locator("#revisions-table [data-revision='1']")
    first.get_by_role("button", name="Release…").click()
    confirm(page, "the clamp was loose in run 2")
    expect(first).to_contain_text("in force")
    expect(page.locator("#calibration")).to_contain_text("0.5")
    assert in_force(client, "BACK-1")["revision"] == 1
    first.get_by_role("button", name="Withdraw…").click()
    confirm(page, "wrong after all")
    expect(page.locator("#calibration")).to_contain_text("None")
    assert client.get("/api/units/BACK-1/calibration").status_code == 404
    assert [r["status"] for r in client.get("/api/units/BACK-1/calibrations").json()] == [
        "superseded",
        "withdrawn",
    ]


def test_a_person_sees_why_a_draft_was_not_released_and_releases_it_with_a_reason(page, client, go, expect):
    imported(client, "DOUBT-1")
    run = imported(client, "DOUBT-1", bias_deg=6.5)
    says = run["result"]["doubts"][0]["says"]
    go(f"#/runs/{run['id']}")
    expect(page.get_by_test_id("verdict")).to_contain_text(says)
    expect(page.get_by_test_id("verdict")).to_contain_text("reason")
    expect(page.get_by_test_id("answer")).to_contain_text("NOT GOOD")
    page.get_by_role("link", name="Review the draft").click()
    waiting = page.get_by_test_id("draft-warnings")
    expect(waiting).to_contain_text("Revision 2 is a draft")
    expect(waiting).to_contain_text("Revision 1 stays in force until then")
    expect(waiting).to_contain_text(says)
    expect(page.locator("#revisions-table [data-revision='2']")).to_contain_text(says)
    waiting.get_by_role("button", name="Release…").click()
    expect(page.get_by_role("dialog")).to_contain_text(says)
    confirm(page, "the sensor was glued in anew")
    expect(page.locator("#revisions-table [data-revision='2']")).to_contain_text("in force")
    expect(waiting).to_have_count(0)
    assert in_force(client, "DOUBT-1")["revision"] == 2
    released = client.get("/api/calibrations").json()[-1]
    assert (released["what"], released["reason"]) == ("released", "the sensor was glued in anew")
    assert says in released["warnings"]


def test_the_page_says_what_the_revision_in_force_rests_on_that_has_changed(page, client, go, expect):
    run = imported(client, "STALE-1")
    client.post(f"/api/runs/{run['id']}/void", json={"reason": "wrong stage"}).raise_for_status()
    go("#/units/STALE-1")
    expect(page.get_by_test_id("stale")).to_contain_text("has been voided: wrong stage")
    expect(page.locator("#calibration")).to_contain_text(in_force(client, "STALE-1")["sha256"])
