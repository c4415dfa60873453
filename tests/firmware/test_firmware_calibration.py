"""From end to end: a unit calibrated through the sketch while the simulated stage turns its sensor.

Everybody lives in virtual time, the simulated processor too: no machine is so busy that an answer is late.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
import pytest
from firmware_board import FirmwareBoard, InStep
from support import running_service
from virtual_time.clock import VirtualClock
from virtual_time.world import SimWire

from calrig.plan import Plan
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.stages.smc100 import Smc100


def test_a_unit_is_calibrated_through_the_firmware_on_the_simulated_stage(built, tmp_path):
    offset_deg = 0.8
    physics = SimulatorSettings.from_options(
        {
            "stage": {"velocity_dps": 60.0, "acceleration_dps2": 240.0, "homing_velocity_dps": 30.0},
            "mount": {"offset_deg": offset_deg},
            "imu": {"gyro_bias_dps": [1.4, -0.6, 0.3]},
        }
    )
    table = Bench(physics)

    def counts(time_s):
        with table.lock:
            return table.counts(np.array([time_s]), 200.0)[0]

    plan = Plan.model_validate({"elevations_deg": [-40, 0, 40], "sweeps": 1, "settle_s": 0.5, "dwell_s": 1.0})
    with ExitStack() as stack:
        clock = VirtualClock()
        board = stack.enter_context(FirmwareBoard(built.harness, built.elf(115200), counts, speed=0.0))
        stage_wire = SimWire(Smc100(physics.stage, table, board.clock), "stage", clock)
        board_wire = SimWire(InStep(board, clock), "firmware", clock)
        for wire in (stage_wire, board_wire):
            stack.callback(wire.stop)
            wire.start()
        stack.callback(clock.stop)
        rig = RigSettings(
            name="firmware",
            stage=StageSettings(driver="smc100", port=stage_wire.url),
            imu=BoardSettings(driver="calrig", port=board_wire.url),
            reference=ReferenceSettings(std_deg=0.29),
        )
        with running_service(tmp_path / "calrig.db", rig) as service:
            ended = service.wait(service.start(unit="AS-1", plan=plan).id, 60.0)
    assert ended.status == "completed", ended.error
    assert ended.result.bias_deg == pytest.approx(offset_deg, abs=0.05)
    assert ended.result.scale == pytest.approx(1.0, abs=0.002)
    assert ended.result.gyro.scale == pytest.approx(1.0, abs=0.01)
    assert ended.result.gyro.bias_dps[0] == pytest.approx(1.4, abs=0.05)
    assert ended.faults == {}
