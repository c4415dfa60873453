"""A store that somebody else had a hand in runs nothing of theirs: not opened, not copied, not converted."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from test_store_migrations import later_program

from calrig.store import Store, StoreError, back_up

PLANTED = {
    "trigger": "CREATE TRIGGER spy AFTER INSERT ON run BEGIN UPDATE unit SET serial = 'mine'; END",
    "view": "CREATE VIEW spy AS SELECT * FROM run",
    "virtual table": "CREATE VIRTUAL TABLE spy USING fts5(words)",
    "trigger whose name clears the screen": 'CREATE TRIGGER "spy\n\x1b[2J" AFTER UPDATE ON run BEGIN '
    "DELETE FROM pose; END",
}


def plant(database: Path, statement: str) -> bytes:
    with closing(sqlite3.connect(database)) as connection:
        connection.execute(statement)
        connection.commit()
    return database.read_bytes()


@pytest.fixture
def sound(url: str) -> None:
    with Store.open(url, writer="test") as store:
        store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})


@pytest.mark.usefixtures("sound")
@pytest.mark.parametrize("statement", PLANTED.values(), ids=PLANTED)
def test_what_was_planted_is_named_and_nothing_is_opened_copied_or_converted(
    url, database, tmp_path, monkeypatch, statement
):
    was = plant(database, statement)
    told = r"calrig\.db: .*did not make.*spy.*nothing was changed.*backup"
    for writer in ("import", None):
        with pytest.raises(StoreError, match=told):
            Store.open(url, writer=writer)
    with pytest.raises(StoreError, match=told):
        back_up(url, tmp_path / "copy.db")
    later_program(tmp_path, monkeypatch)
    with pytest.raises(StoreError, match=told) as refused:
        Store.open(url, writer="serve")
    assert str(refused.value).isprintable()
    assert database.read_bytes() == was
    assert not list(tmp_path.glob("*.bak")) + list(tmp_path.glob("copy*"))


def test_a_table_that_was_made_a_view_is_not_even_asked_for_unfinished_runs(url, database):
    """Such a view would never end: opening says what is wrong instead."""
    Store.open(url, writer="test").close()
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA foreign_keys = OFF")
        connection.execute("DROP TABLE run")
    plant(
        database,
        "CREATE VIEW run AS WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) "
        "SELECT k AS id, 'r' AS rig, 'none' AS status FROM n",
    )
    with pytest.raises(StoreError, match=r"did not make.*view 'run'"):
        Store.open(url, writer="serve")


def test_the_stages_of_a_store_that_is_refused_are_stopped_all_the_same(url, database, sound):
    plant(database, PLANTED["trigger"])
    stopped: list[str] = []
    with pytest.raises(StoreError, match="did not make"):
        Store.open(url, writer="serve", left_by_the_dead=stopped.extend)
    assert stopped == ["r"]


def test_functions_that_a_schema_must_not_call_are_refused_it(store, database):
    with store._database.reading() as session:
        assert session.connection().exec_driver_sql("PRAGMA trusted_schema").scalar() == 0
