"""What the tests of the page share: runs from files, and what is drawn of runs."""

from __future__ import annotations

import json

import numpy as np

BACKLASH_DEG = 0.3
NOISE_DEG = 0.017


def imported(client, unit, bias_deg=0.5, scale=1.01, poses=8, **form):
    """A run of a unit from a file whose readings are bias + scale·θ and a little wobble."""
    lines = ["target_deg,reading_deg,reading_stderr_deg,temperature_c"]
    for k in range(poses):
        target = -40 + 80 * k / (poses - 1)
        lines.append(f"{target},{bias_deg + scale * target + 0.01 * (-1) ** k},0.01,{20 + k}")
    return imported_lines(client, lines, unit, **form)


def imported_lines(client, lines, unit="A", **form):
    """A run from the lines of a CSV; `rig` and `operator` as in the form of an import."""
    files = {"file": ("poses.csv", "\n".join(lines).encode())}
    return client.post("/api/imports", data={"unit": unit, **form}, files=files).raise_for_status().json()


def ambiguous_poses():
    """Even steps up and down, every move as large as the last: backlash and settling are one thing here."""
    noise = np.random.default_rng(0).normal(0, NOISE_DEG, 24)
    there, back = range(-40, 61, 20), range(40, -61, -20)
    targets = [*there, *back, *there, *back]
    approach = [*[1] * 6, *[-1] * 6] * 2
    shift = -BACKLASH_DEG / 2
    poses = [
        f"{x},{0.8 + x + shift * a + e:.4f},{a}" for x, a, e in zip(targets, approach, noise, strict=True)
    ]
    return ["target_deg,reading_deg,approach", "-60,-59.2,0", *poses]


def unfold_plan(page):
    """Opens the fields of the plan, of which the form shows one line."""
    page.locator("#plan-fields > summary").click()


def cancelled_by_who_comes_back(page, expect, work):
    """Work that stands at 40 % says so, after a reload as well, and is cancelled there."""
    expect(page.locator(f"#{work}-says")).to_contain_text("40 % of it is done")
    page.reload()
    expect(page.locator(f"#{work}-says")).to_contain_text("40 % of it is done")
    page.click(f"#{work}-cancel")
    expect(page.locator(f"#{work}-told")).to_have_text("Cancelled: nothing was kept of it.")


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


def figures_of(page, place):
    """What a list of figures says, by the name that each stands beside."""
    rows = page.locator(place).locator("div:has(> dt)")
    both = "rows => rows.map(row => ['dt', 'dd'].map(part => row.querySelector(part).textContent))"
    return dict(rows.evaluate_all(both))


def unfold(page, name):
    """Opens a fold of a run's page, such as `charts`, `poses` or `amend`."""
    page.locator(f"#{name}-fold > summary").click()


def unfold_effect(page, name):
    """Opens the line of an effect."""
    page.locator(f"[data-effect={name}] > details > summary").click()


def row_of(page, table, text):
    """What a table says in the row with a text, by the heading that each cell stands under."""
    row = page.locator(f"{table} tbody tr").filter(has_text=text)
    under = """row => [...row.closest("table").querySelectorAll("thead th")].map(
        (heading, k) => [heading.textContent, row.cells[k].textContent])"""
    return dict(row.evaluate(under))
