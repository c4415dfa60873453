"""A certificate from a unit's page, the page on paper, and no view that shuts anybody out."""

from __future__ import annotations

import pytest
from support import wait_for

from .page_help import ambiguous_poses, imported, imported_lines, unfold

pytestmark = pytest.mark.browser


def test_how_a_unit_came_is_said_and_its_certificate_handed_out(page, client, go, expect):
    imported(client, "CERT-1")
    go("#/units/CERT-1")
    page.get_by_role("button", name="Customer and receipt…").click()
    page.get_by_label("Customer", exact=True).fill("ACME & Søn")
    page.get_by_label("stated by the customer: Customer", exact=True).check()
    page.get_by_label("Date of receipt", exact=True).fill("2026-11-01")
    page.get_by_test_id("confirm").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    item = client.get("/api/units/CERT-1/item").json()
    assert (item["customer"], item["received_at"], item["supplied"]) == (
        "ACME & Søn",
        "2026-11-01",
        ["customer"],
    )
    with page.expect_download() as download:
        page.get_by_role("button", name="Preview certificate (PDF)").click()
    assert download.value.path().read_bytes().startswith(b"%PDF-")


def test_a_certificate_is_issued_listed_and_corrected(page, client, go, expect):
    imported(client, "CERT-2")
    go("#/units/CERT-2")
    expect(page.locator("#revisions-table")).not_to_contain_text("[object")
    page.get_by_role("button", name="Issue certificate…").click()
    page.get_by_test_id("confirm").click()
    rows = page.locator("#certificates-table tbody tr")
    expect(rows).to_have_count(1)
    (first,) = client.get("/api/certificates", params={"unit": "CERT-2"}).json()
    expect(rows.first).to_contain_text(first["number"])
    with page.expect_download() as download:
        rows.first.get_by_role("link", name="PDF").click()
    assert download.value.path().read_bytes() == client.get(f"/api/certificates/{first['number']}").content
    rows.first.get_by_role("button", name="Correct…").click()
    page.get_by_label("Reason").fill("the customer's name")
    page.get_by_test_id("confirm").click()
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text(f"Replaces {first['number']}: the customer's name")
    expect(rows.last).to_contain_text("Replaced by")

    go("#/units")
    number = page.get_by_label("Certificate number")
    number.fill(first["number"][-6:].lower())
    number.press("Enter")
    found = page.locator("#certificates-found tbody tr")
    expect(found).to_have_count(1)
    expect(found).to_contain_text(first["number"])
    expect(found).to_contain_text("CERT-2")
    number.fill("%")
    number.press("Enter")
    expect(page.get_by_text("No certificate has this number")).to_be_visible()


def test_on_paper_there_are_no_controls_and_nothing_is_cut(page, client, go, expect):
    run = imported_lines(client, ambiguous_poses(), "PAPER-1")
    go(f"#/runs/{run['id']}")
    unfold(page, "charts")
    expect(page.locator(".plot .main-svg").first).to_be_visible()
    page.set_viewport_size({"width": 700, "height": 990})  # what A4 leaves between its margins
    page.emulate_media(media="print")

    def is_sized_for_paper():
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        return page.locator(".plot .main-svg[viewBox]").count()

    wait_for(is_sized_for_paper, "code that does it, which comes after the chart's")
    try:
        assert page.locator("button:visible, .frame:visible, .downloads:visible").count() == 0
        assert page.locator("main details:not([open])").count() == 0
        expect(page.locator("#poses-table")).to_be_visible()
        boxes = "boxes => boxes.filter(box => box.scrollHeight > box.clientHeight + 1).length"
        assert page.locator(".table-box").evaluate_all(boxes) == 0
        assert page.evaluate("document.documentElement.scrollWidth") <= 700
        widths = "all => all.map(svg => svg.getBoundingClientRect().right)"
        assert max(page.locator(".plot .main-svg").evaluate_all(widths)) <= 700
    finally:
        page.evaluate("window.dispatchEvent(new Event('afterprint'))")
        page.emulate_media(media="screen")
    assert page.locator(".plot .main-svg[viewBox]").count() == 0
    expect(page.locator("#poses-table")).to_be_hidden()  # as it was before
    go("#/units")
    page.emulate_media(media="print")
    expect(page.locator("#units-table")).to_be_visible()
    expect(page.locator(".frame")).to_be_hidden()
    page.emulate_media(media="screen")


def test_axe_finds_nothing_on_any_view(page, client, go, expect):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed").Axe()
    run = imported_lines(client, ambiguous_poses(), "AXE-1")
    imported(client, "AXE-1", bias_deg=0.7)
    views = {
        "": "#runs-table tbody tr",
        "units": "#units-table",
        "units/AXE-1": "#sha256",
        f"runs/{run['id']}": "#next .primary",
        "compare?unit=AXE-1": "#compare-table",
        "noise": "main form",
        "limits": "#limits-form",
        "import": "#import",
        "trail": "#trail-table tbody tr",
        "users": "main form",
        "rigs/bench-1": "#check-title",
        "solve": "main form",
    }
    for view, loaded in views.items():
        go(f"#/{view}")
        expect(page.locator(loaded).first).to_be_visible()
        page.locator("main details").evaluate_all("all => all.forEach(one => (one.open = true))")
        found = axe.run(page)
        assert found.violations_count == 0, f"{view}: {found.generate_report()}"
