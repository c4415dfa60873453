"""Units whose figures are told by several documents: a plain run, accepted effects, a joint solution."""

from __future__ import annotations

from typing import Any

import httpx
from clamped import clamped
from support import ended

IMU = {"accel_bias_mg": [0, 12, -16], "accel_gain_error_pct": [0, 0.8, 0]}
"""Of the simulated unit: errors of its axes, which a diagnosis names."""
PLAN = {
    "start_deg": -60,
    "stop_deg": 60,
    "step_deg": 10,
    "sweeps": 2,
    "settle_s": 0.5,
    "dwell_s": 1.0,
    "jitter_deg": 2,
    "seed": 3,
}
LIMIT = {"name": "flight", "max_error_deg": 1.5, "rms_deg": 0.2, "scale": [0.9, 1.1]}


def measured(client: httpx.Client, unit: str, **plan: Any) -> dict[str, Any]:
    """A completed run of the unit on the rig."""
    run = client.post("/api/runs", json={"unit": unit, "plan": {**PLAN, **plan}}).raise_for_status().json()
    run = ended(client, run["id"])
    assert run["status"] == "completed", run["error"]
    return run


def accepted(client: httpx.Client, unit: str) -> dict[str, Any]:
    """A run of the unit whose named effects were all accepted."""
    path = f"/api/runs/{measured(client, unit)['id']}"
    effects = client.post(f"{path}/diagnosis?wait=true", json={}).raise_for_status().json()["effects"]
    names = [effect["name"] for effect in effects if effect["verdict"] == "named"]
    assert names
    client.post(f"{path}/diagnosis/accept", json={"effects": names}).raise_for_status()
    return client.get(path).json()


def solved(client: httpx.Client, unit: str) -> None:
    """A unit with the revision of a joint solution in force."""
    runs = [clamped(client, unit, angle)["id"] for angle in (0, 120, 240)]
    solution = client.post("/api/solve?wait=true", json={"runs": runs}).raise_for_status().json()["id"]
    body = {"solve": solution, "reason": "three mounts"}
    made = client.post(f"/api/units/{unit}/calibrations", json=body).raise_for_status().json()
    assert made["status"] == "in_force"


def agrees(shown: str, value: float) -> bool:
    """Whether a number as printed is the value, rounded to the digits that it has."""
    text = shown.replace("−", "-")
    decimals = len(text.partition(".")[2])
    return abs(float(text) - value) <= 0.5000001 * 10.0**-decimals
