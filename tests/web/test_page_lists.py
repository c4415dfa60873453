"""Lists, tables and time axes: two hundred units, filters in the address, what fits desk and phone."""

from __future__ import annotations

import csv
from datetime import UTC, datetime

import pytest
from dated_runs import FIRST_DAY, gave, lay
from support import LONG, ended, running_service, serving, wait_for

from .page_help import imported, line_x, readings, row_of, unfold

pytestmark = pytest.mark.browser

LIMIT = {"name": "flight", "units": "AS-*", "scale": [0.99, 1.02]}
PHONE = {"width": 390, "height": 844}
WIDER = """() => [...document.querySelectorAll("main .table-box")]
    .filter(box => box.scrollWidth > box.clientWidth + 1).map(box => box.ariaLabel)"""
REASON = "the cable caught on the clamp while the stage was turning, seen on the camera afterwards"


@pytest.fixture(scope="module")
def client(rig, tmp_path_factory):
    """A service with two hundred units; the last of them failed today, `REV-SIX` has seven revisions."""
    path = tmp_path_factory.mktemp("lists") / "calrig.db"
    today = (datetime.now(UTC) - FIRST_DAY).total_seconds() / 86_400
    days = [today - 500 + k if k < 100 else today - 400 + 2 * k for k in range(197)]
    with running_service(path, rig) as service, serving(service) as client:
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        lay(
            service.store,
            *((f"BT-{k:03}", day - 1, gave(0.5 + k / 100, 1.001), {}) for k, day in enumerate(days)),
        )
        for unit, scale in (("AS-PASS", 1.0), ("AS-FAIL", 1.2)):
            imported(client, unit, scale=scale)
        runs = [imported(client, "REV-SIX", bias_deg=0.5 + k / 1000)["id"] for k in range(5)]
        for run, pose in ((runs[-1], 1), (runs[-1], 2)):
            path = f"/api/runs/{run}/poses/{pose}/exclude"
            client.post(path, json={"reason": REASON}).raise_for_status()
        yield client


def test_the_units_list_says_what_each_is_worth_now_and_what_passed_today(page, client, go, expect):
    go("#/units")
    expect(page.locator("#units-table tbody tr")).to_have_count(200)
    expect(page.locator("#units-today")).to_have_text(
        "Today: 0 of 2 units passed; 1 fail, 1 undecided, 1 more without limits."
    )
    failed = row_of(page, "#units-table", "AS-FAIL")
    assert failed["Verdict"] == "none in forcelatest run: fail"
    passed = row_of(page, "#units-table", "AS-PASS")
    (unit,) = client.get("/api/units?q=AS-PASS").json()
    assert passed["Verdict"] == unit["verdict"]
    assert passed["In force since"].endswith("revision 1")
    assert "unchanged" in row_of(page, "#units-table", "REV-SIX")["Last change"]


def test_filters_of_units_stay_in_the_address_and_the_csv_has_what_they_leave(page, go, expect):
    go("#/units")
    rows = page.locator("#units-table tbody tr")
    page.fill("#units-text", "as-")
    expect(rows).to_have_count(2)
    page.select_option("#units-verdict", "none")
    expect(rows).to_have_count(1)
    expect(page.locator("#units-told")).to_have_text("1 of 200 units")
    with page.expect_download() as download:
        page.click("#units-csv")
    with download.value.path().open(newline="") as file:
        assert [(row["serial"], row["last_verdict"]) for row in csv.DictReader(file)] == [("AS-FAIL", "fail")]
    page.reload()
    expect(rows).to_have_count(1)
    expect(page.locator("#units-text")).to_have_value("as-")
    page.fill("#units-text", "nothing like it")
    expect(page.locator("#units-told")).to_have_text("No unit matches.")
    expect(page.locator("#units-table")).to_be_hidden()


