"""The page when the service dies under it and when it comes back."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys

import httpx
import pytest
from support import LONG, PATIENCE_S, lasting_port, wait_for

from .page_help import unfold

pytestmark = pytest.mark.browser

CONFIG = """
[[rig]]
name = "bench-1"

[rig.simulated]
time_scale = 20.0
stage = { velocity_dps = 60.0, acceleration_dps2 = 240.0, homing_velocity_dps = 30.0 }
"""

DRAWN = "() => document.querySelector('[data-testid=timeline]').data?.[0].x ?? []"
"""The times of the points that are drawn now."""


@pytest.fixture
def serve(tmp_path):
    """Starts `calrig serve` as its users do and returns its process once it answers."""
    config = tmp_path / "calrig.toml"
    config.write_text(CONFIG)
    processes = []

    def serve(port):
        command = [sys.executable, "-m", "calrig", "serve", "--port", str(port)]
        stores = ["--db", str(tmp_path / "calrig.db"), "--config", str(config)]
        process = subprocess.Popen([*command, *stores], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
        processes.append(process)
        assert re.search(rf"http://127\.0\.0\.1:{port}", process.stdout.readline())
        return process

    yield serve
    for process in processes:
        process.terminate()
        process.wait(PATIENCE_S)


def test_a_service_that_dies_is_said_to_be_gone_and_its_run_to_be_interrupted_when_it_is_back(
    fresh_page, serve, forgiven, expect
):
    page, port = fresh_page, lasting_port()
    forgiven.append(r"net::ERR_")
    process = serve(port)
    url = f"http://127.0.0.1:{port}"
    run = httpx.post(f"{url}/api/runs", json={"unit": "MPU-1", "plan": LONG}).raise_for_status().json()
    page.goto(f"{url}/#/runs/{run['id']}")
    expect(page.locator("#poses-table tbody tr").nth(1)).to_be_visible()
    expect(page.locator("#banner")).to_be_hidden()

    os.kill(process.pid, signal.SIGKILL)
    process.wait(PATIENCE_S)
    expect(page.locator("#banner")).to_contain_text("Lost connection")
    page.click("#abort")
    expect(page.locator("#run-error")).to_contain_text("does not answer")
    page.click("button.stop")
    expect(page.locator("#stop-line")).to_contain_text("cut its motor power")

    serve(port)
    expect(page.locator("#banner")).to_be_hidden()
    expect(page.locator("#status")).to_have_text("interrupted")
    expect(page.locator("#abort")).to_be_hidden()
    expect(page.locator("#run-error")).to_be_hidden()
    unfold(page, "charts")  # what is measured is folded once nothing is measured any more
    drawn = wait_for(lambda: page.evaluate(DRAWN), "points of the timeline")
    assert drawn == sorted(drawn)
