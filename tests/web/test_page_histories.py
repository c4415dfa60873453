"""What histories tell on the page: what changed, what stands out in Compare, when a rig is in doubt."""

from __future__ import annotations

import numpy as np
import pytest
from dated_runs import at, gave, lay, ran
from kept_maps import solved
from support import running_service, serving, wait_for

from calrig.run_ids import short_name
from calrig.store.tables import CheckUnitTable

from .page_help import imported_lines

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def running(rig, tmp_path_factory):
    """One service whose store has twelve units that repeat and one whose scale moved."""
    rng = np.random.default_rng(0)
    runs = [
        (f"U{k:02}", 30.0 * n + k, gave(0.5 + k / 10 + 0.02 * rng.normal(), 1 + 2e-4 * rng.normal()), {})
        for k in range(11)
        for n in range(3)
    ]
    moved = [("MOVED", day, gave(0.8, scale), {}) for day, scale in ((10.0, 1.0), (40.0, 1.02))]
    path = tmp_path_factory.mktemp("histories") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        lay(service.store, *runs, *moved)
        yield service, client


@pytest.fixture(scope="module")
def client(running):
    return running[1]


@pytest.fixture
def store(running):
    return running[0].store


def colours(page, chart):
    """The colours in a chart, by the name of what is drawn in them."""
    drawn = "chart => document.querySelector(`[data-testid=${chart}]`).data.map(t => [t.name, t.line.color])"
    return dict(page.evaluate(drawn, chart))


def test_the_unit_that_moved_is_first_in_compare_and_marked(page, go, expect):
    """It was called good, stood anywhere, and made every other unit's repeatability look bad."""
    go("#/compare?all")
    rows = page.locator("#compare-table tbody tr")
    expect(rows).to_have_count(12)
    expect(rows.first).to_contain_text("MOVED")
    expect(rows.first).to_contain_text("changed")
    expect(rows.first).to_contain_text("0.0200 ±")
    expect(page.locator("#compare-table .tag", has_text="changed")).to_have_count(1)
    expect(page.locator("#compare-changed")).to_contain_text("MOVED (1 of 12)")
    expect(page.locator("#compare-rule")).to_contain_text("5 %")
    spread = page.get_by_test_id("spread")
    expect(spread).to_contain_text("MOVED")
    expect(spread).to_contain_text("repeatability within one unit 0.000")
    expect(spread).to_contain_text("Remounting: ")


def test_beyond_eight_units_no_colour_is_given_twice(page, go, expect):
    go("#/compare?all")
    chart = page.get_by_test_id("compare-bias")
    expect(chart.locator(".plot-container")).to_be_visible()
    drawn = colours(page, "compare-bias")
    assert len(drawn) == 12
    grey = [name for name, colour in drawn.items() if colour == drawn["U00"]]
    assert len(grey) == 11, "the one that changed has a colour"
    page.get_by_label("U03 in colour").check()
    page.get_by_label("U07 in colour").check()
    last = "document.querySelector('[data-testid=compare-bias]').data.slice(-2).map(t => t.name).join()"
    wait_for(lambda: page.evaluate(last) == "U03,U07", "chart with both in front")
    drawn = colours(page, "compare-bias")
    assert len({drawn["U03"], drawn["U07"], drawn["MOVED"]}) == 3
    assert drawn["MOVED"] == drawn["U00"]


