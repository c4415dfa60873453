"""A run's page at first sight: is it good, what is the calibration, what next; everything else is folded."""

from __future__ import annotations

import numpy as np
import pytest
from support import QUICK, wait_for

from calrig.calibration.effects import EFFECTS

from .page_help import figures_of, imported_lines, unfold_effect

pytestmark = [pytest.mark.browser, pytest.mark.usefixtures("no_limits")]

DESK, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
NOISE_DEG = 0.017


def poses(backlash_deg=0.0, deg_per_c=0.0, warming=False):
    """Elevations in random order; the temperature goes up and down, or up alone as the time passes."""
    rng = np.random.default_rng(2)
    n = 96
    theta = rng.uniform(-60, 60, n).round(1)
    approach = np.sign(np.diff(theta, prepend=-60.0))
    temperature_c = 25.0 + (np.linspace(0, 6, n) if warming else 4 * np.sin(np.arange(n) / 15))
    reading = 0.8 + theta - backlash_deg / 2 * approach + deg_per_c * (temperature_c - 25.0)
    reading += rng.normal(0, NOISE_DEG, n)
    rows = zip(theta, reading, approach, temperature_c, 4 * np.arange(n), strict=True)
    lines = [f"{x},{y:.4f},{NOISE_DEG},{a:.0f},{c:.3f},{t}" for x, y, a, c, t in rows]
    return ["target_deg,reading_deg,reading_stderr_deg,approach,temperature_c,time_s", *lines]


def diagnosed(client, unit, **errors):
    """A run with errors, and its diagnosis."""
    run = imported_lines(client, poses(**errors), unit, rig="bench-1")
    found = client.post(f"/api/runs/{run['id']}/diagnosis?wait=true", json={}).raise_for_status().json()
    return run, found


def time_is(page, at_ms):
    """Stops the clock that tells a scanner from a person, so that a busy machine changes nothing."""
    page.evaluate("at => (performance.now = () => at)", at_ms)


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_one_screen_says_whether_it_is_good_what_it_is_and_what_comes_next(page, client, go, expect, size):
    run = imported_lines(client, poses(), f"SEEN-{size['width']}", rig="bench-1")
    page.set_viewport_size(size)
    go(f"#/runs/{run['id']}")
    answer = page.get_by_test_id("answer")
    expect(answer.get_by_role("heading")).to_have_text("GOOD")
    expect(answer).to_have_class("verdict answer good")
    expect(answer.locator("p")).to_have_text("Only noise is left.")
    assert list(figures_of(page, "#headline")) == [
        "Bias",
        "Scale",
        "RMS error, calibrated",
        "Expanded uncertainty",
    ]
    expect(page.locator("#download")).to_have_text("Download calibration")
    expect(page.locator("#verify")).to_be_visible()
    expect(page.locator("#view .primary:visible")).to_have_count(1)
    assert page.locator("#next").bounding_box()["y"] < size["height"]
    bottom = page.evaluate("document.querySelector('#next').getBoundingClientRect().bottom")
    assert bottom <= size["height"]
    expect(page.locator("#poses-table, .plot:visible, #provenance")).to_be_hidden()


@pytest.mark.parametrize(
    ("limit", "word", "colour"),
    [
        ({"max_error_deg": 5.0, "rule": "simple"}, "PASS", "good"),
        ({"max_error_deg": 0.01, "rule": "simple"}, "FAIL", "poor"),
        ({"bias_deg": [-5, 5]}, "UNDECIDED", "unknown"),
        (None, "NOT GOOD", "poor"),
    ],
    ids=["pass", "fail", "undecided", "no limits"],
)
def test_the_word_is_that_of_the_limits_and_without_them_that_of_the_residual(
    page, client, go, expect, limit, word, colour
):
    client.put("/api/limits", json=[{"name": "flight", **limit}] if limit else []).raise_for_status()
    run = imported_lines(client, poses(backlash_deg=0.3), f"WORD-{word}", rig="bench-1")
    go(f"#/runs/{run['id']}")
    answer = page.get_by_test_id("answer")
    expect(answer.get_by_role("heading")).to_have_text(word)
    expect(answer).to_have_class(f"verdict answer {colour}")
    expect(page.locator("#next .primary")).to_have_text("Diagnose")


def test_a_voided_run_is_no_calibration_and_leads_to_a_new_one(page, client, go, expect):
    run = imported_lines(client, poses(), "VOID-1", rig="bench-1")
    client.post(f"/api/runs/{run['id']}/void", json={"reason": "the cable caught"}).raise_for_status()
    go(f"#/runs/{run['id']}")
    expect(page.get_by_test_id("answer")).to_contain_text("VOIDED")
    expect(page.get_by_test_id("answer")).to_contain_text("the cable caught")
    expect(page.locator("#next .primary")).to_have_text("Start again")
    page.click("#next .primary")
    expect(page.locator("#unit")).to_have_value("VOID-1")


