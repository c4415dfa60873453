"""Runs that wait their turn on a rig of this machine: in order, called off, and held after a restart."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from run_rigs import ENDLESS, TruthRig, begin, moving, plan, states, until

from calrig.analysis.errors import Conflict
from calrig.runs.run_queue import HELD, mark_interrupted
from calrig.runs.service import RunService
from calrig.store import Run, Store

SHORT = plan(elevations_deg=[-5, 5])
Serve = Callable[..., RunService]


def waiting(service: RunService, unit: str) -> Run:
    """A run that was asked for on a busy rig."""
    run = service.start(unit=unit, plan=SHORT, queue=True)
    assert run.status == "queued"
    return run


def test_runs_that_wait_begin_in_order_once_the_rig_is_free(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    first = begin(service, ENDLESS)
    moving(bench, service, first)
    second, third = waiting(service, "Q-2"), waiting(service, "Q-3")
    assert service.rigs()[0].run_id == first.id
    with pytest.raises(Conflict, match="cannot be paused"):
        service.pause(second.id)
    with pytest.raises(Conflict, match="stage_at_deg"):
        service.start(unit="Q-4", plan=SHORT, queue=True, stage_at_deg=3.0)
    service.abort(first.id)
    until(lambda: service.run(third.id).status == "completed", "end of the last")
    ended = [service.run(run.id) for run in (first, second, third)]
    assert [run.status for run in ended] == ["aborted", "completed", "completed"]
    assert ended[1].finished_at <= ended[2].started_at
    assert states(store, third) == ["queued", "running", "completed"]
    until(lambda: service.rigs()[0].state == "idle", "free rig")


def test_what_waits_is_aborted_by_itself_or_by_a_stop(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    first = begin(service, ENDLESS)
    moving(bench, service, first)
    second, third = waiting(service, "Q-2"), waiting(service, "Q-3")
    assert service.abort(second.id).status == "aborted"
    with pytest.raises(Conflict, match="is aborted"):
        service.abort(second.id)
    service.stop("bench-1")
    assert (service.run(third.id).status, service.run(third.id).error) == (
        "aborted",
        "the stage was stopped by request",
    )
    assert states(store, third) == ["queued", "aborted"]
    assert bench.stands_for_good()
    fourth = service.start(unit="Q-4", plan=SHORT, queue=True)
    until(lambda: service.run(fourth.id).status == "completed", "end of one that was asked for since")


def test_what_waited_when_the_service_ended_begins_once_somebody_says_go(
    bench: TruthRig, serve: Serve, store: Store
) -> None:
    service = serve(bench)
    first = begin(service, ENDLESS)
    moving(bench, service, first)
    second, third, fourth = (waiting(service, f"Q-{k}") for k in (2, 3, 4))
    service.close()
    mark_interrupted(store, {}, keeps_queue=True)
    again = serve(bench)
    assert again.run(first.id).status == "interrupted"
    for run in (again.run(second.id), again.run(third.id)):
        assert (run.status, run.held, run.error) == ("queued", True, HELD)
    assert again.rigs()[0].state == "idle"
    assert again.wait(begin(again, SHORT).id, 30).status == "completed", "what is held keeps nobody waiting"
    assert again.run(second.id).status == "queued"
    again.abort(fourth.id)
    assert again.resume(third.id).status in {"queued", "running"}
    until(lambda: again.run(third.id).status == "completed", "end")
    assert (again.run(third.id).held, again.run(third.id).error) == (False, None)
    assert "interrupted" not in again.run(third.id).faults
    again.stop("bench-1")
    assert again.run(second.id).status == "aborted", "a stop calls off what is held as well"


def test_a_run_that_cannot_begin_says_why_and_lets_the_next_one(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    first = begin(service, ENDLESS)
    moving(bench, service, first)
    second, third = waiting(service, "Q-2"), waiting(service, "Q-3")
    store.runs.update(second.id, plan={**SHORT.model_dump(mode="json"), "elevations_deg": [-89.0, 120.0]})
    service.abort(first.id)
    until(lambda: service.run(third.id).status == "completed", "end")
    assert service.run(second.id).status == "failed"
    assert "120" in (service.run(second.id).error or "")
