"""A unit with a history: imports, a measured run with samples, accepted effects, amendments, revisions."""

from __future__ import annotations

import numpy as np
from dated_runs import gave
from kept_maps import solved

from calrig.analysis.amendments import Records
from calrig.analysis.certificates import archive_of
from calrig.analysis.revisions import Issuer
from calrig.analysis.stage_maps import provenance_part, put_in_force
from calrig.calibration.poses import Pose
from calrig.store import AcceptedEffect, SampleBlock, Store

UNIT = "AS/42 ä"
MAPPED = "M-2"


def poses_csv(seed: int, n: int = 24) -> bytes:
    """Readings with an offset that rises with temperature, and backlash of the stage."""
    rng = np.random.default_rng(seed)
    rows = ["target_deg,reading_deg,approach,temperature_c,time_s,+5V"]
    for k in range(n):
        theta, approach, warm = 60 * np.sin(k), (-1) ** k, 20 + k / 4
        reading = 0.8 + 1.002 * theta + 0.02 * (warm - 23) - 0.03 * approach + rng.normal(0, 0.01)
        rows.append(f"{float(theta)!r},{float(reading)!r},{approach},{warm},{4.0 * k},{5 + k / 1000}")
    return "\n".join(rows).encode()


def block(index: int, phase: str, n: int = 40) -> SampleBlock:
    noise = np.random.default_rng(index)
    angles = None if phase == "move" else np.full(n, 1.5)
    accel_g, gyro_dps = noise.normal(size=(n, 3)), np.full((n, 3), np.nan)
    return SampleBlock(index, phase, np.arange(n) / 200, accel_g, gyro_dps, np.full(n, 24.0), angles)


def fill(store: Store) -> None:
    """Makes the unit, a run of another one in between, and one that goes on."""
    issuer = Issuer(store)
    records = Records(store, issuer)

    def imported(unit: str, seed: int) -> str:
        return records.import_poses(unit=unit, rig="bench-1", file_name="p.csv", content=poses_csv(seed)).id

    first = imported(UNIT, 1)
    imported("somebody else's", 2)
    warm = AcceptedEffect(
        first, UNIT, None, "temperature_bias", "sensor", {"deg_per_c": 0.02, "reference_c": 23.0}
    )
    play = AcceptedEffect(first, None, "bench-1", "backlash", "stage", {"backlash_deg": -0.06})
    store.effects.accept(first, [warm, play], who="ada")
    issuer.draft(UNIT, first, by="ada", reason="effects accepted")
    records.exclude_pose(first, 5, "somebody leant \u2028 on the 'bench' \\ 温度", who="ada")
    imported(UNIT, 3)
    issuer.withdraw(UNIT, 4, by="ada", reason="a test")
    measured(store, "completed")
    measured(store, "running")
    by_a_map(store, issuer)


def by_a_map(store: Store, issuer: Issuer) -> None:
    """A unit whose elevations rest on the map of a stage, what was accepted of that stage beside it."""
    put_in_force(store, "bench-2", store.solutions.save(solved("bench-2")).id, who=None)
    kept = provenance_part(store, "bench-2", {})
    dial = np.repeat(np.linspace(-60.0, 60.0, 7), 2).tolist()
    poses = [Pose(theta, 0.5 + 1.001 * theta, approach=(-1) ** k) for k, theta in enumerate(dial)]
    given = {"plan": None, "status": "completed", "provenance": kept, "poses": poses, "result": gave()}
    run = store.runs.create(unit=MAPPED, rig="bench-2", **given)
    play = AcceptedEffect(run.id, None, "bench-2", "backlash", "stage", {"backlash_deg": 0.06})
    store.effects.accept(run.id, [play], who="ada")
    issuer.draft(MAPPED, run.id, by="ada")


def measured(store: Store, status: str) -> None:
    run = store.runs.create(
        unit=UNIT, rig="bench-1", plan={"kind": "static"}, status="running", provenance={}
    )
    for k in range(3):
        done = {"poses_done": k + 1, "poses_total": 3, "fraction": (k + 1) / 3, "remaining_s": None}
        samples = [block(k, "move"), block(k, "dwell")]
        store.poses.add(run.id, k, Pose(10.0 * k, 10.1 * k), samples, progress=done)
    if status != "running":
        store.runs.update(run.id, status="completed")


def archive(store: Store, unit: str = UNIT) -> bytes:
    """Of a unit, with the certificates that were issued."""
    return b"".join(archive_of(store, unit))
