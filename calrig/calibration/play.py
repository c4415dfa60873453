"""Play: how far a stage has come since it last turned, and what of its play is not taken up yet.

A table that its motor moves with a play h between them stands still until the motor has come by h (the play
operator: Visintin, Differential Models of Hysteresis, 1994, section III.2).
"""

from __future__ import annotations

import numpy as np

from calrig.calibration.channels import BoolArray
from calrig.estimation.angles import FloatArray


def travel_deg(move_deg: FloatArray, approach: FloatArray | None, starts: BoolArray) -> FloatArray:
    """(n,) way in one sense since the stage last turned; infinite where nothing says that it is short.

    Args:
        move_deg: (n,) into each pose; 0 or NaN where it is not known.
        approach: (n,) its sense; a pose come to from beyond has the other one, and all play taken up.
        starts: (n,) whether a pose follows on nothing.
    """
    travel = np.full(len(move_deg), np.inf)
    if approach is None:
        return travel
    for k in range(1, len(travel)):
        if starts[k] or not approach[k] * move_deg[k] > 0.0:
            continue
        before = travel[k - 1] if approach[k] == approach[k - 1] else 0.0
        travel[k] = before + abs(move_deg[k])
    return travel


def slack_deg(play_deg: float, travelled_deg: FloatArray) -> FloatArray:
    """(n,) what is left of a play, after some way."""
    return np.maximum(abs(play_deg) - travelled_deg, 0.0)
