"""A run as a person starts and watches it: the real service, a rig over real ports, a real browser."""

from __future__ import annotations

import pytest
from simulated_devices import Counterpart, plug
from support import LONG, wait_for

from .page_help import line_x, readings, unfold, unfold_plan, until_pose

pytestmark = pytest.mark.browser


REFUSED_422 = r"status of 422"


def fill_quick_plan(page):
    unfold_plan(page)
    page.get_by_label("List", exact=True).check()
    page.fill("#elevations_deg", "−40, 0; 40")
    page.fill("#sweeps", "2")
    page.fill("#settle_s", "0.5")
    page.fill("#dwell_s", "1")


def test_start_is_pressed_and_the_run_watched_to_its_result(page, client, go, expect):
    go("#/")
    expect(page.locator("#plan-summary")).to_contain_text("52 poses")
    page.fill("#unit", "MPU-1")
    page.locator("#run-more > summary").click()
    page.fill("#operator", "A. Person")
    page.fill("#note", "first one")
    fill_quick_plan(page)
    expect(page.locator("#plan-summary")).to_contain_text("6 poses")
    page.click("#start")

    page.wait_for_url("**/#/runs/*")
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("#abort")).to_be_hidden()
    run = client.get("/api/runs").json()["items"][0]
    assert (run["unit"], run["operator"], run["note"]) == ("MPU-1", "A. Person", "first one")
    assert run["plan"]["elevations_deg"] == [-40, 0, 40]
    decimals = 1 - int(f"{run['result']['bias_std_deg']:e}".split("e")[1])
    of_stage = run["result"]["reference"]["bias_std_deg"]
    bias = f"{run['result']['bias_deg']:.{decimals}f} ± {run['result']['bias_std_deg']:.{decimals}f}°"
    expect(page.locator("#result")).to_contain_text(f"{bias} (type A, noise)")
    expect(page.locator("#result")).to_contain_text(f"± {of_stage:#.2g}° (type B, stage)")
    expect(page.get_by_test_id("verdict")).to_contain_text("Verdict")
    expect(page.locator("#poses-table tbody tr")).to_have_count(6)
    unfold(page, "charts")
    scales = "!!document.querySelector('[data-testid=residual]').layout?.yaxis2"
    wait_for(lambda: page.evaluate(scales), "chart of the residual")
    wait_for(lambda: len(line_x(page, "timeline")) > 2, "readings in the timeline")


def test_a_page_opened_mid_run_and_reloaded_catches_up_and_draws_nothing_twice(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "MPU-1", "plan": LONG}).raise_for_status().json()
    go(f"#/runs/{run['id']}")
    rows = page.locator("#poses-table tbody tr")
    expect(rows.nth(2)).to_be_visible()
    assert wait_for(lambda: line_x(page, "timeline"), "points of the timeline")
    page.reload()
    expect(rows.nth(5)).to_be_visible()
    drawn = wait_for(lambda: line_x(page, "timeline"), "points of the timeline")
    indices = rows.evaluate_all("rows => rows.map(row => Number(row.dataset.pose))")
    page.click("#abort")
    expect(page.locator("#status")).to_have_text("aborted")
    assert drawn == readings(client, run["id"])[: len(drawn)]
    assert indices == list(range(len(indices)))


def test_a_stream_that_breaks_and_repeats_itself_leaves_no_gap_and_draws_nothing_twice(
    page, client, go, expect
):
    run = client.post("/api/runs", json={"unit": "MPU-1", "plan": LONG}).raise_for_status().json()
    beginning = until_pose(client, run["id"], 3)
    answers = []

    def break_twice(route):
        answers.append("beginning" if len(answers) < 2 else "service")
        if answers[-1] == "beginning":
            body = "retry: 50\n\n" + beginning
            route.fulfill(headers={"Content-Type": "text/event-stream"}, body=body)
        else:
            route.continue_()

    page.route("**/events", break_twice)
    go(f"#/runs/{run['id']}")
    rows = page.locator("#poses-table tbody tr")
    expect(rows.nth(5)).to_be_visible()
    enough = beginning.count("event: reading") + 1
    drawn = wait_for(lambda: (x := line_x(page, "timeline"))[enough:] and x, "points after the break")
    indices = rows.evaluate_all("rows => rows.map(row => Number(row.dataset.pose))")
    client.post(f"/api/runs/{run['id']}/abort").raise_for_status()
    expect(page.locator("#status")).to_have_text("aborted")
    assert answers[:3] == ["beginning", "beginning", "service"]
    assert drawn == readings(client, run["id"])[: len(drawn)]
    assert indices == list(range(len(indices)))