VIEWS = {
    "units": "#/units",
    "unit with revisions": "#/units/REV-SIX",
    "compare": "#/compare?unit=REV-SIX&unit=AS-FAIL&unit=AS-PASS&unit=BT-000",
    "audit log": "#/trail",
    "runs": "#/",
    "solve": "#/solve?rig=",
}


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("view", VIEWS)
def test_no_table_scrolls_sideways(page, go, expect, view, width):
    page.set_viewport_size({**PHONE, "width": width})
    go(VIEWS[view])
    expect(page.locator("main table tbody tr").first).to_be_visible()
    page.locator("details").evaluate_all("all => all.forEach(one => (one.open = true))")
    wait_for(lambda: page.evaluate(WIDER) == [], f"tables no wider than {width} px: {page.evaluate(WIDER)}")
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_on_a_phone_a_row_is_a_card_whose_cells_have_their_headings(page, client, go, expect):
    run = client.get("/api/runs?unit=REV-SIX").json()["items"][0]
    page.set_viewport_size(PHONE)
    go(f"#/runs/{run['id']}")
    unfold(page, "poses")
    pose = page.locator("#poses-table [data-pose='1']")
    expect(pose).to_be_visible()
    labels = pose.locator("td").evaluate_all("cells => cells.map(cell => cell.dataset.label)")
    assert labels[1:4] == ["Target", "Stage", "Reading"]
    assert page.evaluate(WIDER) == []
    shown = "cell => getComputedStyle(cell, '::before').content.split('/')[0].trim()"
    assert pose.locator("td").nth(1).evaluate(shown) in {'"Target"', "attr(data-label)"}


def test_reasons_of_revisions_name_runs_as_the_page_does(page, go, expect):
    go("#/units/REV-SIX")
    row = page.locator("#revisions-table [data-revision='7']")
    expect(row).to_contain_text(f"was excluded: {REASON}")
    expect(row.get_by_role("button", name="Withdraw…")).to_be_visible()
    assert page.locator("#revisions-table").evaluate(
        "table => !/[0-9a-f]{8}-[0-9a-f]{4}-/.test(table.textContent)"
    )


def test_lists_without_entries_say_what_would_fill_them(rig, store_path, fresh_page, expect):
    with running_service(store_path, rig) as service, serving(service) as client:
        for view, words in (
            ("#/", "No runs yet. Start a calibration above, or import poses."),
            ("#/units", "No units yet. A unit appears with its first run"),
            ("#/compare", "No units yet. A unit appears with its first run"),
            ("#/solve", "No solution yet. Tick runs above and press Solve."),
            ("#/noise", "None yet. Analyse a file above."),
        ):
            fresh_page.goto(str(client.base_url.join("/")) + view)
            expect(fresh_page.get_by_text(words)).to_be_visible()
            expect(fresh_page.locator("main table:visible")).to_have_count(0)
        fresh_page.goto("about:blank")


def test_the_time_axis_of_a_rig_with_faster_clocks_is_the_time_on_the_wall(
    fresh_page, launch_rig, store_path, expect
):
    hurried = launch_rig("hurried").model_copy(update={"time_scale": 20.0})
    with running_service(store_path, hurried) as service, serving(service) as client:
        run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
        fresh_page.goto(f"{client.base_url.join('/')}#/runs/{run['id']}")
        expect(fresh_page.get_by_test_id("timeline")).to_be_attached()
        live = wait_for(lambda: (x := line_x(fresh_page, "timeline"))[20:] and x, "points of the timeline")
        fresh_page.click("button.stop")
        ended(client, run["id"])
        wall_s = [time_s / 20.0 for time_s in readings(client, run["id"])]
        assert live == wall_s[: len(live)]
        fresh_page.reload()
        unfold(fresh_page, "charts")
        axis = fresh_page.get_by_test_id("timeline").locator(".xtitle")
        expect(axis).to_have_text("time (s), simulated clocks 20× faster")
        assert line_x(fresh_page, "timeline") == wall_s
        fresh_page.goto("about:blank")
