"""Poses made of columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calrig.calibration.poses import Pose


def posed(**columns: ArrayLike | None) -> list[Pose]:
    """A pose a row of columns (n,), named as in a file; one value is that of every pose, None of none."""
    n = np.size(columns["target_deg"])
    cells = {
        name: np.broadcast_to(np.asarray(column, dtype=int if name == "approach" else float), n).tolist()
        for name, column in columns.items()
        if column is not None
    }
    return [Pose.from_row(dict(zip(cells, row, strict=True))) for row in zip(*cells.values(), strict=True)]
