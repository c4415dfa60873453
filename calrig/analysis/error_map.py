"""The rig error map: the mean residual over units, which none of them has of its own."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

from calrig.analysis.stored_runs import counted_poses
from calrig.calibration.result import residuals
from calrig.store import Store

FEWEST_UNITS = 3
PLACE_DEG = 1.0
"""Poses closer than this in elevation are taken for one place."""
CAVEAT = "common firmware, a common cable or a common sensor design would look the same"


@dataclass(frozen=True, slots=True)
class ErrorMap:
    """Mean residual over units by elevation and approach, with its standard error between units."""

    stage_deg: list[float]
    approach: list[int]
    error_deg: list[float]
    std_deg: list[float]
    units: int
    caveat: str = CAVEAT

    @property
    def says(self) -> str:
        """What to keep in mind of it, or why there is none yet."""
        if self.stage_deg:
            return f"Note that {self.caveat}."
        if self.units < FEWEST_UNITS:
            has = "there is 1" if self.units == 1 else f"there are {self.units}"
        else:
            has = f"{self.units} units have none in common"
        return (
            f"Not known yet: the map needs calibrations of {FEWEST_UNITS} units on this rig over the same "
            f"elevations; {has}."
        )


def error_map(store: Store, rig: str) -> ErrorMap:
    """The latest calibration of each unit on the rig, averaged; empty with fewer than three units."""
    latest: dict[str, str] = {}
    for row in store.comparison():
        if row.rig == rig and row.result["scale"] is not None:
            latest[row.unit] = row.run_id
    if len(latest) < FEWEST_UNITS:
        return ErrorMap([], [], [], [], len(latest))
    places: dict[tuple[float, int], list[list[float]]] = defaultdict(list)
    for run_id in latest.values():
        for place, errors in _by_place(store, run_id).items():
            places[place].append(errors)
    found = []
    for (elevation, approach), of_units in sorted(places.items()):
        means = [sum(errors) / len(errors) for errors in of_units]
        if len(means) >= FEWEST_UNITS:
            mean = sum(means) / len(means)
            variance = sum((m - mean) ** 2 for m in means) / (len(means) - 1)
            found.append((elevation, approach, mean, math.sqrt(variance / len(means))))
    columns = list(zip(*found, strict=True)) or [(), (), (), ()]
    elevations, approaches, errors_deg, stds = (list(column) for column in columns)
    return ErrorMap(elevations, approaches, errors_deg, stds, len(latest))


def _by_place(store: Store, run_id: str) -> dict[tuple[float, int], list[float]]:
    run = store.run(run_id)
    poses = counted_poses(store, run_id)
    places: dict[tuple[float, int], list[float]] = defaultdict(list)
    if run is None or run.result is None:
        return places
    left = residuals(poses, run.result["bias_deg"], run.result["scale"])
    for pose, error in zip(poses, left, strict=True):
        if error is not None:
            place = PLACE_DEG * round(pose.theta_deg / PLACE_DEG)
            places[place, pose.approach or 0].append(error)
    return places
