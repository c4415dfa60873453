"""What is kept with a run of who measured it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from calrig.analysis.errors import NotTheSame
from calrig.instruments.types import BoardIdentity, StageIdentity
from calrig.runs.resume import require_same_devices
from calrig.runs.rig import Rig
from calrig.settings import BoardSettings, RigSettings, StageSettings

MOTORS_OFF = "$1=25 switches the motors off after each move: set $1=255."


@pytest.fixture
def rig():
    settings = RigSettings(
        name="bench-1",
        stage=StageSettings(driver="grbl", port="loop://stage"),
        imu=BoardSettings(driver="calrig", port="loop://board"),
    )
    stage = StageIdentity("grbl", "Grbl 1.1h", None, 20.0, 100.0, warnings=(MOTORS_OFF,))
    board = BoardIdentity("calrig", "1.0", "AS-1", "MPU-6050", 2, 250, 1000)
    return Rig(settings, None, None, None, None, stage, board, None, {})


def test_the_warnings_of_a_stage_are_kept_with_the_run(rig):
    assert rig.provenance()["warnings"] == [MOTORS_OFF]
    assert (
        "warnings" not in replace(rig, stage_identity=replace(rig.stage_identity, warnings=())).provenance()
    )


def test_a_setting_put_right_keeps_no_run_from_being_resumed(rig):
    run = SimpleNamespace(id="1", provenance=rig.provenance())
    require_same_devices(run, replace(rig, stage_identity=replace(rig.stage_identity, warnings=())))
    with pytest.raises(NotTheSame, match="firmware"):
        require_same_devices(
            run, replace(rig, stage_identity=replace(rig.stage_identity, firmware="Grbl 1.1f"))
        )
