"""Devices that fail before or during a run: it ends `failed`, says why, and the rig can be used again."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Any

import pytest
from run_rigs import TruthRig, plan, states, until

from calrig.runs.service import RunService
from calrig.store import Run, Store, StoredPose

SLOW_END = plan(elevations_deg=[0, 5, 80], velocity_dps=1.2)
"""Two poses soon, then a move that takes longer than any device takes to be found dead."""


@dataclass(frozen=True)
class Case:
    """What fails, when, and what the reason must name."""

    device: str
    fault: str
    at: str
    reason: str

    @property
    def name(self) -> str:
        return f"{self.device}-{self.fault}-{self.at}"


CASES = [
    Case(
        "stage", "hang", "on the move", r"stage smc100 at address 1 on {stage} does not answer.*check power"
    ),
    Case("stage", "garbage", "on the move", r"stage smc100 at address 1 on {stage} does not answer.*check"),
    Case("board", "silent", "on the move", r"board calrig on {imu}.*silent: check its power and cable"),
    Case("board", "garbage", "on the move", r"board calrig on {imu}.*no packet is whole: check baud rate"),
    Case("board", "frozen", "on the move", r"board calrig on {imu}.*do not change.*switch the board off"),
    Case(
        "stage", "hang", "at the start", r"stage smc100 at address 1 on {stage} does not answer.*check power"
    ),
    Case(
        "stage", "garbage", "at the start", r"stage smc100 at address 1 on {stage} does not answer.*unparsed"
    ),
    Case("board", "silent", "at the start", r"board calrig on {imu} sent no identity.*silent"),
    Case("board", "garbage", "at the start", r"board calrig on {imu} sent no identity.*bytes came"),
]


@dataclass(frozen=True)
class Outcome:
    """A run that failed, what was kept of it, and the next one on the same rig."""

    rig: TruthRig
    run: Run
    poses: list[StoredPose]
    states: list[str]
    moved_before_repair: bool
    stood_before_repair: bool
    rested_at_deg: float
    reachable: str
    next_run: Run


@pytest.fixture(scope="module")
def outcomes(store: Store) -> Iterator[dict[str, Outcome]]:
    """Every case on a rig of its own, side by side in one service; then each rig repaired and used again."""
    with ExitStack() as stack:
        rigs = {case.name: TruthRig(f"bench-{k}", time_scale=10.0) for k, case in enumerate(CASES)}
        for rig in rigs.values():
            stack.enter_context(rig.simulated)
        service = stack.enter_context(closing(RunService(store, [rig.settings for rig in rigs.values()])))
        for case in CASES:
            if case.at == "at the start":
                break_it(rigs[case.name], case)
        runs = {
            name: service.start(unit="AS-1", rig=rig.settings.name, plan=SLOW_END)
            for name, rig in rigs.items()
        }
        for case in CASES:
            if case.at == "on the move":
                on_third_move(store, runs[case.name], rigs[case.name])
                break_it(rigs[case.name], case)
        ended = {name: service.wait(run.id, 30) for name, run in runs.items()}
        seen = {
            name: (
                rig.has_moved(),
                rig.stands_for_good(),
                rig.table_deg(rig.now_s),
                state_of(service, rig),
            )
            for name, rig in rigs.items()
        }
        for rig in rigs.values():
            rig.simulated.stage.fault = rig.simulated.board.fault = None
            until(rig.stands_for_good, "rest", 60)
        after = {
            name: service.start(
                unit="AS-1", rig=rig.settings.name, plan=plan(elevations_deg=[0], dwell_s=0.5)
            )
            for name, rig in rigs.items()
        }
        yield {
            name: Outcome(
                rig,
                ended[name],
                store.poses.of(runs[name].id),
                states(store, runs[name]),
                *seen[name],
                service.wait(after[name].id, 30),
            )
            for name, rig in rigs.items()
        }


def on_third_move(store: Store, run: Run, rig: TruthRig) -> None:
    """Until the table moves after two poses."""
    until(lambda: store.poses.count(run.id) == 2 and rig.moves(), "move after two poses", 30)


def break_it(rig: TruthRig, case: Case) -> None:
    getattr(rig.simulated, case.device).fault = case.fault


def state_of(service: RunService, rig: TruthRig) -> str:
    return next(state.state for state in service.rigs() if state.name == rig.settings.name)


@pytest.fixture(params=CASES, ids=lambda case: case.name)
def case(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture
def outcome(outcomes: dict[str, Outcome], case: Case) -> Outcome:
    return outcomes[case.name]


def test_the_run_fails_with_the_device_its_port_and_what_to_do(outcome: Outcome, case: Case) -> None:
    assert outcome.run.status == "failed"
    ports = {"stage": outcome.rig.simulated.stage_port, "imu": outcome.rig.simulated.imu_port}
    assert re.search(case.reason.format(**ports), outcome.run.error or ""), outcome.run.error
    assert "Traceback" not in (outcome.run.error or "")
    assert "internal error" not in (outcome.run.error or "")
    if (case.device, case.fault) == ("stage", "hang"):
        assert (outcome.run.error or "").count("does not answer") == 1, "said once, though two things failed"
    assert outcome.states == ["queued", "running", "failed"]


def test_poses_so_far_are_kept(outcome: Outcome, case: Case) -> None:
    assert len(outcome.poses) == (2 if case.at == "on the move" else 0)
    assert outcome.run.progress.poses_done == len(outcome.poses)
    assert outcome.run.finished_at is not None


def test_the_stage_stands_or_the_reason_says_that_it_may_not(outcome: Outcome, case: Case) -> None:
    if case.at == "at the start":
        assert not outcome.moved_before_repair
    elif case.device == "stage":  # a controller that does not answer cannot be known to have heard
        assert "cut its motor power" in (outcome.run.error or "")
    else:
        assert 5.0 < outcome.rested_at_deg < 79.0  # on its way to 80° when it was stopped
    if case.fault != "hang":
        assert outcome.stood_before_repair


def test_a_rig_that_was_not_reached_is_shown_as_unreachable(outcome: Outcome, case: Case) -> None:
    assert outcome.reachable == ("unreachable" if case.at == "at the start" else "idle")


def test_the_repaired_rig_can_be_used_at_once(outcome: Outcome) -> None:
    assert outcome.next_run.status == "completed", outcome.next_run.error


def test_a_stage_that_stalls(make_rig: Any, serve: Any, store: Store) -> None:
    bench = make_rig(mechanics={"obstruction_deg": 20.0})
    service = serve(bench)
    run = service.wait(service.start(unit="AS-1", plan=plan(elevations_deg=[-10, 40])).id, 30)
    assert run.status == "failed"
    assert re.search(r"DISABLE.*the move to 40°.*obstacle", run.error or ""), run.error
    assert len(store.poses.of(run.id)) == 1
    assert bench.stands_for_good()
    again = service.wait(service.start(unit="AS-1", plan=plan(elevations_deg=[-10, 10])).id, 30)
    assert again.status == "completed", again.error


def test_a_unit_that_is_not_the_one_on_the_board_fails_before_anything_moves(
    make_rig: Any, serve: Any, store: Store
) -> None:
    bench = make_rig(board={"serial": "AS-17"})
    service = serve(bench)
    run = service.wait(service.start(unit="AS-71", plan=plan()).id, 30)
    assert run.status == "failed"
    assert re.search(r"'AS-17'.*'AS-71'.*nothing was moved.*mount the right unit", run.error or "")
    assert not bench.has_moved()
    assert service.rigs()[0].state == "idle"
    right = service.wait(service.start(unit="AS-17", plan=plan(elevations_deg=[0])).id, 30)
    assert right.status == "completed", right.error


def test_a_rate_that_the_board_does_not_have_fails_before_anything_moves(make_rig: Any, serve: Any) -> None:
    bench = make_rig(board={"max_rate_hz": 400})
    service = serve(bench)
    run = service.wait(service.start(unit="AS-1", plan=plan(rate_hz=500)).id, 30)
    assert run.status == "failed"
    assert re.search(r"500 Hz.*400 Hz.*nothing was moved.*lower rate_hz", run.error or "")
    assert not bench.has_moved()


def test_limits_that_only_the_controller_knows_fail_before_anything_moves(make_rig: Any, serve: Any) -> None:
    bench = make_rig(stage={"limits_deg": [-50.0, 50.0]})
    service = serve(bench)
    run = service.wait(service.start(unit="AS-1", plan=plan(elevations_deg=[0, 60])).id, 30)
    assert run.status == "failed"
    assert re.search(r"60°.*limits.*-50° to 50°.*nothing was moved", run.error or "")
    assert not bench.has_moved()


@pytest.mark.parametrize("device", ["stage", "imu"])
def test_a_port_that_does_not_exist(make_rig: Any, serve: Any, store: Store, device: str) -> None:
    bench = make_rig()
    part = getattr(bench.settings, device).model_copy(update={"port": "/dev/ttyNOWHERE"})
    bench.settings = bench.settings.model_copy(update={device: part})
    service = serve(bench)
    assert service.rigs()[0].state == "unreachable"
    run = service.wait(service.start(unit="AS-1", plan=plan()).id, 30)
    assert run.status == "failed"
    assert re.search(r"port /dev/ttyNOWHERE does not exist", run.error or ""), run.error
    assert not bench.has_moved()
    assert states(store, run) == ["queued", "running", "failed"]


@pytest.mark.parametrize("device", ["stage", "board"])
def test_a_cable_pulled_in_the_midst_of_a_run(make_rig: Any, serve: Any, store: Store, device: str) -> None:
    bench = make_rig()
    service = serve(bench)
    run = service.start(unit="AS-1", plan=plan(elevations_deg=[0, 5, 80], velocity_dps=4.0))
    on_third_move(store, run, bench)
    wire = getattr(bench.simulated, f"{device}_wire")
    wire.stop()
    ended = service.wait(run.id, 20)
    assert ended.status == "failed"
    assert re.search(rf"port {wire.url} went away.*check cable and power", ended.error or "")
    assert len(store.poses.of(run.id)) == 2
    if device == "board":
        assert bench.stands_for_good()
    else:
        assert "cut its motor power" in (ended.error or "")
