"""A way to the centre that acknowledges everything and passes nothing on any more: it is noticed and left."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from a_bench import BENCH, ENDLESS, Cable, HandWritten, Rig, agent_at, libpq
from support import wait_for

from calrig.agent import link
from calrig.agent.link import Link, LinkDown
from calrig.store import Store
from calrig.store.postgresql import connection, listening
from calrig.store.postgresql.listening import Listening

SILENT_S = 1.0


@pytest.fixture(autouse=True)
def _is_noticed_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Has silence be an error after a second."""
    monkeypatch.setattr(link, "SILENT_S", SILENT_S)
    monkeypatch.setattr(connection, "PING_S", SILENT_S)
    monkeypatch.setattr(listening, "PING_S", SILENT_S)


def test_a_stop_asked_behind_a_dead_connection_is_obeyed_and_orders_are_taken_again(
    centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    with agent_at(cable.url, spool, rig):
        run_id = centre.order(plan=ENDLESS)
        wait_for(lambda: centre.delivered(run_id).poses, "poses")
        cable.silence()
        stop = centre.command("stop", rig="bench-1")
        assert wait_for(lambda: centre.answer(stop), "answer")["status"] == 200
        assert rig.stands()
        assert centre.ended(run_id).status == "aborted"
        assert centre.ended(centre.order()).status == "completed"


def test_a_stop_that_the_server_gave_to_a_dead_connection_is_obeyed(
    centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    with agent_at(cable.url, spool, rig):
        cable.silence(answers_alone=True)
        stop = centre.command("stop", rig="bench-1")
        wait_for(lambda: centre.taken_at(stop), "stop")  # by an update whose answer nobody gets
        assert wait_for(lambda: centre.answer(stop), "answer")["status"] == 200


def test_what_a_dead_connection_has_locked_is_free_again(
    centre: HandWritten, cable: Cable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "PATIENCE_MS", 500)
    beat = "UPDATE bench SET said = said WHERE name = %s RETURNING name"
    one = Link(libpq(cable.url))
    with (
        pytest.raises(LinkDown, match="the server has not answered for 1 s"),
        one.centre() as dead,
        dead.connection.transaction(),
    ):
        dead.connection.execute(beat, (BENCH,))
        cable.silence()
        dead.connection.execute("SELECT 1")

    def beats() -> bool:
        try:
            with one.centre() as whole:
                return whole.connection.execute(beat, (BENCH,)).fetchone() == (BENCH,)
        except LinkDown:
            return False

    assert wait_for(beats, "end of the lock")
    one.close()


def test_a_store_reads_and_writes_by_a_new_connection(centre: HandWritten) -> None:
    with closing(Cable(centre.url)) as cable, Store.open(cable.url, writer="tests") as store:
        assert [bench.name for bench in store.benches.all()] == [BENCH]
        cable.silence()
        store.enrolment.add("hall-3")
        cable.silence()
        assert {bench.name for bench in store.benches.all()} == {BENCH, "hall-3"}


def test_news_is_heard_by_a_new_connection(centre: HandWritten) -> None:
    heard: list[str] = []
    connected: list[bool] = []
    with (
        closing(Cable(centre.url)) as cable,
        closing(Listening(cable.url, {"news": heard.append}, lambda: connected.append(True))) as listens,
    ):
        listens.start()
        wait_for(lambda: connected, "connection")
        cable.silence()
        wait_for(lambda: len(connected) > 1, "new connection")
        centre.connection.execute("SELECT pg_notify('news', 'it')")
        assert wait_for(lambda: heard, "news") == ["it"]
