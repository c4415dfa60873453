"""Opening: one writer, many readers, and every way a file can be unfit said in words."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing
from pathlib import Path

import pytest
from empty_store import lay_empty_store

import calrig
from calrig.store import Store, StoreError, StoreUnavailableError
from calrig.store.sqlite import copying
from calrig.store.sqlite import database as opened_database
from calrig.store.sqlite.errors import store_error
from calrig.store.sqlite.file import connect

ROOT = Path(calrig.__file__).parent.parent


def python(code: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stdin=subprocess.PIPE,
        text=True,
    )


HOLD = """
import sys
from calrig.store import Store
store = Store.open(sys.argv[1], writer="serve")
print("open", flush=True)
sys.stdin.readline()
"""


def test_a_second_writer_is_told_who_holds_the_store_and_a_reader_is_not_kept_out(url):
    with python(HOLD, url) as holder:
        assert holder.stdout.readline() == "open\n"

        with pytest.raises(StoreError, match=rf"calrig serve.*process {holder.pid} on .*one writer"):
            Store.open(url, writer="import")
        with Store.open(url, writer=None) as reader:
            assert reader.runs.page() == ([], None)

        holder.kill()  # a lock dies with its holder
        holder.wait()
    Store.open(url, writer="run").close()
    Store.open(url, writer="import").close()


ANNOUNCE = """
import sys
import numpy as np
from calrig.calibration.poses import Pose
from calrig.store import SampleBlock, Store
store = Store.open(sys.argv[1], writer="run")
run = store.runs.create(unit="A", rig="bench", plan=None, status="running", provenance={})
for k in range(100_000):
    n = 50
    block = SampleBlock(k, "dwell", np.arange(n) / 200, np.ones((n, 3)), np.ones((n, 3)), np.full(n, 24.0))
    seq, = store.poses.add(run.id, k, Pose(float(k), float(k)), [block], [("pose", {"index": k})])
    print(k, seq, flush=True)
