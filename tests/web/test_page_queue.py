"""Units one after the other on the page: one Enter a unit, the same in every tab, read from three metres."""

from __future__ import annotations

import re

import pytest
from support import LONG, running_service, serving, wait_for

from .page_help import unfold_plan

pytestmark = pytest.mark.browser
SHORT = {"elevations_deg": [0, 20], "sweeps": 1, "settle_s": 0.2, "dwell_s": 0.5}
LISTENING = """
    window.told = [];
    window.Notification = class extends Notification {
        constructor(text, how) { super(text, how); told.push(text); }
    };
    const create = AudioContext.prototype.createOscillator;
    AudioContext.prototype.createOscillator = function () {
        const tone = create.call(this), start = tone.start.bind(tone);
        tone.start = (at) => { told.push(tone.frequency.value); start(at); };
        return tone;
    };
    null;
"""
"""What is told beside the page: notifications and tones, as the browser is asked for them."""
ODD = "Ä <b>7</b>\u202e\"'&#/%2F"


@pytest.fixture(scope="module")
def client(launch_rig, tmp_path_factory):
    """A service with a rig of its own: no other service moves the stage from where this one left it."""
    path = tmp_path_factory.mktemp("queue") / "calrig.db"
    with running_service(path, launch_rig()) as service, serving(service) as client:
        yield client


@pytest.fixture
def forgiven():
    return [r"(409|422) \(", "ERR_FAILED"]


def pressed(page, expect, instruction, card=None):
    """Enter, as soon as it means something, on the first rig or that of a card."""
    at = card or page
    expect(at.locator(".todo").first).to_have_text(instruction)
    expect(at.locator("[data-go]").first).to_be_enabled()  # an Enter meant for what stood there does nothing
    page.keyboard.press("Enter")


def test_a_list_goes_unit_by_unit_with_one_key_and_is_the_same_in_another_tab(page, client, go, expect):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed").Axe()
    go("#/queue/new")
    unfold_plan(page)
    page.get_by_label("List").check()  # a reader types wherever the focus is
    page.keyboard.type("PQ-1\nPQ-1\n")
    expect(page.locator("#units-count")).to_contain_text("1 unit; duplicates")
    page.reload()
    expect(page.locator("#units")).to_have_value("PQ-1\nPQ-1\n")
    file = {"name": "tray.csv", "mimeType": "text/csv", "buffer": b"lot,serial,\xfcber\n7,PQ-2\n7\n7,PQ-3\n"}
    page.locator("#csv").set_input_files(file)
    expect(page.locator("#csv-says")).to_contain_text(re.compile("2 .*added.*; 1 row "))
    unfold_plan(page)
    page.get_by_label("List").check()
    page.locator("#elevations_deg").fill("0, 20")
    for name, value in {"sweeps": 1, "settle_s": 0.2, "dwell_s": 0.5, "mounts_deg": "0"}.items():
        page.locator(f"#{name}").fill(str(value))
    page.click("#make-list")
    expect(page.locator("#queue-units tbody tr")).to_have_count(3)
    expect(page.locator("#scan")).to_be_focused()
    expect(page.locator(".sight")).to_contain_text("PQ-1")
    page.context.grant_permissions(["notifications"])
    page.evaluate(LISTENING)
    pressed(page, expect, "Mount PQ-1, press Enter")
    batch = page.url.split("/")[-1]
    word = page.locator(".big-word")
    expect(word).to_have_text("● DONE")
    expect(page).to_have_title("DONE PQ-1 · calrig")
    assert page.evaluate("told") == [660, "DONE PQ-1"]
    page.context.clear_permissions()
    assert word.evaluate("word => parseFloat(getComputedStyle(word).fontSize)") >= 96
    assert axe.run(page).violations_count == 0
    page.reload()
    expect(page).to_have_title("DONE PQ-1 · calrig")
    page.locator("#scan").fill(ODD)
    page.keyboard.press("Enter")
    expect(page.locator("#queue-error")).to_contain_text("printable")
    page.locator("#scan").fill(ODD.replace("\u202e", ""))
    page.keyboard.press("Enter")
    expect(page.locator("#queue-units tbody tr")).to_have_count(4)
    page.click("#queue-units-title")
    page.keyboard.type(
        "PX-9\n\npq-1\n\n"
    )  # a scanner that ends in two Enters, twice, and nobody chose the field
    expect(page.locator("#queue-said")).to_contain_text("in this batch: DONE")
    page.route("**/units", lambda route: route.abort())
    page.keyboard.type("PQ-4\n")
    expect(page.locator("#queue-said")).to_contain_text("kept here and added later: PQ-4.")
    page.unroute("**/units")
    expect(page.locator("#queue-said")).to_have_text("PQ-4 was added.")
    page.get_by_role("button", name="Remove PQ-4").click()
    page.keyboard.type("px-9\n")  # out of its turn: it is what somebody has at hand
    expect(page.locator(".todo")).to_have_text("Mount PX-9, press Enter")
    expect(page.locator(".sight")).to_contain_text("Check that the unit is PX-9")
    page.get_by_role("button", name="Remove PX-9").click()
    expect(page.locator("#queue-units tbody tr")).to_have_count(4)
    expect(page.locator(".todo")).to_have_text("Mount PQ-2, press Enter")

    with page.context.expect_page() as opened:
        page.evaluate("open(location.href)")
    other = opened.value
    expect(other.locator(".todo")).to_have_text("Mount PQ-2, press Enter")
    expect(other.locator(".big-word")).to_have_text("● DONE")
    page.set_viewport_size({"width": 390, "height": 844})
    for tab in (page, other):
        expect(tab.locator("[data-go]")).to_be_enabled()
    go_here = "document.querySelector('[data-go]').click()"
    page.evaluate(go_here)
    other.evaluate(go_here)
    narrow = "document.documentElement.scrollWidth <= 390"
    wait_for(lambda: page.evaluate(narrow), "page as narrow as the phone")
    for tab in (page, other):
        expect(tab.locator("#queue-counts")).to_have_text("2 to go, 2 done, 0 failed")
        expect(tab.locator(".todo")).to_have_text("Mount PQ-3, press Enter")
    assert len(client.get("/api/runs?unit=PQ-2").json()["items"]) == 1, "two tabs, one run"
    other.close()
    go("#/queue")
    expect(page.locator(".todo")).to_have_text("Mount PQ-3, press Enter")
    page.get_by_role("button", name="Remove PQ-3").click()
    expect(page.locator("#queue-units tbody tr")).to_have_count(3)
    page.click("#close-list")
    expect(page.locator("dialog")).to_contain_text("1 unit not measured")
    page.keyboard.press("Escape")
    expect(page.locator("#close-list")).to_be_focused()
    page.keyboard.press("Enter")
    page.get_by_test_id("confirm").click()
    expect(page.locator(".todo")).to_contain_text("closed")
    assert client.get(f"/api/batches/{batch}").json()["closed_at"]
    expect(page.locator("dialog")).to_have_count(0)
    page.keyboard.type("]C1PQ-7\n")  # what is scanned now is of another list, and its symbology of none
    expect(page.locator("#units")).to_have_value("PQ-7\n")