def test_a_move_that_the_unit_felt_otherwise_is_said_while_the_run_goes_on(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "MPU-1", "plan": LONG}).raise_for_status().json()
    says = "Pose 3 at 40°: the stage says that it turned by +40.00°, and the unit felt +39.00°."
    told = f'event: move_mismatch\nid: 1\ndata: {{"index": 3, "says": "{says}"}}\n\n'
    headers = {"Content-Type": "text/event-stream"}
    page.route("**/events", lambda route: route.fulfill(headers=headers, body="retry: 50\n\n" + told))
    go(f"#/runs/{run['id']}")
    expect(page.get_by_role("alert").filter(has_text=says)).to_be_visible()
    expect(page.locator("#mismatches p")).to_have_count(1)
    client.post(f"/api/runs/{run['id']}/abort").raise_for_status()


def test_a_run_is_paused_resumed_and_aborted_and_a_closed_tab_leaves_it_alone(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "MPU-1", "plan": LONG}).raise_for_status().json()
    go(f"#/runs/{run['id']}")
    page.click("#pause")
    expect(page.locator("#status")).to_have_text("paused")
    expect(page.locator("#remaining")).to_contain_text("paused")
    page.click("#resume")
    expect(page.locator("#status")).to_have_text("running")
    page.goto("about:blank")
    done = client.get(f"/api/runs/{run['id']}").json()["progress"]["poses_done"]
    wait_for(
        lambda: client.get(f"/api/runs/{run['id']}").json()["progress"]["poses_done"] > done, "another pose"
    )
    go(f"#/runs/{run['id']}")
    page.click("#abort")
    expect(page.locator("#status")).to_have_text("aborted")
    expect(page.locator("#pause")).to_be_hidden()


def test_a_plan_beyond_the_limits_is_refused_beside_the_button_and_nothing_starts(
    page, client, go, expect, forgiven
):
    forgiven.append(REFUSED_422)
    go("#/")
    page.fill("#unit", "REFUSED")
    unfold_plan(page)
    page.fill("#stop_deg", "120")
    expect(page.locator("#plan-summary")).to_contain_text("soft limits")
    page.click("#start")
    expect(page.locator("#start-error")).to_contain_text("soft limits")
    expect(page.locator("#stop_deg")).to_have_attribute("aria-invalid", "true")
    page.fill("#stop_deg", "60")
    page.fill("#sweeps", "9999999")
    page.click("#start")
    expect(page.locator("#start-error")).to_have_text("Sweeps must be at most 10000")
    expect(page.locator("#sweeps")).to_have_attribute("aria-invalid", "true")
    expect(page.locator("#sweeps")).to_be_focused()
    page.fill("#sweeps", "4")
    expect(page.locator("#sweeps")).not_to_have_attribute("aria-invalid", "true")
    page.check("#as-list")
    page.fill("#elevations_deg", "0; ten; 20")
    expect(page.locator("#plan-summary")).to_have_text("Elevation 2 is not a number")
    page.click("#start")
    expect(page.locator("#start-error")).to_have_text("Elevation 2 is not a number")
    expect(page.locator("#elevations_deg")).to_be_focused()
    assert client.get("/api/runs?unit=REFUSED").json()["items"] == []


def test_with_the_keyboard_alone_a_run_is_started(page, client, go, expect):
    go("#/")
    expect(page.locator("#unit")).to_be_focused()  # a reader of bar codes types where the focus is
    page.keyboard.type("MPU-1")
    page.keyboard.press("Enter")
    page.wait_for_url("**/#/runs/*")
    expect(page.locator("#abort")).to_be_visible()
    page.focus("#abort")
    page.keyboard.press("Enter")
    expect(page.locator("#status")).to_have_text("aborted")


def test_the_ports_are_looked_at_and_the_configuration_shown_as_text(page, go, expect, monkeypatch):
    plugged = plug(monkeypatch, ttyUSB0="grbl", ttyUSB1="calrig")
    plugged["ttyUSB1"] = Counterpart("calrig", serial="<b>AS-7</b>")
    go("#/")
    page.get_by_role("button", name="Scan serial ports").click()
    ports = page.get_by_test_id("ports")
    expect(ports.locator("tbody tr")).to_have_count(2)
    expect(ports).to_contain_text("calrig: unit <b>AS-7</b>")
    expect(page.get_by_test_id("stanza")).to_contain_text('port = "ttyUSB0"')