def test_named_effects_are_accepted_together_in_one_revision_and_the_page_stays_short(
    page, client, go, expect
):
    run, found = diagnosed(client, "TOGETHER-1", backlash_deg=0.3, deg_per_c=0.05)
    assert {effect["name"] for effect in found["effects"]} == {"backlash", "temperature_bias"}
    page.set_viewport_size(DESK)
    go(f"#/runs/{run['id']}")
    accept = page.locator("#accept-all")
    expect(accept).to_have_text("Accept all named (2)")
    step = page.locator("#next")
    expect(step).to_contain_text("Corrects unit TOGETHER-1 for:")
    expect(step).to_contain_text("Stores as errors of rig bench-1, not exported with the unit:")
    assert page.evaluate("document.documentElement.scrollHeight") <= 1500
    before = len(client.get("/api/units/TOGETHER-1/calibrations").json())
    accept.click()
    expect(page.locator("#download")).to_be_focused()
    assert len(client.get("/api/units/TOGETHER-1/calibrations").json()) == before + 1
    kept = client.get(f"/api/runs/{run['id']}").json()["diagnosis"]["effects"]
    assert all(effect["accepted_at"] for effect in kept)
    expect(page.locator(".effect .pill")).to_have_text(["accepted", "accepted"])
    expect(page.get_by_test_id("left-out")).to_have_count(0)
    with page.expect_download() as download:
        page.click("#download")
    assert '"revision":2' in download.value.path().read_text()


def test_an_effect_is_one_line_that_unfolds(page, client, go, expect):
    run, found = diagnosed(client, "LINE-1", backlash_deg=0.3)
    (effect,) = found["effects"]
    assert effect["explained"] > 0.9
    go(f"#/runs/{run['id']}")
    line = page.locator("[data-effect=backlash] > details > summary")
    expect(line.get_by_role("heading")).to_have_text("Backlash of the stage")
    size = effect["parameters"]["backlash_deg"]
    decimals = 1 - int(f"{size['std']:e}".split("e")[1])
    stated = f"{size['value']:.{decimals}f} ± {size['std']:.{decimals}f}°".replace("-", "−")
    expect(line.locator(".size")).to_have_text(stated)
    expect(line).to_contain_text("rig bench-1")
    expect(line.locator(".share")).to_have_text(f"{100 * effect['explained']:.0f} % of the residual")
    assert line.bounding_box()["height"] < 50
    chart = page.get_by_test_id("effect-0")
    expect(chart).to_be_hidden()
    unfold_effect(page, "backlash")
    expect(chart.locator(".plot-container")).to_be_visible()
    formula = page.locator("[data-effect=backlash] .formula dd")
    expect(formula).to_have_text(EFFECTS["backlash"].formula)


def test_what_was_left_out_is_said_and_what_it_means_at_another_temperature(page, client, go, expect):
    run, found = diagnosed(client, "LEFT-1", backlash_deg=0.3, deg_per_c=0.03, warming=True)
    verdicts = {effect["name"]: effect["verdict"] for effect in found["effects"]}
    assert verdicts.pop("backlash") == "named"
    ((_, verdict),) = verdicts.items()
    assert verdict == "ambiguous"  # a unit that only warms up may as well drift
    go(f"#/runs/{run['id']}")
    page.get_by_role("button", name="Accept the named effect").click()
    left_out = page.get_by_test_id("left-out")
    expect(left_out).to_contain_text("Left out: ambiguous: ")
    expect(left_out).to_contain_text("temperature")
    expect(left_out).to_contain_text("holds at the temperatures of this run, 25.0 to 31.0 °C.")
    expect(left_out).to_contain_text("At another temperature its error grows")


def test_a_scan_and_an_early_enter_press_nothing_and_a_later_enter_does(page, client, go, expect):
    run, _ = diagnosed(client, "SCANNED-1", backlash_deg=0.3)
    go("#/")
    time_is(page, 10_000)
    page.evaluate("id => (location.hash = `#/runs/${id}`)", run["id"])
    accept, refused = page.locator("#accept-all"), page.locator("#next-error")
    accept.focus()
    page.keyboard.press("Enter")  # meant for what was there before
    expect(refused).to_contain_text("Enter ignored")
    time_is(page, 20_000)
    page.keyboard.type("AS-0043")
    page.keyboard.press("Enter")  # as a reader ends its line
    expect(accept).to_be_enabled()
    assert client.get(f"/api/runs/{run['id']}").json()["diagnosis"]["effects"][0]["accepted_at"] is None
    time_is(page, 21_000)
    page.keyboard.press("Enter")
    expect(page.locator("#download")).to_be_focused()
    assert client.get(f"/api/runs/{run['id']}").json()["diagnosis"]["effects"][0]["accepted_at"]


def test_once_a_run_has_completed_its_charts_are_folded_and_the_one_button_has_the_focus(
    page, client, go, expect
):
    run = client.post("/api/runs", json={"unit": "DONE-1", "plan": {**QUICK, "sweeps": 8}}).json()
    go(f"#/runs/{run['id']}")
    expect(page.get_by_test_id("timeline").locator(".plot-container")).to_be_visible()
    expect(page.locator("#poses-table tbody tr").first).to_be_visible()
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("#next .primary")).to_be_focused()
    expect(page.get_by_test_id("timeline")).to_be_hidden()
    expect(page.locator("#poses-table")).to_be_hidden()
    page.locator("#charts-fold > summary").click()
    drawn = "() => document.querySelector('[data-testid=timeline]').data?.[0].x.length > 2"
    wait_for(lambda: page.evaluate(drawn), "timeline of the whole run")


def test_who_writes_a_note_when_the_run_completes_keeps_the_focus(page, client, go, expect):
    run = client.post("/api/runs", json={"unit": "NOTE-1", "plan": {**QUICK, "sweeps": 8}}).json()
    go(f"#/runs/{run['id']}")
    page.locator("#amend-fold > summary").click()
    page.click("#note")
    note = page.locator("dialog #note")
    expect(note).to_be_focused()
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("#next .primary")).to_be_attached()
    expect(note).to_be_focused()
