"""The files of a store: the one that is named, its owner's alone, and no way elsewhere."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from test_store_migrations import later_program

from calrig.settings import store_url
from calrig.store import Store, StoreError, back_up


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def modes(folder: Path) -> dict[str, str]:
    return {path.name: oct(stat.S_IMODE(path.lstat().st_mode)) for path in folder.iterdir()}


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o277], ids=oct)
def test_a_new_store_and_all_beside_it_are_for_its_owner_alone(url, tmp_path, monkeypatch, mask):
    with umask(mask), Store.open(url, writer="test") as store:
        store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        back_up(url, tmp_path / "copy.db")
        open_now = modes(tmp_path)
    assert open_now == dict.fromkeys(
        ["calrig.db", "calrig.db-wal", "calrig.db-shm", "calrig.db.lock", "copy.db"], "0o600"
    )
    later = tmp_path / "later"
    later.mkdir()
    revision = later_program(later, monkeypatch)
    with umask(mask):
        Store.open(url, writer="test").close()
    assert modes(tmp_path)[f"calrig.db.before-{revision}.bak"] == "0o600"


def test_a_store_that_is_shared_on_purpose_stays_so_and_its_copies_are_not(url, database, tmp_path):
    Store.open(url, writer="test").close()
    (tmp_path / "calrig.db.lock").unlink()
    database.chmod(0o660)
    with Store.open(url, writer="test") as store:
        store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        back_up(url, tmp_path / "copy.db")
        shared = dict.fromkeys(["calrig.db", "calrig.db-wal", "calrig.db-shm", "calrig.db.lock"], "0o660")
        assert modes(tmp_path) == {**shared, "copy.db": "0o600"}


PRECIOUS = "somebody's thesis"


def symbolic_link(lock: Path, precious: Path) -> None:
    lock.symlink_to(precious)


def dangling_link(lock: Path, precious: Path) -> None:
    lock.symlink_to(precious.with_name("not there yet"))


def hard_link(lock: Path, precious: Path) -> None:
    lock.hardlink_to(precious)


def fifo(lock: Path, _precious: Path) -> None:
    os.mkfifo(lock)


def folder(lock: Path, _precious: Path) -> None:
    lock.mkdir()


@pytest.mark.parametrize("lay", [symbolic_link, dangling_link, hard_link, fifo, folder])
def test_what_lies_in_the_locks_place_is_refused_and_left_alone(url, database, tmp_path, lay):
    precious = tmp_path / "thesis.tex"
    precious.write_text(PRECIOUS)
    lay(tmp_path / "calrig.db.lock", precious)
    was = sorted(p.name for p in tmp_path.iterdir())
    with pytest.raises(StoreError, match=r"calrig\.db\.lock: .*is a .*remove it"):
        Store.open(url, writer="test")
    assert precious.read_text() == PRECIOUS
    assert sorted(p.name for p in tmp_path.iterdir()) == was


@pytest.mark.parametrize("writer", ["test", None])
@pytest.mark.parametrize("lay", [fifo, folder])
def test_what_is_no_file_is_no_store(url, database, tmp_path, writer, lay):
    lay(database, tmp_path)
    with pytest.raises(StoreError, match=r"calrig\.db: is (a folder|not a file).*name"):
        Store.open(url, writer=writer)


def test_a_backup_goes_where_it_was_told_and_not_through_a_link(url, tmp_path):
    Store.open(url, writer="test").close()
    precious = tmp_path / "thesis.tex"
    precious.write_text(PRECIOUS)
    (tmp_path / "copy.db.unfinished").symlink_to(precious)
    back_up(url, tmp_path / "copy.db")
    (tmp_path / "dangling.db").symlink_to(tmp_path / "elsewhere.db")
    with pytest.raises(StoreError, match="exists and is not overwritten"):
        back_up(url, tmp_path / "dangling.db")
    assert precious.read_text() == PRECIOUS
    assert not (tmp_path / "elsewhere.db").exists()


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
