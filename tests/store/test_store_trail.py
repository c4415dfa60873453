"""The trail: in the order done, chained, so that nothing in its middle can be changed unnoticed."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest

from calrig.store.trail import Act, append

ACTS = [
    Act("voided", who="ada", unit="A", reason="slipped"),
    Act("released", who="ben", unit="A", revision=2, detail={"effects": ["backlash"]}),
    Act("limits_changed"),
]


@pytest.fixture
def filled(store):
    with store._database.writing() as session:
        for act in ACTS:
            append(session, act)
    return store


def test_what_was_done_is_told_in_order(filled):
    entries = filled.trail.entries()
    assert [entry.act for entry in entries] == ACTS
    assert [entry.seq for entry in entries] == [1, 2, 3]
    assert [e.act.what for e in filled.trail.entries(unit="A", what=["released"])] == ["released"]
    assert [e.seq for e in filled.trail.entries(since=entries[1].at, after=2)] == [3]
    assert filled.trail.broken_link() is None


@pytest.mark.parametrize(
    ("damage", "found_at"),
    [
        ("UPDATE trail SET who = 'eve' WHERE seq = 2", 2),
        ("UPDATE trail SET reason = NULL WHERE seq = 1", 1),
        ("DELETE FROM trail WHERE seq = 1", 2),
        ("DELETE FROM trail WHERE seq = 2", 3),
    ],
)
def test_a_changed_or_missing_entry_breaks_the_chain(filled, database, damage, found_at):
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute(damage)
    assert filled.trail.broken_link() == found_at
