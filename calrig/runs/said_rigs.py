"""Rigs as a bench tells its centre of them with each heartbeat, and as the centre reads that again."""

from __future__ import annotations

from typing import Any

from calrig.runs.rig_states import RigState
from calrig.settings import BoardSettings, RigSettings, StageSettings


def said_of(state: RigState, settings: RigSettings) -> dict[str, Any]:
    """What a bench says of one of its rigs, an entry of `bench.said["rigs"]`; ports are its own affair."""
    return {
        "name": state.name,
        "stage": state.stage,
        "imu": state.imu,
        "simulated": state.simulated,
        "state": state.state,
        "run_id": state.run_id,
        **settings.model_dump(mode="json", include={"limits_deg", "release", "reference", "filter"}),
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
        **{key: said[key] for key in ("limits_deg", "release", "reference", "filter") if key in said},
    )
