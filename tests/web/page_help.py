"""What the tests of the page share: runs measured and imported, and what is drawn of them."""

from __future__ import annotations

import json

from support import QUICK, ended


def measured(client, unit, **plan):
    """A run of a unit, measured to its end."""
    started = client.post("/api/runs", json={"unit": unit, "plan": {**QUICK, **plan}}).raise_for_status()
    return ended(client, started.json()["id"])


def imported(client, unit, bias_deg=0.5, scale=1.01, poses=8):
    """A run of a unit from a file whose readings are bias + scale·θ and a little wobble."""
    lines = ["target_deg,reading_deg,reading_stderr_deg,temperature_c"]
    for k in range(poses):
        target = -40 + 80 * k / (poses - 1)
        lines.append(f"{target},{bias_deg + scale * target + 0.01 * (-1) ** k},0.01,{20 + k}")
    files = {"file": ("poses.csv", "\n".join(lines).encode())}
    return client.post("/api/imports", data={"unit": unit}, files=files).raise_for_status().json()


def readings(client, run_id):
    """The times of all readings that an ended run has announced."""
    lines = client.get(f"/api/runs/{run_id}/events").text.splitlines()
    data = [json.loads(line.removeprefix("data:")) for line in lines if line.startswith("data:")]
    return [event["time_s"] for event in data if "reading_deg" in event and "index" not in event]


def until_pose(client, run_id, count):
    """The text of a run's event stream up to so many poses."""
    lines = []
    with client.stream("GET", f"/api/runs/{run_id}/events") as stream:
        for line in stream.iter_lines():
            lines.append(line)
            if lines.count("event: pose") == count and not line:
                return "\n".join([*lines, ""])
    raise AssertionError("the stream ended before")


def line_x(page, chart):
    """The x values of a chart's first line, as they are drawn now."""
    return page.evaluate("chart => document.querySelector(`[data-testid=${chart}]`).data?.[0].x ?? []", chart)
