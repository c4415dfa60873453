"""Users: tokens are told once and kept as hashes, and every change is in the trail."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from calrig.store import Store
from calrig.store.errors import NotFound, Refused


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
    told = [(entry.act.what, entry.act.who, entry.act.detail) for entry in store.trail.entries()]
    assert told == [
        ("user_added", "root", {"name": "ada", "role": "viewer"}),
        ("user_changed", "root", {"name": "ada", "changed": "role", "role": "operator"}),
        ("user_changed", "root", {"name": "ada", "changed": "token"}),
        ("user_changed", "root", {"name": "ada", "changed": "disabled"}),
    ]
