"""Whatever a store's file is called, that file is opened and no other."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from calrig.settings import store_url
from calrig.store import Store, StoreError, back_up

NAMES = [
    "a%41b#c.db",
    "what?.db",
    "mode=?mode=ro",
    "two words & ünïcode.db",
    ":memory:",
    "file:x.db",
    "~nobody-of-that-name.db",
    "a@b:c.db",
    os.fsdecode(b"latin-\xe4.db"),
]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", NAMES)
def test_any_name_opens_exactly_that_file(here, name):
    with Store.open(store_url(name), writer="test") as store:
        run = store.runs.create(unit="A", rig="r", plan=None, status="completed", provenance={})
        assert {p.name for p in here.iterdir()} == {
            name,
            *(f"{name}{end}" for end in ("-wal", "-shm", ".lock")),
        }
    with Store.open(store_url(str(here / name)), writer=None) as store:
        assert store.runs.get(run.id).unit == "A"
    assert back_up(store_url(name), here / f"copy of {name}").runs == 1
    with Store.open(store_url(f"copy of {name}"), writer=None) as store:
        assert store.runs.get(run.id).unit == "A"


def test_a_folder_may_be_called_anything_too(here):
    odd = here / "50% of what? #1"
    odd.mkdir()
    Store.open(store_url(str(odd / "calrig.db")), writer="test").close()
    assert (odd / "calrig.db").is_file()
    folder = here / "scheme:"
    folder.mkdir()
    Store.open(store_url("./scheme://calrig.db"), writer="test").close()
    assert (folder / "calrig.db").is_file()


def test_a_url_is_read_as_sqlalchemy_reads_it(here):
    with pytest.raises(StoreError, match="a store is a SQLite file"):
        Store.open("sqlite:///what?.db", writer="test")  # neither `what` nor `what?.db` is meant for sure
    Store.open(f"sqlite:///{here}/what%3F.db", writer="test").close()
    assert {p.name for p in here.iterdir()} == {"what?.db", "what?.db.lock"}
    with pytest.raises(StoreError, match="a store is a SQLite file"):
        Store.open("sqlite://host/x.db", writer="test")


@pytest.mark.parametrize("writer", ["test", None])
def test_a_name_that_no_file_can_have_is_refused_in_words(here, writer):
    with pytest.raises(StoreError, match=r"File name too long.*name another"):
        Store.open(store_url("x" * 300), writer=writer)
