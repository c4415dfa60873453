"""The stop button: in view on every page, one click or key, while a run goes on and while nothing does."""

from __future__ import annotations

import pytest
from support import LONG, ended, running_service, serving

from calrig.settings import BoardSettings, RigSettings, StageSettings

from .page_help import ambiguous_poses, imported, imported_lines, unfold

pytestmark = pytest.mark.browser


ON_TOP = """button => {
  const { left, top, width, height } = button.getBoundingClientRect();
  const inside = left >= 0 && top >= 0 && left + width <= innerWidth && top + height <= innerHeight;
  const hit = document.elementFromPoint(left + width / 2, top + height / 2);
  return inside && height >= 40 && button.contains(hit);
}"""
HIDE, SHOW = (
    f"""Object.defineProperty(document, "hidden", {{ value: {hidden}, configurable: true }});
    document.dispatchEvent(new Event("visibilitychange"));"""
    for hidden in ("true", "false")
)
"""What a browser does when another tab is looked at; without a screen it takes all tabs for seen."""
DESK, PHONE = {"width": 1280, "height": 900}, {"width": 360, "height": 640}


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_every_view_fits_and_has_it_in_view_wherever_that_is_scrolled_to(page, client, go, expect, size):
    # one of its own: a second run of it has a control chart, once other tests' repeats tell the spread
    unit = f"A-serial-number-that-is-{size['width']}-" + "long-" * 12
    run = imported_lines(client, ambiguous_poses(), unit, rig="bench-1")
    client.post(f"/api/runs/{run['id']}/diagnosis", json={}).raise_for_status()
    page.set_viewport_size(size)
    charts = {
        "#/": 0,
        f"#/runs/{run['id']}": 0,  # folded
        "#/units": 0,
        f"#/units/{unit}": 1,
        f"#/compare?unit={unit}": 4,
        "#/noise": 0,
        "#/import": 0,
        "#/trail": 0,
        "#/users": 0,
        "#/none": 0,
    }
    for view, drawn in charts.items():
        go(view)
        expect(page.locator("h1")).to_be_visible()
        expect(page.locator(".plot .plot-container")).to_have_count(drawn)
        if view.startswith("#/runs/"):
            expect(page.locator(".effect")).to_be_visible()
        page.locator("details").evaluate_all("all => all.forEach(one => (one.open = true))")
        if view.startswith("#/runs/"):  # of a file without times there is no timeline
            for chart in ("residual", "before-after", "effect-0"):
                expect(page.get_by_test_id(chart).locator(".plot-container")).to_be_visible()
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        button = page.locator("button.stop")
        expect(button).to_have_text("Stop bench-1")
        assert button.evaluate(ON_TOP), view
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], view


