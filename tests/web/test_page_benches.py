"""The benches' page: forty rigs of a real centre hall by hall, found by filters, live by one request."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from dated_runs import gave, lay
from many_benches import ManyBenches, a_day_in_the_halls, centre_with_benches
from support import serving, wait_for

pytestmark = pytest.mark.browser

DESK, PHONE = {"width": 1280, "height": 900}, {"width": 375, "height": 800}
FEED = "**/api/benches/overview"
ROWS = ".halls tr.rig:visible"
Show = Callable[..., Any]


@pytest.fixture
def benches(new_database: Any) -> Iterator[tuple[Any, ManyBenches]]:
    """A client of a centre, and its benches."""
    with centre_with_benches(new_database()) as (service, benches), serving(service) as client:
        yield client, benches


@pytest.fixture
def show(fresh_page: Any, benches: tuple[Any, ManyBenches], expect: Any) -> Iterator[Show]:
    """Opens the view with so many rows; `#/benches` unless an address is given."""

    def show(count: int, address: str = "#/benches") -> Any:
        fresh_page.goto(str(benches[0].base_url.join("/")) + address)
        expect(fresh_page.locator(ROWS)).to_have_count(count)
        return fresh_page

    yield show
    fresh_page.goto("about:blank")


def names(page: Any) -> list[str]:
    """The rigs that are shown."""
    return page.locator(ROWS).evaluate_all("rows => rows.map(row => row.dataset.rig)")


def row(page: Any, rig: str) -> Any:
    return page.locator(f"tr[data-rig={rig}]")


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_forty_rigs_fit_the_screen_and_are_all_there_for_a_screen_reader(
    fresh_page: Any, benches: tuple[Any, ManyBenches], show: Show, size: dict[str, int]
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    a_day_in_the_halls(benches[1])
    fresh_page.set_viewport_size(size)
    page = show(40)
    assert page.locator(".halls h2").all_inner_texts() == ["hall 1", "hall 2", "hall 10"]
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    found = axe.Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    table = page.get_by_role("table", name="hall 2")
    assert table.get_by_role("columnheader").all_inner_texts()[0] == "Rig"
    assert table.get_by_role("rowheader", name="rig-16").count() == 1
    assert page.get_by_role("button", name="Stop rig-16").count() == 1


def test_each_row_says_what_its_rig_does_and_what_there_is_to_see_to(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any
) -> None:
    a_day_in_the_halls(benches[1])
    page = show(40)
    expect(row(page, "rig-03")).to_contain_text("busy")
    expect(row(page, "rig-03")).to_contain_text("9 of 52 poses, about 8\u00a0min 15\u00a0s left")
    expect(row(page, "rig-03")).to_contain_text("4 runs: AS-2001, AS-2002, AS-2003 and 1 more")
    expect(row(page, "rig-16")).to_contain_text("Clamp the unit at 90° about x, then resume the run.")
    expect(row(page, "rig-18")).to_contain_text("it stands at 38.71°")
    expect(row(page, "rig-22")).to_contain_text("interrupted")
    expect(row(page, "rig-23")).not_to_contain_text("failed")
    expect(row(page, "rig-24")).to_contain_text("unreachable")
    expect(row(page, "rig-25")).to_contain_text("check overdue")
    expect(row(page, "rig-31")).to_contain_text("offline for 2\u00a0h")
    expect(row(page, "rig-31")).to_contain_text("20 of 52 poses at the last report")
    away = page.locator("th.bench").filter(has_text="bench-7")
    expect(away).to_contain_text("2\u00a0h ago")
    expect(away).to_contain_text("18 messages")
    expect(page.locator("th.bench").filter(has_text="bench-8")).to_contain_text("connected")


def test_filters_say_how_many_they_leave_and_stay_in_the_address(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any
) -> None:
    a_day_in_the_halls(benches[1])
    page = show(40)
    choice = page.locator(".choices label")
    expect(choice.filter(has_text="busy")).to_have_text("busy 15")
    choice.filter(has_text="failed").click()
    expect(page.locator("#benches-shown")).to_have_text("2 of 40 rigs shown.")
    assert names(page) == ["rig-18", "rig-22"]
    assert page.locator(".halls section:visible h2").all_inner_texts() == ["hall 2"]
    page.keyboard.press("ArrowRight")  # as radio buttons are worked
    assert names(page) == ["rig-25"]
    page.keyboard.press("ArrowRight")
    expect(page.locator(ROWS)).to_have_count(40)
    page.select_option("#filter-hall", label="hall 10 (10)")
    page.locator(".choices label").filter(has_text="offline").click()
    expect(page.locator(ROWS)).to_have_count(5)
    expect(page.locator("#filter-hall option").first).to_have_text("all halls (5)")
    page.fill("#filter-text", "as-1031")
    assert names(page) == ["rig-31"]
    expect(page).to_have_url(re.compile(r"#/benches\?hall=hall\+10&show=offline&q=as-1031$"))
    page.reload()
    expect(page.locator(ROWS)).to_have_count(1)
    assert page.input_value("#filter-text") == "as-1031"
    page.fill("#filter-text", "nobody")
    expect(page.locator("#benches-shown")).to_have_text("0 of 40 rigs shown.")


def test_a_link_shows_what_it_was_made_of(benches: tuple[Any, ManyBenches], show: Show) -> None:
    a_day_in_the_halls(benches[1])
    assert names(show(2, "#/benches?show=queued")) == ["rig-03", "rig-07"]
    assert len(names(show(40, "#/benches?show=nonsense"))) == 40


def test_one_request_tells_of_all_rigs_and_nobody_loses_their_place_meanwhile(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any
) -> None:
    _, lab = benches
    runs = [lab.busy(f"rig-{k:02d}", f"AS-{k}", remaining_s=500.0) for k in range(1, 41)]
    page = show(40)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url.split("/api/")[-1]))
    stop = page.get_by_role("button", name="Stop rig-40")
    stop.focus()
    for n_poses in (5, 6):
        for run in runs:
            lab.begin(run, n_poses, 400.0)
        expect(row(page, "rig-40")).to_contain_text(f"{n_poses} of 52 poses")
    expect(stop).to_be_focused()
    assert asked.count("benches/overview") >= 2
    # Once more for all rigs, where an answer has taken longer than a second.
    assert set(asked) <= {"benches/overview", "health", "overdue?limit=9", "rigs"}


def test_while_nothing_happens_nothing_is_sent(benches: tuple[Any, ManyBenches], show: Show) -> None:
    _, lab = benches
    page = show(40)
    for _ in range(2):
        for bench in lab.benches:
            lab.beat(bench)
        with page.expect_response(FEED) as answer:
            pass
        assert answer.value.status == 304


def test_a_stop_reaches_the_bench_and_one_that_cannot_is_said_in_its_own_words(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any, forgiven: list[str]
) -> None:
    forgiven.append("status of 409")
    _, lab = benches
    lab.busy("rig-01", "AS-1")
    lab.busy("rig-31", "AS-31")
    lab.beat("bench-7", ago_s=40)
    page = show(40)
    expect(page.locator("button.stop:visible")).to_have_count(4)  # the busy ones', the header's, all
    expect(page.locator("#stop-all")).to_have_text("Stop all, hall 1")  # where the first busy rig stands
    page.get_by_role("button", name="Stop rig-01").last.click()
    wait_for(lab.answer_commands, "the command")
    expect(page.locator("#stop-line")).to_contain_text("rig-01: stage stopped")
    page.get_by_role("button", name="Stop rig-31").last.click()
    line = page.locator("#stop-line")
    expect(line).to_contain_text("rig-31 was not stopped: bench bench-7 was last seen ")
    expect(line).to_contain_text("go there, or cut its motor power")
    page.select_option("#stop-rig", "rig-31")
    expect(page.locator("#stop-all")).to_have_text("Stop all, hall 10")
    page.click("#stop-all")
    expect(line).to_contain_text("Stopping all 10 rigs")


def test_a_stop_that_waits_a_run_that_is_held_back_and_a_bench_that_is_refused_are_there_to_see(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any
) -> None:
    client, halls = benches
    halls.unanswered("stop", "rig-31", 600.0)
    held = halls.order("rig-02", "AS-9")
    halls.hold(held)
    halls.beat("bench-3", protocol=1)
    page = show(40)

    expect(row(page, "rig-31")).to_contain_text("not answered yet. The bench obeys it before anything else.")
    row(page, "rig-31").get_by_role("button", name="Withdraw stop").click()
    expect(row(page, "rig-31")).not_to_contain_text("not answered yet")
    assert client.get("/api/trail?what=stop_withdrawn").json()["entries"][0]["rig"] == "rig-31"

    expect(page.locator("th.bench", has_text="bench-3")).to_contain_text(
        "Takes no orders: its calrig is too old"
    )

    row(page, "rig-02").get_by_role("link", name="run ", exact=False).last.click()
    expect(page.locator("#run-reason")).to_contain_text("begins once somebody says Go")
    page.click("#go-held")
    expect(page.locator("#run-reason")).to_have_count(0)
    assert client.get(f"/api/runs/{held.id}").json()["error"] is None


def test_an_open_page_shows_that_its_queued_run_is_held_back_and_that_somebody_else_lets_it_begin(
    benches: tuple[Any, ManyBenches], fresh_page: Any, expect: Any
) -> None:
    client, halls = benches
    run = halls.order("rig-02", "AS-9")
    with fresh_page.expect_response(f"**/api/runs/{run.id}/events"):
        fresh_page.goto(f"{client.base_url.join('/')}#/runs/{run.id}")
    expect(fresh_page.locator("#status")).to_have_text("queued")
    expect(fresh_page.locator("#run-reason")).to_have_count(0)
    halls.hold(run)
    expect(fresh_page.locator("#run-reason")).to_contain_text("begins once somebody says Go")
    expect(fresh_page.locator("#go-held")).to_be_visible()
    assert client.post(f"/api/runs/{run.id}/resume").is_success
    halls.begin(run)
    expect(fresh_page.locator("#status")).to_have_text("running")
    expect(fresh_page.locator("#go-held")).to_have_count(0)


def test_benches_come_and_go_while_somebody_watches(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any
) -> None:
    _, lab = benches
    page = show(40)
    lab.store.enrolment.add("bench-9", "hall 3")
    expect(page.locator(".halls h2")).to_have_text(["hall 1", "hall 2", "hall 3", "hall 10"])
    expect(page.locator("th.bench").filter(has_text="bench-9")).to_contain_text("no report")
    lab.beat("bench-2", clock_skew_s=-3.2)
    words = "its clock is 3 s behind the centre's: synchronise both clocks (NTP)"
    expect(page.locator("th.bench").filter(has_text="bench-2")).to_contain_text(words)
    lab.beat("bench-1", ago_s=60)
    expect(row(page, "rig-01")).to_contain_text("offline")
    expect(page.locator("[role=status].for-screen-readers")).to_contain_text("Rig rig-01: offline.")


def test_units_that_are_overdue_are_named(benches: tuple[Any, ManyBenches], show: Show, expect: Any) -> None:
    _, lab = benches
    lay(lab.store, *((f"AS-{k:02d}", float(k), gave(), {"rig": "rig-01"}) for k in range(12)))
    page = show(40)
    lines = page.locator("#overdue li")
    expect(lines).to_have_count(8)
    expect(lines.first).to_contain_text("AS-00 was due")
    page.get_by_role("link", name="All units").click()
    expect(page.locator("h1")).to_have_text("Units")


def test_the_page_leads_there_where_rigs_have_benches(
    benches: tuple[Any, ManyBenches], show: Show, expect: Any
) -> None:
    page = show(40)
    expect(page.locator("#benches-link")).to_be_visible()
    expect(page.locator("#benches-link")).to_have_attribute("aria-current", "page")


def test_on_one_machine_it_is_not_offered_and_does_no_harm(page: Any, go: Any, expect: Any) -> None:
    go("#/")
    expect(page.locator("button.stop")).to_be_visible()
    expect(page.locator("#benches-link")).to_be_hidden()
    go("#/benches")
    expect(page.locator("tr[data-rig=bench-1]")).to_contain_text("idle")
    expect(page.locator("th.bench")).to_have_text("This machine ")
