"""Stages other than the SMC100 in whole runs: simulated on their wire, known to the service by its driver."""

from __future__ import annotations

import pytest
from support import FAST, LONG, QUICK, running_service, wait_for

from calrig.plan import Plan
from calrig.settings import BoardSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.grbl import State
from calrig.simulator.rig import SimulatedRig

OFFSET_DEG = 0.8
"""The mount's, in `support.FAST`."""


@pytest.mark.parametrize("driver", ["grbl", "esp301"])
def test_it_calibrates_a_unit(driver, launch_rig, store_path):
    rig = launch_rig(f"bench-{driver}", stage={"driver": driver})
    rig = rig.model_copy(update={"stage": rig.stage.model_copy(update={"driver": driver})})
    with running_service(store_path, rig) as service:
        run = service.wait(service.start(unit="AS-1", rig=rig.name, plan=Plan.model_validate(QUICK)).id, 60)
        assert run.status == "completed", run.error
        assert run.result["n_poses"] == 6
        assert run.result["bias_deg"] == pytest.approx(OFFSET_DEG, abs=0.1)
        assert run.result["scale"] == pytest.approx(1.0, abs=0.005)
        assert run.provenance["stage"]["driver"] == driver


@pytest.mark.parametrize("homing", [True, False], ids=["with a switch", "without"])
def test_a_stepper_that_is_reset_on_the_way_fails_the_run_and_gives_no_angle(homing, store_path):
    options = {**FAST, "stage": {**FAST["stage"], "driver": "grbl", "homing": homing}}
    with SimulatedRig(SimulatorSettings.from_options(options)) as simulated:
        rig = RigSettings(
            name="bench-1",
            stage=StageSettings(driver="grbl", port=simulated.stage_port),
            imu=BoardSettings(driver="calrig", port=simulated.imu_port),
        )
        with running_service(store_path, rig) as service:
            run = service.start(unit="AS-1", rig=rig.name, plan=Plan.model_validate(LONG))
            wait_for(lambda: service.store.poses(run.id) or None, "first pose")
            wait_for(lambda: simulated.stage.state == State.RUN or None, "move")
            simulated.stage.reset()
            ended = service.wait(run.id, 20)
    assert ended.status == "failed"
    assert "has lost its angle: it was reset, and its count with it" in ended.error