def test_one_click_on_any_page_stops_the_run_and_says_so(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    go("#/units")
    page.click("button.stop")
    expect(page.locator("#stop-line")).to_contain_text("bench-1: stage stopped")
    assert ended(client, run["id"])["status"] == "aborted"


def test_a_stage_that_stands_by_itself_is_told_too(page, go, expect):
    go("#/")
    page.click("button.stop")
    expect(page.locator("#stop-line")).to_contain_text("bench-1: stage stopped")


def test_the_keyboard_reaches_it_in_three_steps(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    go(f"#/runs/{run['id']}")
    expect(page.locator("#abort")).to_be_visible()
    expect(page.locator("button.stop")).to_be_visible()  # the header reads the rigs by itself
    for _ in range(3):
        page.keyboard.press("Tab")
    expect(page.locator("button.stop")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#status")).to_have_text("aborted")


def test_escape_stops_what_the_queue_has_under_way_and_no_key_that_follows_starts_anything(
    page, client, go, expect
):
    batch = client.post("/api/batches", json={"units": ["ESC-1", "ESC-2"], "plan": LONG}).raise_for_status()
    go(f"#/queue/{batch.json()['id']}")
    expect(page.locator("[data-go]")).to_be_enabled()
    expect(page.locator(".todo")).to_have_text("Mount ESC-1, press Enter")
    page.keyboard.press("Escape")
    expect(page.locator("#stop-line")).to_be_hidden()  # nothing is under way
    page.keyboard.press("Enter")
    expect(page.locator(".todo")).to_have_text("ESC-1 is being measured")
    page.locator("#queue-units a").first.focus()
    page.keyboard.press("Escape")
    expect(page.locator("#scan")).to_be_focused()
    for _ in range(3):
        page.keyboard.press("Enter")
    page.keyboard.type("ESC-2\n")
    expect(page.locator("#stop-line")).to_contain_text("bench-1: stage stopped")
    (run,) = client.get("/api/runs?q=ESC-").json()["items"]
    assert ended(client, run["id"])["status"] == "aborted"
    expect(page.locator(".todo")).to_have_text("Mount ESC-1, press Enter")
    assert len(client.get("/api/runs?q=ESC-").json()["items"]) == 1
    client.post(f"/api/batches/{batch.json()['id']}/close").raise_for_status()


def test_after_a_stop_in_the_header_the_queue_has_the_keyboard_again(page, client, go, expect):
    batch = client.post("/api/batches", json={"units": ["HEAD-1"], "plan": LONG}).raise_for_status().json()
    turn = {"rig": "bench-1", "unit": "HEAD-1"}
    client.post(f"/api/batches/{batch['id']}/start", json=turn).raise_for_status()
    go(f"#/queue/{batch['id']}")
    expect(page.locator(".todo")).to_have_text("HEAD-1 is being measured")
    page.focus("button.stop")
    page.keyboard.press("Enter")
    expect(page.locator("#scan")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#queue-said")).to_contain_text("Not started: a stop was just requested")
    expect(page.locator("#stop-line")).to_contain_text("bench-1: stage stopped")
    assert len(client.get("/api/runs?q=HEAD-").json()["items"]) == 1
    client.post(f"/api/batches/{batch['id']}/close").raise_for_status()


def test_escape_stops_the_run_on_its_page_and_on_its_rigs(page, client, go, expect):
    for view in ("runs", "rigs"):
        run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
        go(f"#/runs/{run['id']}" if view == "runs" else "#/rigs/bench-1")
        expect(page.locator("#abort" if view == "runs" else "#check")).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator("#stop-line")).to_contain_text("bench-1: stage stopped")
        assert ended(client, run["id"])["status"] == "aborted"


def test_a_question_that_waits_for_its_answer_does_not_stand_before_it(page, client, go, expect):
    old = imported(client, "A")
    run = client.post("/api/runs", json={"unit": "B", "plan": LONG}).raise_for_status().json()
    go(f"#/runs/{old['id']}")
    unfold(page, "amend")
    page.click("#void")
    expect(page.locator("#reason")).to_be_focused()
    page.click("button.stop")
    assert ended(client, run["id"])["status"] == "aborted"
    page.focus("#reason")
    page.keyboard.press("Escape")
    expect(page.locator("dialog")).to_have_count(0)


def test_a_tab_that_nobody_sees_holds_no_connection_that_a_stop_might_need(page, client, go, expect):
    """A browser opens six to one service: six tabs that watch a run would keep the seventh from stopping."""
    run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    go(f"#/runs/{run['id']}")
    rows = page.locator("#poses-table tbody tr")
    expect(rows.first).to_be_visible()
    with page.expect_event("requestfailed", lambda request: request.url.endswith("/events")):
        page.evaluate(HIDE)
    with page.expect_request("**/events"):
        page.evaluate(SHOW)
    page.click("button.stop")
    expect(page.locator("#status")).to_have_text("aborted")
    indices = rows.evaluate_all("rows => rows.map(row => Number(row.dataset.pose))")
    assert indices == list(range(len(indices)))


def test_a_stage_that_cannot_be_told_is_said_to_be_so_with_what_to_do(
    fresh_page, store_path, expect, forgiven
):
    forgiven.append("status of 409")
    with running_service(store_path, absent("bench-9")) as service, serving(service) as client:
        fresh_page.goto(str(client.base_url))
        fresh_page.click("button.stop")
        line = fresh_page.locator("#stop-line")
        expect(line).to_contain_text("bench-9 was not stopped")
        expect(line).to_contain_text("cut its motor power")
        fresh_page.goto("about:blank")


def test_of_many_rigs_one_is_chosen_a_pages_own_is_first_and_all_are_stopped_with_one_click(
    fresh_page, rig, store_path, expect, forgiven
):
    forgiven.append("status of 409")
    rigs = [*(absent(f"bench-{k}") for k in (7, 8, 9)), rig]
    with running_service(store_path, *rigs) as service, serving(service) as client:
        run = client.post("/api/runs", json={"unit": "A", "rig": rig.name, "plan": LONG}).json()
        fresh_page.set_viewport_size(PHONE)
        fresh_page.goto(str(client.base_url.join(f"/#/runs/{run['id']}")))
        button = fresh_page.locator("button.stop[data-rig]")
        expect(button).to_have_text("Stop bench-1")
        options = fresh_page.locator("#stop-rig option")
        expect(options).to_contain_text(["bench-1", "bench-7", "bench-8", "bench-9"])
        assert fresh_page.locator("#stop-all").evaluate(ON_TOP)
        fresh_page.select_option("#stop-rig", "bench-8")
        expect(button).to_have_text("Stop bench-8")
        fresh_page.click("#stop-all")
        expect(fresh_page.locator("#status")).to_have_text("aborted")
        line = fresh_page.locator("#stop-line")
        expect(line).to_contain_text("not confirmed: bench-7, bench-8, bench-9")
        expect(line).to_contain_text("cut its motor power")
        fresh_page.goto("about:blank")


def test_what_nobody_answered_stands_in_red_until_the_service_is_back(page, go, expect, forgiven):
    forgiven.append("ERR_FAILED")
    go("#/units")
    page.route("**/stop", lambda route: route.abort())
    page.route("**/api/health", lambda route: route.abort())
    page.click("button.stop")
    line = page.locator("#stop-line")
    expect(line).to_contain_text("cut its motor power")
    expect(page.locator("#banner")).to_be_visible()
    page.unroute_all()
    expect(page.locator("#banner")).to_be_hidden()
    expect(line).to_contain_text("press Stop again")
    expect(line).not_to_contain_text("motor power")


def absent(name):
    """A rig whose cables are not plugged in."""
    stage, imu = (f"/dev/serial/by-id/absent-{name}-{part}" for part in ("stage", "imu"))
    return RigSettings(
        name=name,
        stage=StageSettings(driver="smc100", port=stage),
        imu=BoardSettings(driver="calrig", port=imu),
    )
