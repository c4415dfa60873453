"""The program's own dead time between units: `python -m tests.benchmarks.queue_pace [UNITS] [BOOT_S]`.

`calrig serve` with its demo rig, the real page in the system's Chromium, one press of Enter a unit. Counted
is what no person causes: from the end of a run until the page asks for the next unit, and from Enter until
the stage moves, which the first reading of the run's event stream tells. The issue asks for 3 s at most. With
BOOT_S the board is reset whenever its port is opened and then hears nothing for so long, as an Arduino.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path

from playwright.sync_api import sync_playwright
from rich import print as told

from tests.studies.trials.served import Served

AIM_S = 3.0
PLAN = {"elevations_deg": [-20, 20], "sweeps": 1, "settle_s": 0.2, "dwell_s": 0.5}
TIME_SCALE = 6.0
DEMO = """
[[rig]]
name = "demo"
simulated = {{ preset = "demo", time_scale = {:g}, ports = "tcp", board = {{ boot_s = {:g} }} }}
"""


def main(n_units: int, boot_s: float) -> int:
    """Prints the median and the worst, and how often Enter was pressed."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        config = Path(folder) / "calrig.toml"
        config.write_text(DEMO.format(TIME_SCALE, TIME_SCALE * boot_s), encoding="utf-8")
        served = Served(config, Path(folder) / "calrig.db")
        try:
            browser = playwright.chromium.launch(
                executable_path="/usr/bin/chromium", args=["--headless=new", "--no-sandbox"]
            )
            dead_s, presses = measured(served, browser.new_page(), n_units)
            browser.close()
        finally:
            served.terminate()
    worst_s, median_s = max(dead_s), statistics.median(dead_s)
    told(f"{len(dead_s)} changes of unit: median {median_s:.2f} s, worst {worst_s:.2f} s, aim {AIM_S:g} s;")
    told(f"{presses} presses of Enter for {n_units} units")
    return 0 if worst_s <= AIM_S and presses == n_units else 1


def measured(served, page, n_units: int) -> tuple[list[float], int]:
    """Dead time of each change, s, and presses of Enter."""
    units = [f"AS-{k:04d}" for k in range(n_units)]
    page.goto(f"{served.client.base_url}/#/queue")
    batch = served.client.post("/api/batches", json={"units": units, "plan": PLAN}).raise_for_status().json()
    page.goto(f"{served.client.base_url}/#/queue/{batch['id']}")
    dead_s: list[float] = []
    ended_s, presses = None, 0
    for unit in units:
        page.get_by_text(f"Mount {unit}, press Enter").wait_for()
        page.locator("#scan").focus()
        asked_s = time.time()
        page.wait_for_timeout(1000)  # a person's: nobody mounts a unit sooner
        pressed_s = time.time()
        page.keyboard.press("Enter")
        presses += 1
        page.get_by_text(f"{unit} is being measured").wait_for()
        run = served.client.get(f"/api/runs?unit={unit}").json()["items"][0]
        moved_s = first_move(served, run["id"])
        if ended_s is not None:
            dead_s.append((asked_s - ended_s) + (moved_s - pressed_s))
            told(
                f"{unit}: asked for after {asked_s - ended_s:.2f} s, moves after {moved_s - pressed_s:.2f} s"
            )
        ended = served.client.get(f"/api/runs/{run['id']}").json()
        ended_s = datetime.fromisoformat(ended["finished_at"]).timestamp()
    return dead_s, presses


def first_move(served, run_id: str) -> float:
    """When the first reading of a move came, s since 1970; returns once the run has ended."""
    moved_s = None
    with served.client.stream("GET", f"/api/runs/{run_id}/events", timeout=120) as stream:
        for line in stream.iter_lines():
            if moved_s is None and line.startswith("data:") and "reading_deg" in json.loads(line[5:]):
                moved_s = time.time()
    assert moved_s is not None, f"run {run_id} never moved"
    return moved_s


if __name__ == "__main__":
    asked = argparse.ArgumentParser(prog="python -m tests.benchmarks.queue_pace", description=__doc__)
    asked.add_argument("units", nargs="?", type=int, default=11, help="two or more: changes are timed")
    asked.add_argument("boot_s", nargs="?", type=float, default=0.0)
    given = asked.parse_args()
    if given.units < 2:
        asked.error("one unit has no change of unit to be timed: two or more")
    sys.exit(main(given.units, given.boot_s))
