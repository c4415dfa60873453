"""GRBL's states as a stage's."""

from __future__ import annotations

from calrig.instruments.stages.grbl.words import Report
from calrig.instruments.types import StageStatus

DISABLED = {
    "Hold": "HOLD: it stands, and keeps what is left of its move until it is reset",
    "Door": "DOOR: the safety door is open",
    "Sleep": "SLEEP: its motors are off",
}


def status_of(
    report: Report, homing: bool, known: bool, unreferenced: str | None, *, has_switch: bool
) -> StageStatus:
    """What a report says of the stage.

    Args:
        report: the last one.
        homing: whether calrig's own homing is under way.
        known: whether its settings were read; one that moves before that was not moved by calrig.
        unreferenced: why its count is no angle, None while it is one.
        has_switch: whether it can home.
    """
    state = report.state
    if homing or state == "Home":
        return StageStatus("homing", "HOME")
    if report.moves:
        words = state.upper() if known else f"{state.upper()}, not by calrig"
        return StageStatus("moving" if known else "homing", words)
    if state == "Check":
        return StageStatus("configuration", "CHECK: it moves nothing until $C")
    if state in DISABLED:
        return StageStatus("disabled", DISABLED[state])
    if unreferenced or state == "Alarm":
        return StageStatus("not_referenced", f"{state.upper()} ({unreferenced or 'locked'})")
    place = "" if has_switch else ", counting from where it was switched on"
    return StageStatus("ready", f"IDLE{place}")
