"""The files of a store are its owner's alone, and nothing that lies in their place leads elsewhere."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from test_store_migrations import later_program

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
