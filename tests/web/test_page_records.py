"""What was measured, as a person finds, compares, amends and imports it on the page."""

from __future__ import annotations

import csv
import json

import pytest
from support import DATA

from calrig.export.archive.check import check_archive

from .page_help import figures_of, imported, row_of, unfold

pytestmark = pytest.mark.browser


WARMUP = DATA / "mpu6050_warmup_poses.csv"
REFUSED_422 = r"status of 422"


def test_units_are_compared_with_their_errors(page, client, go, expect):
    first, second = imported(client, "C/1", bias_deg=0.5), imported(client, "D-2", bias_deg=-0.3)
    imported(client, "D-2", bias_deg=-0.31)
    go("#/compare")
    page.get_by_label("C/1", exact=True).check()
    page.get_by_label("D-2", exact=True).check()
    page.get_by_role("button", name="Compare").click()
    page.wait_for_url("**/#/compare?unit=C%2F1&unit=D-2")
    row = page.locator("#compare-table tbody tr").filter(has_text="C/1")
    std = first["result"]["bias_std_deg"]
    decimals = 1 - int(f"{std:e}".split("e")[1])
    expect(row).to_contain_text(f"{first['result']['bias_deg']:.{decimals}f} ± {std:.{decimals}f}°")
    expect(page.locator("#compare-table tbody tr")).to_have_count(2)
    expect(page.get_by_test_id("spread")).to_contain_text("between units")
    for chart in ("residuals", "bias", "scale", "rms"):
        expect(page.get_by_test_id(f"compare-{chart}").locator(".plot-container")).to_be_visible()
    assert second["unit"] == "D-2"


def test_the_error_before_and_after_calibration_stand_each_under_its_own_name(page, client, go, expect):
    result = imported(client, "NAMED")["result"]
    assert result["rms_raw_deg"] > 10 * result["rms_calibrated_deg"]
    named = {
        "RMS error, raw": f"{result['rms_raw_deg']:#.3g}°",
        "RMS error, calibrated": f"{result['rms_calibrated_deg']:#.3g}°",
    }
    go("#/")
    expect(page.locator("#runs-table")).to_contain_text("NAMED")
    assert named.items() <= row_of(page, "#runs-table", "NAMED").items()
    page.locator("#runs-table tr", has_text="NAMED").get_by_role("link").first.click()
    expect(page.locator("#result")).to_contain_text("Bias")
    assert named.items() <= figures_of(page, "#result").items()
    go("#/compare?unit=NAMED")
    expect(page.locator("#compare-table")).to_contain_text("NAMED")
    assert named.items() <= row_of(page, "#compare-table", "NAMED").items()


def test_a_run_is_voided_with_a_reason_and_stays_struck_through(page, client, go, expect):
    run = imported(client, "VOIDED")
    go(f"#/runs/{run['id']}")
    unfold(page, "amend")
    page.click("#void")
    page.get_by_test_id("confirm").click()  # no reason yet: the browser asks for one
    expect(page.locator("dialog")).to_be_visible()
    page.fill("#reason", "the cable caught")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#void-reason")).to_contain_text("the cable caught")
    expect(page.locator("h1")).to_have_css("text-decoration-line", "line-through")
    assert client.get(f"/api/runs/{run['id']}").json()["voided"]["reason"] == "the cable caught"
    go("#/")
    link = page.get_by_role("link", name="VOIDED", exact=True)
    expect(page.locator("#runs-table tr.voided").filter(has=link)).to_have_count(1)
    go("#/compare?unit=VOIDED")
    expect(page.locator("#compare-table")).to_contain_text("no valid completed run")


def test_an_excluded_pose_changes_the_result_and_dates_the_diagnosis(page, client, go, expect):
    run = imported(client, "EXCLUDING", poses=24)
    client.post(f"/api/runs/{run['id']}/diagnosis", json={}).raise_for_status()
    go(f"#/runs/{run['id']}")
    unfold(page, "poses")
    page.get_by_role("button", name="Exclude pose 7").click()
    page.fill("#reason", "bumped")
    page.get_by_test_id("confirm").click()
    row = page.locator("#poses-table tr[data-pose='7']")
    expect(row).to_contain_text("excluded: bumped")
    expect(row.locator("th")).to_have_css("text-decoration-line", "line-through")
    result = client.get(f"/api/runs/{run['id']}").json()["result"]
    assert result["n_poses"] == 23
    expect(page.locator("#result")).to_contain_text(f"{result['rms_raw_deg']:#.3g}°")
    expect(page.locator("#diagnosis-state")).to_contain_text("Diagnose again")


