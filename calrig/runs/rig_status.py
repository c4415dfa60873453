"""Report what each rig is doing, without opening a port; also as a bench reports it to its centre."""

from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from calrig.model.service import RigState, RigWork
from calrig.runs.presence import BoardCheck
from calrig.settings import BoardSettings, RigSettings, StageSettings


def state_of(rig: RigSettings, run_id: str | None, *, unreachable: bool) -> RigState:
    """The state of a rig.

    `unreachable` is whether the last run did not reach it.
    """
    state: RigWork = "idle"
    if run_id is not None:
        state = "busy"
    elif unreachable or _port_is_absent(rig):
        state = "unreachable"
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


TOLD = ("limits_deg", "release", "remount_limit_deg", "reference", "filter")
"""Settings that a bench tells its centre."""


def said_of(state: RigState, settings: RigSettings, seen: BoardCheck | None) -> dict[str, Any]:
    """What a bench says of one of its rigs, an entry of `bench.said["rigs"]`; ports are its own affair."""
    return {
        **state.model_dump(include={"name", "stage", "imu", "simulated", "state", "run_id"}),
        "seen": None if seen is None else asdict(seen),
        **settings.model_dump(mode="json", include=set(TOLD)),
    }


def settings_of(said: dict[str, Any]) -> RigSettings:
    """A rig's settings by what its bench says, as far as plans, limits and releases need them.

    Raises:
        ValueError: it says what is no rig (pydantic's ValidationError).
    """
    return RigSettings(
        name=said["name"],
        stage=StageSettings(driver=said.get("stage") or "", port=""),
        imu=BoardSettings(driver=said.get("imu") or "", port=""),
        simulated={} if said.get("simulated") else None,
        **{key: said[key] for key in TOLD if key in said},
    )


def look_of(said: dict[str, Any]) -> BoardCheck | None:
    """What the last look at the rig's board gave, by what its bench says; None where nobody looks.

    Raises:
        ValueError: it says what is no look (pydantic's ValidationError).
    """
    return _looks().validate_python(said.get("seen"))


@cache
def _looks() -> TypeAdapter[BoardCheck | None]:
    return TypeAdapter(BoardCheck | None)
