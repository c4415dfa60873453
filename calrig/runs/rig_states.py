"""What each rig is doing, as far as it can be told without opening a port."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from calrig.settings import RigSettings


@dataclass(frozen=True, slots=True)
class RigState:
    """A rig as `GET /api/rigs` shows it; of a centre's, with the bench that has it and when that was seen."""

    name: str
    stage: str
    imu: str
    simulated: bool
    state: str
    run_id: str | None
    bench: str | None = None
    hall: str | None = None
    last_seen_at: datetime | None = None
    clamp: str | None = None


def state_of(rig: RigSettings, run_id: str | None, *, unreachable: bool) -> RigState:
    """The state of a rig.

    Args:
        rig: as configured.
        run_id: the run that it carries out, or None.
        unreachable: whether the last run did not reach it.
    """
    if run_id is not None:
        state = "busy"
    elif unreachable or _port_is_absent(rig):
        state = "unreachable"
    else:
        state = "idle"
    return RigState(
        name=rig.name,
        stage=rig.stage.driver if rig.stage else "",
        imu=rig.imu.driver if rig.imu else "",
        simulated=rig.simulated is not None,
        state=state,
        run_id=run_id,
        clamp=None if rig.clamp is None else rig.clamp.driver,
    )


def _port_is_absent(rig: RigSettings) -> bool:
    ports = [part.port for part in (rig.stage, rig.imu) if part is not None]
    return any(port.startswith("/") and not Path(port).exists() for port in ports)
