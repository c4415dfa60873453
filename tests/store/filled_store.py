"""A store with a run in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from empty_store import lay_empty_store

from calrig.calibration.poses import Pose
from calrig.store import SampleBlock, Store


def block(index: int, n: int = 500) -> SampleBlock:
    noise = np.random.default_rng(index)
    return SampleBlock(
        index, "dwell", np.arange(n) / 200, noise.normal(size=(n, 3)), np.ones((n, 3)), np.full(n, 24.0)
    )


def filled(url: str, result: dict[str, Any] | None = None, poses: int = 20) -> str:
    """A run with poses, samples and events; its id."""
    lay_empty_store(Path(url.removeprefix("sqlite:///")))
    with Store.open(url, writer="test") as store:
        run = store.runs.create(unit="A", rig="r", plan={"step_deg": 5}, status="running", provenance={})
        for k in range(poses):
            pose = Pose(float(k), k + 0.1 * (k % 3), temperature_c=20 + k / 7, covariates={"humidity": k / 3})
            event = ("pose", {"index": k, "reading_deg": k / 7})
            done = {"poses_done": k + 1, "poses_total": poses, "fraction": k / poses, "remaining_s": None}
            store.poses.add(run.id, k, pose, [block(k)], [event], progress=done)
        store.runs.update(run.id, status="completed", result=result)
    return run.id