@pytest.mark.skipif(not WARMUP.exists(), reason=f"{WARMUP} is not there (set CALRIG_DATA)")
def test_a_measured_file_becomes_a_run_whose_scale_cannot_be_known(page, client, go, expect):
    go("#/import")
    page.set_input_files("#file", WARMUP)
    page.fill("#unit", "FreeIMU")
    page.click("#import")
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("#result")).to_contain_text("not known")
    expect(page.get_by_test_id("verdict")).to_contain_text("one elevation")
    with WARMUP.open(newline="") as file:
        n_poses = sum(1 for _ in csv.DictReader(file))
    expect(page.locator("#poses-title")).to_have_text(f"Poses ({n_poses})")


def test_an_import_with_a_stated_reference_has_an_uncertainty_and_a_revision(page, client, go, expect):
    go("#/import")
    rows = "".join(f"{x},{0.8 + 0.998 * x + 0.01 * (-1) ** x},{0.01}\n" for x in range(-45, 46, 9))
    content = f"target_deg,reading_deg,reading_stderr_deg\n{rows}".encode()
    page.set_input_files("#file", {"name": "own.csv", "mimeType": "text/csv", "buffer": content})
    page.fill("#unit", "STATED")
    page.get_by_label("Reference uncertainty (°)").fill("0.05")
    page.get_by_label("Kind of reference error").select_option("common")
    page.click("#import")
    expect(page.locator("#status")).to_have_text("completed")
    run = client.get("/api/runs?unit=STATED").json()["items"][0]
    reference = run["result"]["reference"]
    assert (reference["std_deg"], reference["kind"]) == (0.05, "common")
    document = client.get("/api/units/STATED/calibration?revision=latest").json()
    assert document["expanded_uncertainty_deg"] > 0.05


def test_a_bad_file_is_refused_with_line_and_column_and_nothing_is_stored(page, client, go, expect, forgiven):
    forgiven.append(REFUSED_422)
    go("#/import")
    content = b"target_deg,reading_deg\n0,0.1\n10,ten\n"
    page.set_input_files("#file", {"name": "bad.csv", "mimeType": "text/csv", "buffer": content})
    page.fill("#unit", "BAD")
    page.click("#import")
    expect(page.locator("#import-error")).to_contain_text("line 3")
    expect(page.locator("#import-error")).to_contain_text("reading_deg")
    assert client.get("/api/runs?unit=BAD").json()["items"] == []


def test_a_serial_number_is_text_wherever_it_is_shown_and_leads_to_its_unit(page, client, go, expect):
    serial = '<img src="x" onerror="document.title=1">/&amp;?#%'
    imported(client, serial)
    go("#/units")
    page.get_by_role("link", name=serial, exact=True).click()
    expect(page.locator("h1")).to_have_text(f"Unit {serial}")
    expect(page.get_by_test_id("history").locator(".plot-container")).to_be_visible()
    with page.expect_download() as download:
        page.click("#calibration-json")
    assert json.loads(download.value.path().read_text())["unit"] == serial
    with page.expect_download() as download:
        page.click("#certificate-dcc")
    assert download.value.suggested_filename.endswith("-1.xml")
    with page.expect_download() as download:
        page.click("#archive")
    found = check_archive(download.value.path())
    assert (found.problems, found.unit) == ([], serial)
    page.get_by_role("link", name="Compare with other units").click()
    expect(page.locator("#compare-table tbody th")).to_have_text(serial)
    expect(page.get_by_test_id("compare-bias").locator(".legendtext")).to_have_text(serial)
    assert page.locator("main img").count() == 0


def test_runs_are_found_by_a_part_of_their_serial_or_note_and_the_way_back_keeps_what_was_sought(
    page, client, go, expect
):
    first, _ = imported(client, "FOUND-1"), imported(client, "ANOTHER")
    imported(client, "FOUND-2", rig="bench-1")
    client.post(f"/api/runs/{first['id']}/note", json={"note": "Gehäuse offen"}).raise_for_status()
    go("#/?unit=AS-7")
    expect(page.locator("#unit")).to_be_focused()
    rows = page.locator("#runs-table tbody tr")
    expect(rows.filter(has_text="ANOTHER")).to_have_count(1)
    page.fill("#filter-text", "found-")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("import")
    page.select_option("#filter-rig", "bench-1")
    expect(rows).to_have_count(1)
    page.select_option("#filter-verdict", "pass")
    expect(page.get_by_text("No run matches.")).to_be_visible()
    page.select_option("#filter-verdict", "")
    page.select_option("#filter-rig", "")
    page.fill("#filter-text", "GEHÄUSE")
    page.fill("#filter-from", first["created_at"][:10])
    expect(rows).to_have_count(1)
    rows.get_by_role("link").first.click()
    expect(page.locator("h1")).to_contain_text("FOUND-1")
    page.go_back()
    expect(rows).to_have_count(1)
    expect(page.locator("#filter-text")).to_have_value("GEHÄUSE")
    expect(page.locator("#unit")).to_have_value("AS-7")
    page.fill("#filter-from", "")
    page.fill("#filter-to", "2020-01-01")
    expect(page.get_by_text("No run matches.")).to_be_visible()
