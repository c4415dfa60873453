"""What a plan waits for before each of its sweeps."""

from __future__ import annotations

from calrig.instruments.errors import BoardError
from calrig.plan import Plan
from calrig.runs.pace import Pace

TEMPERATURE_WAIT_S = 4 * 3600.0


def wait_before_sweep(plan: Plan, pace: Pace) -> None:
    """A time, then a die temperature, reached from whichever side."""
    end_s = pace.stream.clock_s + plan.wait_s
    while pace.stream.clock_s < end_s:
        pace.stand_by()
    wanted_c = plan.wait_temperature_c
    if wanted_c is not None:
        _wait_for_temperature(pace, wanted_c)


def _wait_for_temperature(pace: Pace, wanted_c: float) -> None:
    pace.synchronise()
    began_s, began_c = pace.stream.clock_s, pace.stream.temperature_c
    while (now_c := pace.stream.temperature_c) is not None and began_c is not None:
        if (now_c >= wanted_c) if began_c < wanted_c else (now_c <= wanted_c):
            return
        if pace.stream.clock_s - began_s > TEMPERATURE_WAIT_S:
            raise BoardError(
                f"the board has come from {began_c:.1f} °C to {now_c:.1f} °C and not to {wanted_c:g} °C "
                f"within {TEMPERATURE_WAIT_S / 3600:g} h; choose a temperature that it reaches"
            )
        pace.stand_by()
    raise BoardError("the plan waits for a temperature, and this board does not send one")