def test_an_answer_that_comes_late_does_not_undo_the_choice_after_it(page, go, expect):
    """The figure for the first box is held back until the one for both boxes is drawn."""
    held = []

    def hold_the_first(route):
        if "chosen=U03" in route.request.url and "chosen=U07" not in route.request.url:
            held.append(route)
        else:
            route.continue_()

    go("#/compare?all")
    page.route("**/api/compare/figures/bias*", hold_the_first)
    expect(page.get_by_test_id("compare-bias").locator(".plot-container")).to_be_visible()
    page.get_by_label("U03 in colour").check()
    page.get_by_label("U07 in colour").check()
    drawn = "document.querySelector('[data-testid=compare-bias]').data.slice(-2).map(t => t.name).join()"
    wait_for(lambda: held and page.evaluate(drawn) == "U03,U07", "chart with both in front")
    with page.expect_event("requestfinished", lambda request: request == held[0].request):
        held[0].continue_()
    page.evaluate("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    assert page.evaluate(drawn) == "U03,U07"


def test_a_units_page_says_what_changed_and_when_it_is_due(page, client, go, expect):
    go("#/units/MOVED")
    row = page.locator("#changes-table tbody tr")
    expect(row).to_have_count(1)
    expect(row).to_contain_text("changed")
    expect(row).to_contain_text("0.0200 ±")
    expect(row.get_by_role("button", name="Diagnose both")).to_be_visible()
    expect(page.locator("#due")).to_contain_text("365 days")
    page.emulate_media(media="print")  # which may be handed to the customer, who agreed to no interval
    expect(page.locator("#due")).to_be_hidden()
    page.emulate_media(media="screen")
    go("#/units/U01")
    expect(page.locator("#changes-table tbody tr")).to_have_count(2)
    says = client.get("/api/units/U01/changes").json()[0]["says"]
    expect(page.locator("#changes-table")).to_contain_text(says)
    expect(page.get_by_test_id("unit-chart").locator(".plot-container")).to_be_visible()


def test_both_runs_are_diagnosed_together_from_the_units_page(page, client, go, expect):
    """Both runs are alike but for their level, and nothing but the reading tells of them."""
    noise = np.random.default_rng(1).normal(0, 0.01, 25)
    for bias in (0.5, 2.5):
        lines = [f"{x},{bias + x + noise[k]:.5f},0.01" for k, x in enumerate(range(-60, 61, 5))]
        imported_lines(
            client, ["target_deg,reading_deg,reading_stderr_deg", *lines], "CLAMPED", rig="bench-1"
        )
    go("#/units/CLAMPED")
    page.get_by_role("button", name="Diagnose both").click()
    row = page.locator("#changes-table tbody tr")
    expect(row.get_by_role("button")).to_have_count(0)
    expect(row).to_contain_text("2.00")
    (change,) = client.get("/api/units/CLAMPED/changes").json()
    (effect,) = change["effects"]
    assert {effect["name"], *effect["confusable_with"]} == {"bias_change", "mount_change"}


def test_the_buttons_of_a_units_changes_are_there_once_they_stay_where_they_are(page, go, expect):
    """A click was lost: the calibrations above came between its press and its release."""
    held = []

    def hold(route):
        held.append(route)

    page.route("**/api/units/MOVED/calibrations", hold)
    with page.expect_response("**/api/units/MOVED/changes"):
        go("#/units/MOVED")
    wait_for(lambda: page.evaluate("null") or held, "request for the calibrations")
    page.evaluate("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    expect(page.get_by_role("button", name="Diagnose both")).to_have_count(0)
    held[0].continue_()
    expect(page.get_by_role("button", name="Diagnose both")).to_be_visible()


def test_a_rig_whose_check_unit_fails_puts_runs_in_doubt(page, client, store, go, expect):
    go("#/")
    page.get_by_test_id("rigs").get_by_role("link", name="bench-1", exact=True).click()
    expect(page.locator("#check")).to_contain_text("No check standard")
    expect(page.locator("#reference")).to_contain_text("No stage map")
    page.select_option("#check-unit", "U00")
    page.fill("#check-days", "7")
    page.click("#name-check")
    expect(page.locator("#check .headline")).to_contain_text("passes")
    expect(page.locator("#check")).to_contain_text("overdue")
    with store._database.writing() as session:
        session.get_one(CheckUnitTable, "bench-1").named_at = at(50)
    during = ran(store, "U05", 85, 1.0)
    ran(store, "U00", 90, 2.0)
    kept = store.solutions.save(solved())
    store.stage_maps.put_in_force("bench-1", kept.id, kept.found.stage_map)
    go("#/rigs/bench-1")
    page.reload()
    expect(page.locator("#check .headline")).to_contain_text("fails")
    expect(page.locator("#reference .headline")).to_contain_text("Not yet checked")
    expect(page.locator("#reference")).to_contain_text("map")
    page.click("#withdraw-map")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#reference")).to_contain_text("No stage map")
    expect(page.get_by_test_id("check-chart").locator(".plot-container")).to_be_visible()
    page.locator("#suspects").get_by_role("link", name=short_name(during.id), exact=True).click()
    expect(page.locator("#suspect-reason")).to_contain_text("U00")
    go("#/units/U05")
    row = page.locator(f"#history-table tr[data-run='{during.id}']")
    expect(row.locator(".tag", has_text="suspect")).to_be_visible()
    go("#/rigs/bench-1")
    page.click("#drop-check")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#check")).to_contain_text("No check standard")
    assert client.get(f"/api/runs/{during.id}").json()["suspect"] is None