"""


def test_what_was_announced_survives_the_death_of_the_writer(url):
    with python(ANNOUNCE, url) as writer:
        for _ in range(20):
            writer.stdout.readline()
        os.kill(writer.pid, signal.SIGKILL)
        announced = [20, *(int(line.split()[0]) + 1 for line in writer.stdout if line.endswith("\n"))][-1]

    with Store.open(url, writer="serve") as store:
        (run,) = store.runs.page()[0]
        poses = store.poses.of(run.id)
        assert len(poses) >= announced
        assert [p.index for p in poses] == list(range(len(poses)))
        assert [e.seq for e in store.events.after(run.id, limit=10**6)] == list(range(1, len(poses) + 2))
        assert len(store.samples.of(run.id)) == 50 * len(poses), "a pose has its samples"
        assert [left.id for left in store.runs.unfinished()] == [run.id]


def test_threads_share_a_store(store, new_run):
    runs = [new_run(unit=f"U{k}") for k in range(4)]
    written = threading.Event()

    def write(run_id: str) -> None:
        for k in range(12):
            store.events.append(run_id, [("reading", {"k": k}), ("reading", {"k": k + 0.5})])

    def read() -> int:
        looks = 0
        while not written.is_set() or not looks:
            for run in runs:
                seqs = [event.seq for event in store.events.after(run.id)]
                assert seqs == list(range(1, len(seqs) + 1)), "a gap"
                assert len(seqs) % 2 == 1, "half of what one call appended"
            looks += 1
        return looks

    with ThreadPoolExecutor(max_workers=10) as pool:
        readers = [pool.submit(read) for _ in range(2)]
        writers = [pool.submit(write, run.id) for run in runs for _ in range(2)]  # two threads to a run
        wait(writers)
        written.set()
        assert all(job.result() is None for job in writers)
        assert all(job.result() > 0 for job in readers)

    for run in runs:
        assert [event.seq for event in store.events.after(run.id)] == list(range(1, 50))


def test_a_store_opened_for_reading_writes_nothing(store, url):
    with Store.open(url, writer=None) as reader, pytest.raises(StoreError, match="reading only"):
        reader.runs.create(unit="A", rig="r", plan=None, status="queued", provenance={})


def test_an_absent_database_is_not_made_by_a_reader(database, url):
    with pytest.raises(StoreError, match=r"there is no calrig database.*calrig serve"):
        Store.open(url, writer=None)
    assert not database.exists()


def test_the_pragmas_that_keep_data_safe_are_on(url, monkeypatch):
    monkeypatch.setattr(opened_database, "connect", connect)  # as everybody's, not as these tests'
    with Store.open(url, writer="test") as store, store._database.reading() as session:
        values = [
            session.connection().exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "foreign_keys", "synchronous", "busy_timeout")
        ]
    assert values == ["wal", 1, 2, 10_000]


@pytest.mark.parametrize("writer", ["serve", None])
def test_a_file_that_is_no_database_is_refused_untouched(database, url, writer):
    database.write_bytes(b"time_s,accel_x_g\n0.0,0.1\n" * 100)
    was = database.read_bytes()
    with pytest.raises(StoreError, match=r"calrig\.db: it is not a SQLite database: name another"):
        Store.open(url, writer=writer)
    assert database.read_bytes() == was


def test_an_empty_file_is_no_new_store_and_stays_as_it_is(database, url):
    database.touch()
    with pytest.raises(StoreError, match=r"calrig\.db: is empty \(0 bytes\).*backup.*delete it"):
        Store.open(url, writer="serve")
    assert database.stat().st_size == 0


def test_a_first_start_that_was_killed_leaves_nothing_in_the_stores_place(
    url, database, tmp_path, monkeypatch
):
    def die(_unfinished: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(copying, "_run_alembic", die)
    with pytest.raises(KeyboardInterrupt):
        Store.open(url, writer="serve")
    assert not database.exists()
    monkeypatch.undo()
    (tmp_path / "calrig.db.unfinished").write_bytes(b"half a store")  # no handler runs after SIGKILL
    Store.open(url, writer="serve").close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["calrig.db", "calrig.db.lock"]


@pytest.mark.parametrize("writer", ["serve", None])
def test_another_programs_database_is_refused_untouched(database, url, writer):
    with closing(sqlite3.connect(database)) as other:
        other.execute("CREATE TABLE bookmarks (url TEXT)")
    was = database.read_bytes()
    with pytest.raises(StoreError, match="another program's database"):
        Store.open(url, writer=writer)
    assert database.read_bytes() == was


def test_a_folder_or_a_missing_folder_is_said(tmp_path):
    with pytest.raises(StoreError, match="is a folder"):
        Store.open(f"sqlite:///{tmp_path}", writer="serve")
    with pytest.raises(StoreError, match=r"nowhere.*cannot be made.*folder exists"):
        Store.open(f"sqlite:///{tmp_path / 'nowhere' / 'x.db'}", writer="serve")


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("mysql://me:secret@host/db", r"mysql://me:\*\*\*@host/db: a store is a SQLite file"),
        ("sqlite://", "in memory would be lost"),
        ("sqlite:///:memory:", "in memory would be lost"),
        ("sqlite:///x.db?mode=ro", "a store is a SQLite file"),
        ("::", "neither a path nor"),
    ],
)
def test_a_url_that_names_no_sqlite_file_is_said(url, why):
    with pytest.raises(StoreError, match=why):
        Store.open(url, writer="serve")


def test_a_lock_that_another_program_keeps_is_said(url, database):
    Store.open(url, writer="serve").close()
    with (
        closing(sqlite3.connect(database, isolation_level=None)) as other,
        Store.open(url, writer="serve", busy_timeout_s=0.05) as store,
    ):
        run = store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreError, match="another program keeps it locked"):
            store.runs.update(run.id, status="paused")
        other.execute("ROLLBACK")
        assert store.runs.update(run.id, status="paused").status == "paused"


def delete(database: Path) -> None:
    database.unlink()


def replace(database: Path) -> None:
    other = database.with_name("restored.db")
    lay_empty_store(other)
    other.replace(database)


@pytest.mark.parametrize("take_away", [delete, replace])
def test_a_file_that_is_taken_away_from_its_writer_is_noticed_at_the_next_write(
    url, database, tmp_path, take_away
):
    with Store.open(url, writer="serve") as store:
        kept = tmp_path / "the store.db"
        kept.hardlink_to(database)
        take_away(database)
        with pytest.raises(
            StoreUnavailableError, match=r"calrig\.db: was deleted or replaced.*put the file back"
        ):
            store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        assert database.exists() == (take_away is replace), "no new file appears"
        kept.replace(database)
        run = store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
    with Store.open(url, writer=None) as reader:
        assert [stored.id for stored in reader.runs.page()[0]] == [run.id]


def test_a_full_disk_is_said_with_what_to_do(database):
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("CREATE TABLE t (x BLOB)")
        connection.execute("PRAGMA max_page_count = 4")
        with pytest.raises(sqlite3.OperationalError) as full:
            connection.execute("INSERT INTO t VALUES (zeroblob(100000))")
    assert "the disk is full: free some space" in str(store_error(full.value, database))


def test_a_read_only_file_is_said_with_what_to_do(database, url):
    Store.open(url, writer="serve").close()
    with (
        closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection,
        pytest.raises(sqlite3.OperationalError) as read_only,
    ):
        connection.execute("DELETE FROM run")
    assert "read-only: make both writable" in str(store_error(read_only.value, database))
