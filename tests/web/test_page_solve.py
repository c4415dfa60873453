"""Stage and units solved together on the page: from runs of a unit to its map; what one mount cannot tell."""

from __future__ import annotations

import json

import pytest
from clamped import clamped
from support import wait_for

from .page_help import figures_of, row_of, unfold

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def runs(client):
    """Of unit CLAMPED-3, at three angles."""
    return [clamped(client, "CLAMPED-3", angle)["id"] for angle in (0, 120, 240)]


@pytest.fixture
def forgiven():
    return [r"404 \(Not Found\)"]


def test_runs_of_a_unit_are_solved_from_its_page(page, client, go, expect, runs):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed").Axe()
    go("#/units/CLAMPED-3")
    page.get_by_role("link", name="Separate errors of stage and unit").click()
    ticked = page.locator("#solve-runs input:checked")
    expect(ticked).to_have_count(3)
    assert axe.run(page).violations_count == 0
    page.get_by_role("button", name="None").click()
    page.click("#solve")
    expect(page.locator("#solve-error")).to_contain_text("at least one run")
    for run_id in runs:
        page.locator(f"#solve-runs input[value='{run_id}']").check()
    page.click("#solve")
    expect(page.get_by_test_id("solve-verdict")).to_contain_text("Stage and units are separable.")
    expect(page.locator(".plot .plot-container")).to_have_count(3)
    found = client.get(f"/api/solve/{page.url.split('/')[-1]}").json()
    assert found["runs"] == runs[::-1], "the newest first, as they are listed"
    assert row_of(page, "#mounts", "240°")["Fitted"].startswith("240.")
    assert figures_of(page, ".solution")["Level"].startswith("not known")
    assert axe.run(page).violations_count == 0
    with page.expect_download() as download:
        page.get_by_role("link", name="Calibration (JSON)").click()
    assert json.loads(download.value.path().read_text(encoding="utf-8"))["unit"] == "CLAMPED-3"
    here = page.url
    for view in ("#/units/CLAMPED-3", f"#/runs/{runs[0]}"):
        go(view)
        if view.startswith("#/runs/"):
            unfold(page, "files")
        page.locator(".solutions a").first.click()
        page.wait_for_url(here)
    page.get_by_role("button", name="Draft a calibration of CLAMPED-3…").click()
    page.get_by_test_id("confirm").click()
    expect(page.locator("[data-unit='CLAMPED-3'] [role=status]")).to_contain_text("Revision 4 (in force)")
    older = {"status": 404, "json": {"detail": "Not Found"}}
    page.route("**/api/rigs/bench-1/map", lambda route: route.fulfill(**older))
    page.click("#use-map")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#ask-error")).to_contain_text("stores no maps")


def test_one_mount_leads_to_a_run_with_those_that_help(page, client, go, expect):
    clamped(client, "CLAMPED-1", 0)
    go("#/solve?rig=bench-1&unit=CLAMPED-1")
    page.set_viewport_size({"width": 390, "height": 844})
    page.click("#solve")
    expect(page.get_by_test_id("solve-verdict")).to_contain_text("not separable by these poses")
    expect(page.locator("#use-map")).to_have_count(0)
    expect(page.locator(".plot .plot-container")).to_have_count(3)
    narrow = "document.documentElement.scrollWidth <= 390"
    wait_for(lambda: page.evaluate(narrow), "page as narrow as the phone")
    page.get_by_role("link", name="Start a run with these mounts").click()
    expect(page.get_by_role("heading", name="Calibrate a unit")).to_be_visible()
    assert "?mounts=0%2C120%2C240&rig=bench-1&unit=CLAMPED-1" in page.url
    go("#/rigs/bench-1")
    page.get_by_role("link", name="Separate errors of stage and units").click()
    expect(page.locator("#solutions-table tbody tr").first).to_contain_text("CLAMPED-1")
