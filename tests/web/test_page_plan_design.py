"""What the page works out without a rig: a plan for an uncertainty, and the noise in a log."""

from __future__ import annotations

import re

import numpy as np
import pytest
from support import wait_for

from calrig.api import jobs, plans

from .page_help import row_of, unfold_plan
from .slow_work import LET_GO, slow_answer

pytestmark = pytest.mark.browser

PHONE = {"width": 390, "height": 800}


def test_a_plan_is_designed_taken_by_the_form_and_ends_once_it_is_good_enough(
    page, client, go, expect, forgiven
):
    forgiven.append("status of 422")
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    go("#/")
    page.set_viewport_size(PHONE)
    page.fill("#unit", "AS-D")
    unfold_plan(page)
    page.locator("#designer summary").click()
    page.fill("#target_u_deg", "0.1")
    page.press("#target_u_deg", "Enter")
    expect(page.locator("#design-refused")).to_contain_text("stage")
    page.fill("#target_u_deg", "0.55")
    page.check("#stop-early")
    page.uncheck("#may-sweep")  # of a rig whose time runs faster than its machine's
    page.click("#design")
    expect(page.locator("#designed")).to_contain_text("Lower bound of the time")
    expect(page.locator("#design-suspects tbody tr")).to_have_count(9)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    found = axe.Axe().run(page, context="#designer")
    assert found.violations_count == 0, found.generate_report()
    page.click("#use-plan")
    expect(page.locator("#plan-summary")).to_contain_text("28 poses, −60° to 60°, at most about")
    page.fill("#settle_s", "0.3")
    page.click("#start")
    expect(page.locator("#status")).to_have_text("completed")
    run = client.get(f"/api/runs/{page.url.rpartition('/')[2]}").json()
    assert run["plan"]["until"]["expanded_uncertainty_deg"] == 0.55
    assert run["result"]["stopped_by"] == "until"
    assert run["result"]["n_poses"] < 28


def test_a_design_that_takes_long_shows_how_far_it_is_and_may_be_cancelled(page, go, expect, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    monkeypatch.setattr(plans, "answer", slow_answer)
    monkeypatch.setattr(plans, "wall_pace", lambda *_: 1.0)  # however fast the rig's time runs here
    LET_GO.unlink(missing_ok=True)
    go("#/")
    unfold_plan(page)
    page.locator("#designer summary").click()
    page.fill("#time_s", "60")
    page.click("#design")
    expect(page.locator("#design-says")).to_contain_text("40 % of the designs are tried")
    page.click("#design-cancel")
    expect(page.locator("#designed")).to_have_text("Cancelled.")
    expect(page.locator("#design-progress")).to_be_hidden()
    LET_GO.touch()
    page.click("#design")
    expect(page.locator("#designed")).to_contain_text("traverses")
    LET_GO.unlink()
    page.click("#use-plan")
    expect(page.locator("#as-turns")).to_be_checked()
    expect(page.locator("#plan-summary")).to_contain_text("°, about")


def test_a_log_is_kept_on_the_rig_and_its_noise_shown(page, go, expect):
    go("#/noise")
    page.fill("#unit", "N-1")
    page.fill("#minutes", "0.5")
    page.click("#keep-log")
    page.wait_for_url("**/#/runs/*")
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("#poses-table")).to_be_hidden()
    page.click("#study")
    rows = page.locator("#noise tbody tr")
    expect(rows).to_have_count(8)  # three axes twice, temperature, and the elevation
    # of 300 white logs one shows a line by chance
    expect(rows.filter(has_text="gyro_x_dps")).to_contain_text(re.compile("white|lines"))
    axis = "document.querySelector('[data-testid=noise-0]').layout?.xaxis?.type"
    wait_for(lambda: page.evaluate(axis) == "log", "chart")
    expect(page.locator("#summary li").first).to_be_visible()


def test_a_file_of_ones_own_is_analysed_and_a_bad_one_refused_in_place(page, go, expect, forgiven, tmp_path):
    rng = np.random.default_rng(1)
    samples = enumerate(rng.normal([0.0, 1.0], 4e-3, (3000, 2)))
    rows = "\n".join(f"{k / 100},{y:.6f},{z:.6f}" for k, (y, z) in samples)
    log = tmp_path / "mine.csv"
    log.write_text(f"time_s,accel_y_g,accel_z_g\n{rows}\n")
    go("#/noise")
    page.set_input_files("#log", log)
    page.click("#analyse")
    expect(page.locator("#noise tbody tr")).to_have_count(3)  # y, z, and the elevation
    white = row_of(page, "#noise", "accel_y_g")["White noise, density"]
    assert white.endswith("µg/√Hz")
    expect(page.locator("#summary")).to_contain_text(white)  # one number, one unit
    page.get_by_role("link", name="mine.csv").click()
    expect(page.locator("h1")).to_have_text("Noise of mine.csv")
    expect(page.locator("#noise")).to_contain_text(white)
    page.click("#remove-study")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#studies")).to_contain_text("None yet")
    page.set_input_files("#log", log)

    page.select_option("#what", "filters")
    page.click("#analyse")
    expect(page.locator("#filters tbody tr").first).to_contain_text("°")

    forgiven.append(r"status of 422")
    log.write_text("time_s,accel_y_g,accel_z_g\n0,0,one\n")
    page.set_input_files("#log", log)
    page.click("#analyse")
    expect(page.locator("#noise-error")).to_contain_text("line 2")
