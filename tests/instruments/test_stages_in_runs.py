"""Whole runs over the system's own ports: what only a terminal, and the wall's clock, can show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from support import LONG, QUICK, after_commits, fast, known_as, running_service, wait_for
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.settings import RigSettings
from calrig.simulator.rig import SimulatedRig
from calrig.simulator.stages.grbl import State

OFFSET_DEG = 0.8
"""The mount's, in `support.FAST`."""
PATIENCE_S = 120.0
"""A busy machine is no failure."""


@contextmanager
def on_terminals(store_path, **options) -> Iterator[tuple[SimulatedRig, RigSettings, RunService]]:
    with SimulatedRig(fast(options)) as simulated:
        rig = known_as("bench-1", simulated)
        with running_service(store_path, rig) as service:
            yield simulated, rig, service


@pytest.mark.parametrize("driver", ["smc100", "grbl"])  # the third speaks in lines as the first does
def test_it_calibrates_a_unit(driver, store_path):
    with on_terminals(store_path, stage={"driver": driver}) as (_, rig, service):
        assert rig.stage.port.startswith("/dev/")
        run = service.wait(service.start(unit="AS-1", plan=Plan.model_validate(QUICK)).id, PATIENCE_S)
        assert run.status == "completed", run.error
        assert run.result.n_poses == 6
        assert run.result.bias_deg == pytest.approx(OFFSET_DEG, abs=0.1)
        assert run.result.scale == pytest.approx(1.0, abs=0.005)
        assert run.provenance["stage"]["driver"] == driver


@pytest.mark.parametrize("device", ["stage", "board"])
def test_a_cable_pulled_in_the_midst_of_a_run(device, store_path):
    with on_terminals(store_path) as (simulated, _, service):
        run = service.start(unit="AS-1", plan=Plan.model_validate(LONG))
        wait_for(lambda: service.store.poses.of(run.id) or None, "first pose", PATIENCE_S)
        wire = getattr(simulated, f"{device}_wire")
        wire.stop()
        ended = service.wait(run.id, PATIENCE_S)
    assert ended.status == "failed"
    assert f"port {wire.url} went away" in ended.error


@pytest.mark.parametrize("homing", [True, False], ids=["with a switch", "without"])
def test_a_stepper_that_is_reset_on_the_way_fails_the_run_and_gives_no_angle(homing, store_path):
    clock = VirtualClock()
    options = {"stage": {"driver": "grbl", "homing": homing}}
    with (
        virtual_rig(fast(options), clock) as simulated,
        clock.taking_part(),
        running_service(store_path, known_as("bench-1", simulated)) as service,
    ):
        run = service.start(unit="AS-1", plan=Plan.model_validate(LONG))
        clock.until(after_commits(lambda: service.store.poses.count(run.id), clock), "first pose")
        clock.until(lambda: simulated.stage.state == State.RUN, "move")
        simulated.stage.reset()
        ended = service.wait(run.id, 20)
    assert ended.status == "failed"
    assert re.search("lost its angle.*reset", ended.error)


def test_a_stepper_that_runs_into_its_limit_switch_fails_the_run_with_its_alarm_and_the_next_run_homes(
    store_path,
):
    clock = VirtualClock()
    with (
        virtual_rig(fast({"stage": {"driver": "grbl"}}), clock) as simulated,
        clock.taking_part(),
        running_service(store_path, known_as("bench-1", simulated)) as service,
    ):
        run = service.start(unit="AS-1", plan=Plan.model_validate(LONG))
        clock.until(after_commits(lambda: service.store.poses.count(run.id), clock), "first pose")
        clock.until(lambda: simulated.stage.state == State.RUN, "move")
        simulated.stage.set_limit_switch(closed=True)
        simulated.stage.set_limit_switch(closed=False)
        ended = service.wait(run.id, 20)
        again = service.wait(service.start(unit="AS-1", plan=Plan.model_validate(QUICK)).id, 60)
    assert ended.status == "failed"
    assert ended.error.count("ALARM:1, a limit switch was hit") == 1
    assert "motor power" not in ended.error, "it has stopped by itself, and said so"
    assert (again.status, again.error) == ("completed", None)
    assert again.result.bias_deg == pytest.approx(OFFSET_DEG, abs=0.1)
