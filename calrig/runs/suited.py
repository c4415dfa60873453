"""Whether board and stage suit a run, once they have said who they are and before anything moves."""

from __future__ import annotations

import math

from calrig.estimation.autoregressive import MIN_SAMPLES
from calrig.instruments.errors import BoardError, LimitError
from calrig.runs.rig import Rig
from calrig.runs.task import Task


def require_suited(rig: Rig, task: Task) -> None:
    """Raises where the board does not suit unit or plan, or a pose is beyond the controller's limits."""
    board, unit, name = rig.board_identity, task.run.unit, task.rig.name
    if board.serial and board.serial != unit:
        raise BoardError(
            f"rig {name!r}: the board says it is unit {board.serial!r}, the run is for unit "
            f"{unit!r}; nothing was moved: mount the right unit or correct the serial number"
        )
    if task.plan.kind == "sweep" and not board.sends_rates:
        raise BoardError(
            f"rig {name!r}: board {board.driver} sends no rates and accelerations, which a sweep needs; "
            "nothing was moved: take a plan of dwells"
        )
    if board.rate_hz is not None:
        _require_long_dwell(name, task.plan.dwell_s, board.rate_hz)
    elif board.max_rate_hz is not None and task.plan.rate_hz > board.max_rate_hz:
        raise BoardError(
            f"rig {name!r}: the plan asks for {task.plan.rate_hz} Hz and the board gives "
            f"{board.max_rate_hz} Hz at most; nothing was moved: lower rate_hz"
        )
    low, high = rig.axis.limits_deg  # the controller's own may be narrower than those of the configuration
    for pose in task.planned:
        if not low <= pose.target_deg <= high:
            raise LimitError(
                f"rig {name!r}: elevation {pose.target_deg:g}° is beyond the limits of rig and "
                f"controller together, {low:g}° to {high:g}°; nothing was moved: change the plan, or the "
                "controller's limits"
            )


def _require_long_dwell(name: str, dwell_s: float, rate_hz: float) -> None:
    """A board that has one rate only may be too slow for the plan's dwell."""
    count = dwell_s * rate_hz
    if count < MIN_SAMPLES:
        enough_s = math.ceil(2 * (MIN_SAMPLES + 1) / rate_hz) / 2
        raise BoardError(
            f"rig {name!r}: the board gives {rate_hz:.1f} samples a second and no other rate: a "
            f"dwell of {dwell_s:g} s holds about {count:.0f}, a reading needs {MIN_SAMPLES}; "
            f"nothing was moved: dwell longer (dwell_s at least {enough_s:g})"
        )
