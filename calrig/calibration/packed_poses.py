"""Poses of many runs as one table of arrays: what stores and files of a fleet hold, and a screen reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.poses import COLUMNS, MOUNT_DEG, OF_MOUNTS, Pose
from calrig.estimation.angles import FloatArray, Intp, wrap_deg


@dataclass(frozen=True, slots=True, eq=False)
class PackedPoses:
    """The poses that count of R runs, N together, each run's in the order measured.

    Attributes:
        run_ids: of the R runs.
        first: (R + 1,) where each run's poses begin, and N.
        columns: (N,) each: CONTRACT section 4's numeric columns and covariates by name, NaN where not known.
        units, rigs: (R,) what each run is of and was made on, None where not known.
    """

    run_ids: tuple[str, ...]
    first: Intp
    columns: Mapping[str, FloatArray]
    units: tuple[str | None, ...]
    rigs: tuple[str | None, ...]

    def __len__(self) -> int:
        return len(self.run_ids)

    @property
    def counts(self) -> Intp:
        """(R,) poses of each run."""
        return np.diff(self.first)

    @property
    def theta_deg(self) -> FloatArray:
        """(N,) the elevation that each pose stands for, as `Pose.theta_deg`."""
        target, stage = self.columns["target_deg"], self.columns.get("stage_deg")
        dial = target
        if stage is not None:
            turned = np.where(np.abs(stage - target) > 180.0, target + wrap_deg(stage - target), stage)
            dial = np.where(np.isnan(stage), target, turned)
        mount = self.columns.get(MOUNT_DEG)
        return dial if mount is None else dial + wrap_deg(np.nan_to_num(mount))

    @property
    def covariates(self) -> list[str]:
        """Columns that CONTRACT section 4 does not know."""
        return [name for name in self.columns if name not in (*COLUMNS, *OF_MOUNTS)]

    def of_first_mounts(self) -> PackedPoses:
        """Of runs with several mounts, the poses of the first one, as `of_first_mount`."""
        mount = self.columns.get(MOUNT_DEG)
        if mount is None or not len(mount):
            return self
        mount_deg = np.nan_to_num(mount)
        of_run = np.repeat(np.arange(len(self)), self.counts)
        at_first_deg = mount_deg[np.minimum(self.first[:-1], len(mount_deg) - 1)]
        kept = mount_deg == at_first_deg[of_run]
        counts = np.bincount(of_run[kept], minlength=len(self))
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
        return replace(
            self, first=first, columns={name: column[kept] for name, column in self.columns.items()}
        )

    def runs(self, chosen: Intp) -> PackedPoses:
        """Some of the runs, in the order given."""
        counts = self.counts[chosen]
        first = np.concatenate([[0], np.cumsum(counts)])
        rows = np.repeat(self.first[chosen] - first[:-1], counts) + np.arange(first[-1])
        columns = {name: column[rows] for name, column in self.columns.items()}
        run_ids, units, rigs = (
            tuple(names[k] for k in chosen.tolist()) for names in (self.run_ids, self.units, self.rigs)
        )
        return PackedPoses(run_ids, first, columns, units, rigs)


def packed(runs: Mapping[str, Sequence[Pose]]) -> PackedPoses:
    """Poses of runs by id, as arrays, of units and rigs that are not told."""
    rows = [pose.row() for poses in runs.values() for pose in poses]
    counts = [len(poses) for poses in runs.values()]
    names = dict.fromkeys(name for row in rows for name in row)
    # None becomes NaN
    columns = {name: np.array([row.get(name) for row in rows], dtype=np.float64) for name in names}
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    unknown = (None,) * len(runs)
    return PackedPoses(tuple(runs), first, columns, unknown, unknown)
