"""The service's own end: stages stopped and runs written down within five seconds, whatever devices do."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from run_rigs import CLOCK, ENDLESS, STOPPED_S, TruthRig, begin, moving, paused, plan, states, until

from calrig.analysis.errors import Conflict
from calrig.runs.service import RunService
from calrig.store import Run, Store


@pytest.mark.parametrize("state", [moving, paused])
def test_closing_the_service_leaves_the_stage_stopped_and_the_run_interrupted(
    bench: TruthRig, service: RunService, store: Store, state: Callable[[TruthRig, RunService, Run], None]
) -> None:
    run = begin(service, ENDLESS if state is moving else plan(sweeps=50))
    state(bench, service, run)
    done = store.poses.of(run.id)
    asked_s, began = bench.now_s, CLOCK.now_s()
    service.close()
    assert CLOCK.now_s() - began < 5
    assert bench.stood_after_s(asked_s) < STOPPED_S
    assert bench.stands_for_good()
    ended = service.run(run.id)
    assert (ended.status, states(store, run)[-1]) == ("interrupted", "interrupted")
    assert "service was stopped" in (ended.error or "")
    assert store.poses.of(run.id)[: len(done)] == done
    with pytest.raises(Conflict, match="shutting down"):
        begin(service)


@pytest.mark.parametrize("fault", ["stage hangs", "board is silent from the start"])
def test_closing_takes_less_than_five_seconds_whatever_the_devices_do(
    make_rig: Callable[..., TruthRig], serve: Callable[..., RunService], store: Store, fault: str
) -> None:
    rigs = [make_rig(name) for name in ("left", "right")]
    service = serve(*rigs)
    if fault == "board is silent from the start":
        for rig in rigs:
            rig.simulated.board.fault = "silent"
    runs = [begin(service, rig=rig.settings.name) for rig in rigs]
    if fault == "stage hangs":
        until(lambda: all(rig.moves() for rig in rigs), "motion")
        for rig in rigs:
            rig.simulated.stage.fault = "hang"
    began = CLOCK.now_s()
    service.close()
    assert CLOCK.now_s() - began < 5
    assert [service.run(run.id).status for run in runs] == ["interrupted", "interrupted"]
    assert [states(store, run).count("interrupted") for run in runs] == [1, 1]


@pytest.mark.parametrize("request_name", ["abort", "close"])
def test_a_stage_whose_port_is_gone_keeps_no_request_from_being_met(
    make_rig: Callable[..., TruthRig], serve: Callable[..., RunService], request_name: str
) -> None:
    gone, other = make_rig("gone"), make_rig("other")
    service = serve(gone, other)
    held, going = (begin(service, plan(sweeps=50), rig="gone"), begin(service, rig="other"))
    paused(gone, service, held)  # nobody asks the stage anything now
    moving(other, service, going)
    gone.simulated.stop()
    if request_name == "abort":
        with pytest.raises(Conflict, match=r"gone.*could not be told to stop: cut its motor power"):
            service.abort(held.id)
        assert service.wait(held.id, 10).status in {"aborted", "failed"}  # the board's port is gone as well
        assert service.abort(going.id).status == "aborted"
    else:
        asked_s = other.now_s
        service.close()
        assert other.stood_after_s(asked_s) < STOPPED_S
        assert service.run(going.id).status == "interrupted"
    assert other.stands_for_good()
