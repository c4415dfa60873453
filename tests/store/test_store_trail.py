"""Users, whose tokens are told once; and the trail, chained, in which every change is."""

from __future__ import annotations

import hashlib
import sqlite3
from contextlib import closing
from dataclasses import asdict, fields
from pathlib import Path

import pytest

from calrig.store import Store
from calrig.store.errors import NotFound, Refused
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
    assert [{f.name: getattr(e, f.name) for f in fields(Act)} for e in entries] == [asdict(a) for a in ACTS]
    assert [entry.seq for entry in entries] == [1, 2, 3]
    assert [e.what for e in filled.trail.entries(unit="A", what=["released"])] == ["released"]
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


def test_a_token_is_told_once_and_only_its_hash_is_in_the_file(store: Store, database: Path) -> None:
    user, token = store.users.add("ada", "operator", who="root")
    assert token is not None
    assert len(token) > 30
    assert user.token_sha256 == hashlib.sha256(token.encode()).hexdigest()
    assert store.users.all() == [user]
    written = b"".join(file.read_bytes() for file in database.parent.iterdir())
    assert token.encode() not in written
    assert user.token_sha256.encode() in written


def test_a_new_token_takes_the_place_of_the_one_before(store: Store) -> None:
    _, first = store.users.add("ada", "viewer")
    user, second = store.users.new_token("ada")
    assert second != first
    assert user.token_sha256 == hashlib.sha256(second.encode()).hexdigest()


def test_who_was_disabled_has_no_token_and_can_be_added_again_with_another_role(store: Store) -> None:
    store.users.add("ada", "viewer")
    gone = store.users.disable("ada")
    assert (gone.token_sha256, gone.disabled_at is not None) == (None, True)
    for change in (
        store.users.disable,
        store.users.new_token,
        lambda name: store.users.set_role(name, "operator"),
    ):
        with pytest.raises(Refused, match="ada was disabled: add them again"):
            change("ada")
    back, _ = store.users.add("ada", "releaser")
    assert (back.role, back.disabled_at) == ("releaser", None)


def test_the_last_admin_stays(store: Store) -> None:
    store.users.add("ada", "admin")
    store.users.add("ben", "admin")
    store.users.disable("ben")
    with pytest.raises(Refused, match="ada is the last admin"):
        store.users.disable("ada")
    with pytest.raises(Refused, match="ada is the last admin"):
        store.users.set_role("ada", "releaser")
    store.users.set_role("ada", "admin")
    store.users.add("cem", "admin")
    assert store.users.set_role("ada", "releaser").role == "releaser"


@pytest.mark.parametrize("name", ["", "a b", "x" * 65, "a/b", "a\n"])
def test_names_that_would_be_mistaken_for_something_else_are_refused(store: Store, name: str) -> None:
    with pytest.raises(Refused, match="letters, digits"):
        store.users.add(name, "viewer")


def test_nobody_is_added_twice_or_changed_who_is_not_there(store: Store) -> None:
    store.users.add("ada", "viewer")
    with pytest.raises(Refused, match="a user 'ada' already"):
        store.users.add("ada", "admin")
    with pytest.raises(NotFound, match="no user 'eve'"):
        store.users.disable("eve")


def test_each_change_is_in_the_trail(store: Store) -> None:
    store.users.add("ada", "viewer", who="root")
    store.users.set_role("ada", "operator", who="root")
    store.users.new_token("ada", who="root")
    store.users.disable("ada", who="root")
    told = [(entry.what, entry.who, entry.detail) for entry in store.trail.entries()]
    assert told == [
        ("user_added", "root", {"name": "ada", "role": "viewer"}),
        ("user_changed", "root", {"name": "ada", "changed": "role", "role": "operator"}),
        ("user_changed", "root", {"name": "ada", "changed": "token"}),
        ("user_changed", "root", {"name": "ada", "changed": "disabled"}),
    ]
