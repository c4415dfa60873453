"""A copy of a store is one instant of it, whole and self-contained; what is none is not copied."""

from __future__ import annotations

import sqlite3
import threading

import pytest

from calrig.store import Store, StoreError, back_up


def test_what_is_no_store_is_refused_and_leaves_no_copy(tmp_path):
    store, copy = tmp_path / "calrig.db", tmp_path / "copy.db"
    with pytest.raises(StoreError, match="no calrig database"):
        back_up(f"sqlite:///{store}", copy)
    store.touch()
    with pytest.raises(StoreError, match="is empty"):
        back_up(f"sqlite:///{store}", copy)
    store.write_bytes(b"no database" * 1000)
    with pytest.raises(StoreError, match="not a SQLite database"):
        back_up(f"sqlite:///{store}", copy)
    store.unlink()
    with sqlite3.connect(store) as other:
        other.execute("CREATE TABLE bookmarks (url TEXT)")
    with pytest.raises(StoreError, match="another program's database"):
        back_up(f"sqlite:///{store}", copy)
    assert list(tmp_path.glob("copy.db*")) == []


def test_a_damaged_store_is_not_taken_for_a_good_copy(tmp_path):
    url, copy = f"sqlite:///{tmp_path / 'calrig.db'}", tmp_path / "copy.db"
    Store.open(url, writer="test").close()
    with (tmp_path / "calrig.db").open("r+b") as file:
        file.seek(8192)
        file.write(bytes(4096))
    with pytest.raises(StoreError, match="is damaged"):
        back_up(url, copy)
    assert list(tmp_path.glob("copy.db*")) == []


def test_a_killed_backup_leaves_no_copy_and_the_next_one_is_whole(tmp_path):
    url, copy = f"sqlite:///{tmp_path / 'calrig.db'}", tmp_path / "copy.db"
    Store.open(url, writer="test").close()
    (tmp_path / "copy.db.unfinished").write_bytes(b"half a copy")
    assert back_up(url, copy).runs == 0
    assert [p.name for p in tmp_path.glob("copy.db*")] == ["copy.db"]
    with pytest.raises(StoreError, match="exists and is not overwritten"):
        back_up(url, copy)


def test_the_writer_is_not_kept_waiting_and_the_copy_is_one_instant(tmp_path):
    url = f"sqlite:///{tmp_path / 'calrig.db'}"
    copies = [tmp_path / f"{k}.db" for k in range(5)]
    with Store.open(url, writer="test", busy_timeout_s=0.5) as store:
        run = store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        for copy in copies:
            copying = threading.Thread(target=back_up, args=(url, copy), daemon=True)
            copying.start()
            while True:
                store.events.append(run.id, [("reading", {"half": 1}), ("reading", {"half": 2})])
                if not copying.is_alive():
                    break
    sizes = []
    for copy in copies:
        with Store.open(f"sqlite:///{copy}", writer=None) as copied:
            sizes.append(len(copied.events.after(run.id, limit=10**6)))
    assert all(size % 2 == 1 for size in sizes), "the run's state, and both halves of what was appended"
    assert sizes == sorted(sizes)
    assert sizes[-1] >= 1 + 2 * (len(copies) - 1)
