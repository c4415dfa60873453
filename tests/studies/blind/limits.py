"""How large an effect has to be to be seen: the detection limit of a run's poses in their noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .causes import Draw
from .layout import Layout, timeline
from .physics import Cause, Noise, shape_deg

AT_THE_LIMIT = 40.0
"""Distance in −2 log likelihood between the readings with and without an effect, bias and scale fitted and
the noise known, at which a search of the whole catalogue in 100 poses finds it in most runs."""
TIMES_THE_LIMIT = 5.0


@dataclass(frozen=True)
class Part:
    """A cause of a size yet to be chosen.

    Attributes:
        make: of a size.
        trial: a size at which its shape in the readings is about that at the size sought.
        size: where it is not to be so many times the limit.
    """

    make: Callable[[float], Draw]
    trial: float
    size: float | None = None

    def cause(self, layout: Layout, noise: Noise, around: Mapping[str, Any], seed: list[int]) -> Cause:
        """Drawn by a seed, at its own size or at `TIMES_THE_LIMIT` times the limit of this very run."""
        when = timeline(layout)

        def of(size: float) -> Cause:
            return self.make(size)(np.random.default_rng(seed), when)

        if self.size is not None:
            return of(self.size)
        found = distance(shape_deg(layout, of(self.trial), around), when.target_deg, noise)
        return of(self.trial * TIMES_THE_LIMIT * math.sqrt(AT_THE_LIMIT / found))


def distance(shape_deg: np.ndarray, target_deg: np.ndarray, noise: Noise) -> float:
    """−2 log likelihood that a shape (n,) in the readings is worth beside bias and scale, the noise known."""
    line = np.column_stack([np.ones_like(target_deg), target_deg])
    left = shape_deg - line @ np.linalg.lstsq(line, shape_deg, rcond=None)[0]
    return float(left @ left) / noise.reading_deg**2
