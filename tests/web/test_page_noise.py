"""The noise page: a log is kept on a rig or brought as a file, and told in words, figures and pictures."""

from __future__ import annotations

import re

import numpy as np
import pytest
from support import wait_for

from .page_help import row_of

pytestmark = pytest.mark.browser


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
