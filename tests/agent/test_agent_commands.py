"""Commands of a centre: answered by what came of them, and carried out once, in time, or never."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from socket import create_server
from threading import Event

import pytest
from a_bench import ENDLESS, HandWritten, Rig, agent_at
from support import wait_for

from calrig.agent import orders
from calrig.agent.agent import Command, Commands
from calrig.agent.link import Centre
from calrig.plan import Plan


def answered(centre: HandWritten, command: int) -> dict[str, object]:
    return wait_for(lambda: centre.answer(command), "answer")


def running(centre: HandWritten, run_id: str) -> None:
    wait_for(lambda: centre.delivered(run_id).poses, "poses")


def test_a_stop_is_answered_once_the_stage_stands(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order(plan=ENDLESS)
        running(centre, run_id)
        answer = answered(centre, centre.command("stop", rig="bench-1"))
        assert (answer["status"], rig.stands()) == (200, True)
        told = centre.ended(run_id)
    assert told.status == "aborted"
    assert told.events[-1]["data"]["error"] == "the stage was stopped by request"


def test_a_run_is_paused_resumed_and_aborted_by_commands(centre: HandWritten, rig: Rig, spool: Path) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order(plan=ENDLESS)
        running(centre, run_id)
        assert answered(centre, centre.command("pause", run_uid=run_id))["status"] == 200
        wait_for(lambda: centre.delivered(run_id).status == "paused", "pause")
        assert answered(centre, centre.command("resume", run_uid=run_id))["status"] == 200
        wait_for(lambda: centre.delivered(run_id).status == "running", "resumption")
        assert answered(centre, centre.command("abort", run_uid=run_id))["status"] == 200
        assert centre.ended(run_id).status == "aborted"


def test_what_cannot_be_done_is_said(centre: HandWritten, rig: Rig, spool: Path) -> None:
    unknown = "00000000-0000-4000-8000-000000000000"
    with agent_at(centre.bench_url, spool, rig):
        run_id = centre.order()
        centre.ended(run_id)
        asked = {
            centre.command("stop", rig="bench-9"): 404,
            centre.command("abort", run_uid=unknown): 404,
            centre.command("pause", run_uid=run_id): 409,
            centre.command("dance", rig="bench-1"): 404,
        }
        for command, status in asked.items():
            answer = answered(centre, command)
            assert (answer["status"], len(answer["detail"]) > 10) == (status, True)


@pytest.mark.parametrize(
    ("kind", "of"), [("stop", {"withdrawn": True}), ("abort", {"withdrawn": True}), ("abort", {"age_s": 6.0})]
)
def test_what_was_withdrawn_or_is_old_is_never_done(
    centre: HandWritten, rig: Rig, spool: Path, kind: str, of: dict[str, object]
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run = agent.service.start(unit="AS-1", plan=Plan.model_validate(ENDLESS))
        never = centre.command(kind, rig="bench-1", run_uid=run.id, **of)
        answered(centre, centre.command("pause", run_uid=run.id))  # which came after it
        assert centre.taken_at(never) is None
        assert agent.service.run(run.id).status in {"queued", "running", "paused"}


def test_a_stop_is_obeyed_however_old_it_is_and_before_it_no_order_is_taken(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run = agent.service.start(unit="AS-1", plan=Plan.model_validate(ENDLESS))
        running(centre, run.id)
        old = centre.command("stop", rig="bench-1", age_s=86_400.0)
        assert answered(centre, old)["status"] == 200
        assert rig.stands()
        assert centre.ended(run.id).status == "aborted"


def test_no_order_is_taken_before_a_stop_is_answered(
    centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go = Event()

    def slowly(self: Commands, command: Command) -> dict[str, object]:
        go.wait()
        return {"status": 200, "detail": "the stage stands"}

    looks, pending_order = [], orders.pending_order

    def noted(centre: Centre, of: str) -> orders.Pending | None:
        found = pending_order(centre, of)
        looks.append(found)
        return found

    monkeypatch.setattr(Commands, "answer_to", slowly)
    monkeypatch.setattr(orders, "pending_order", noted)
    with agent_at(centre.bench_url, spool, rig) as agent:
        wait_for(agent.lease.is_held, "lease")
        stop = centre.command("stop", rig="bench-1")
        wait_for(lambda: centre.taken_at(stop), "stop")
        run_id = centre.order()
        looks.clear()
        agent.look()
        wait_for(lambda: looks, "look")
        looks.clear()
        agent.look()
        wait_for(lambda: looks, "look that began after the first one had ended")
        assert centre.taken_epoch(run_id) == 0
        go.set()
        assert centre.ended(run_id).status == "completed"
        assert centre.answered_at(stop) < agent.service.run(run_id).created_at.isoformat()


def test_a_stop_that_a_program_took_and_did_not_answer_is_obeyed_by_the_next_one(
    centre: HandWritten, rig: Rig, spool: Path
) -> None:
    stop = centre.command("stop", rig="bench-1")
    centre.connection.execute("UPDATE bench_command SET taken_at = asked_at")
    with agent_at(centre.bench_url, spool, rig):
        assert answered(centre, stop)["status"] == 200


def with_stage_at(rig: Rig, port: int) -> Rig:
    """A rig like another one, `bench-9`, whose stage is behind another port."""
    like = copy(rig)
    stage = rig.settings.stage.model_copy(update={"port": f"socket://127.0.0.1:{port}"})
    like.settings = rig.settings.model_copy(update={"name": "bench-9", "stage": stage})
    return like


def test_a_stop_on_one_rig_waits_for_no_other(centre: HandWritten, spool: Path, rig: Rig) -> None:
    """A stage that says nothing is waited for for seconds; another rig's stop is answered meanwhile."""
    with (
        create_server(("127.0.0.1", 0)) as nobody,
        agent_at(centre.bench_url, spool, rig, with_stage_at(rig, nobody.getsockname()[1])),
    ):
        slow = centre.command("stop", rig="bench-9")
        quick = centre.command("stop", rig="bench-1")
        assert answered(centre, quick)["status"] == 200
        assert centre.answer(slow) is None
        assert answered(centre, slow)["status"] == 409
