"""Rigs as a bench tells its centre of them with each heartbeat, and as the centre reads that again."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache
from typing import Any

from pydantic import TypeAdapter

from calrig.runs.look import Look
from calrig.runs.rig_states import RigState
from calrig.settings import BoardSettings, RigSettings, StageSettings

TOLD = ("limits_deg", "release", "remount_limit_deg", "reference", "filter")
"""Settings that a bench tells its centre."""


def said_of(state: RigState, settings: RigSettings, seen: Look | None) -> dict[str, Any]:
    """What a bench says of one of its rigs, an entry of `bench.said["rigs"]`; ports are its own affair."""
    return {
        "name": state.name,
        "stage": state.stage,
        "imu": state.imu,
        "simulated": state.simulated,
        "state": state.state,
        "run_id": state.run_id,
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


def look_of(said: dict[str, Any]) -> Look | None:
    """What the last look at the rig's board gave, by what its bench says; None where nobody looks.

    Raises:
        ValueError: it says what is no look (pydantic's ValidationError).
    """
    return _looks().validate_python(said.get("seen"))


@cache
def _looks() -> TypeAdapter[Look | None]:
    return TypeAdapter(Look | None)