def test_what_stops_a_unit_is_said_and_a_unit_that_is_to_be_turned_asks_in_the_same_place(
    page, client, go, expect
):
    plan = {**SHORT, "mounts_deg": [0, 120]}
    units = ["PT-1", *(f"PT-{k:03d}" for k in range(300))]
    batch = client.post("/api/batches", json={"units": units, "plan": plan}).raise_for_status().json()
    go(f"#/queue/{batch['id']}")
    expect(page.locator("#queue-units tbody tr")).to_have_count(301)
    pressed(page, expect, "Mount PT-1, press Enter")
    pressed(page, expect, "Clamp PT-1 at 120°, press Enter")
    expect(page.locator("#queue-error")).to_contain_text("120")
    page.get_by_role("button", name="Abort").click()
    expect(page.locator(".big-word")).to_have_text("– STOPPED")
    expect(page.locator(".big-unit")).to_contain_text("aborted")
    expect(page.locator(".todo")).to_have_text("Mount PT-1, press Enter")
    client.post(f"/api/batches/{batch['id']}/close").raise_for_status()


def test_of_several_rigs_enter_means_the_one_whose_board_knows_its_unit(
    fresh_page, expect, launch_rig, store_path
):
    page, rigs = fresh_page, [launch_rig("left", board={"serial": "TW-2"})]
    rigs.append(launch_rig("right", imu={"accel_gain_error_pct": [50, 50, 50]}))
    rigs.append(launch_rig("mute", board={"fault": "silent"}))
    units = ["TW-1", "TW-2", "TW-3", "TW-4"]
    body = {"units": units, "rigs": ["left", "right", "mute"], "plan": LONG}
    with running_service(store_path, *rigs) as service, serving(service) as client:
        batch = client.post("/api/batches", json=body).raise_for_status().json()
        page.goto(f"{client.base_url}/#/queue/{batch['id']}")
        left, right, mute = (page.locator(f"[data-rig-turn={name}]") for name in body["rigs"])
        expect(left.locator(".todo")).to_have_text("TW-2 is mounted, press Enter")
        expect(left.locator(".sight")).to_contain_text("TW-2; TW-1 stays in the batch")
        expect(right.locator(".todo")).to_have_text("Check TW-2, scan it")
        pressed(page, expect, "TW-2 is mounted, press Enter")
        expect(left.locator(".todo")).to_have_text("TW-2 is being measured")
        expect(right.locator(".todo")).to_have_text(
            "Check TW-4, scan it"
        )  # TW-1 stays where it was asked for
        page.keyboard.type("TW-4\n")
        expect(page.locator("#queue-said")).to_contain_text("1.50 g")
        page.keyboard.type("TW-4\n")
        expect(right.locator(".todo")).to_have_text("TW-4 is being measured")
        pressed(page, expect, "Mount TW-3: no board answers yet", mute)
        expect(page.locator("#queue-said")).to_contain_text("Not started")
        assert len(client.get("/api/runs").json()["items"]) == 2
        mute.get_by_role("button", name="Start TW-3 anyway").click()
        expect(mute.locator(".big-unit")).to_contain_text("TW-3")
        page.goto("about:blank")
