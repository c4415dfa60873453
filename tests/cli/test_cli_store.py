"""`calrig backup`: a copy while a run goes on, itself a store; and refusals that touch nothing."""

from __future__ import annotations

import json
import re
import signal
import sqlite3
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from support import LONG, wait_for
from test_cli import CALRIG, CONFIG, POSES, calrig, reason

from calrig.store import Store, StoreError, back_up


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALRIG_DB", str(tmp_path / "calrig.db"))
    (tmp_path / "calrig.toml").write_text(CONFIG)
    (tmp_path / "poses.csv").write_text(POSES)
    return tmp_path


@contextmanager
def served(*arguments: str) -> Iterator[httpx.Client]:
    """`calrig serve` on a free port, as its own process."""
    command = [*CALRIG, "serve", "--port", "0", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        (url,) = re.findall(r"http://[^, ]+", process.stdout.readline())
        try:
            with httpx.Client(base_url=url, timeout=20) as client:
                yield client
        finally:
            process.send_signal(signal.SIGTERM)
            _, err = process.communicate(timeout=10)
            assert "Traceback" not in err, err


def poses(client: httpx.Client, run_id: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = client.get(f"/api/runs/{run_id}/poses").raise_for_status().json()
    return found


def test_a_backup_in_the_middle_of_a_run_is_served_with_every_pose_announced_before(folder):
    with served() as client:
        begun = client.post("/api/runs", json={"unit": "AS-1", "plan": LONG}).raise_for_status().json()
        wait_for(lambda: len(poses(client, begun["id"])) >= 4, "four poses")
        announced = poses(client, begun["id"])
        said = calrig("backup", "copy.db").stdout
        assert client.get(f"/api/runs/{begun['id']}").json()["status"] == "running", "the run goes on"
        later = wait_for(
            lambda: (p := poses(client, begun["id"])) and len(p) > len(announced) + 1 and p, "another pose"
        )
    assert re.fullmatch(r"copy\.db: 1 runs, \d+ poses, \d+\.\d MB\n", said)
    assert [p.name for p in folder.glob("copy.db*")] == ["copy.db"], "one self-contained file"

    with served("--db", "copy.db") as client:
        run = client.get(f"/api/runs/{begun['id']}").raise_for_status().json()
        assert run["status"] == "interrupted"
        kept = poses(client, begun["id"])
        assert kept[: len(announced)] == announced
        assert kept == later[: len(kept)]


def test_a_backup_of_an_idle_store_is_the_store(folder):
    calrig("import", "poses.csv", "--unit", "A")
    assert calrig("backup", "copy.db").stdout.startswith("copy.db: 1 runs, 3 poses, ")
    copied = calrig("export", "1", "--db", "copy.db").stdout
    assert json.loads(copied) == json.loads(calrig("export", "1").stdout)


def test_a_file_that_exists_is_not_overwritten(folder):
    (folder / "copy.db").write_text("precious")
    assert "copy.db: exists and is not overwritten" in reason("backup", "copy.db", status=2)
    assert (folder / "copy.db").read_text() == "precious"
    assert "is a folder" in reason("backup", ".", status=2)
    assert "not there" in reason("backup", "nowhere/copy.db", status=2)


def test_what_cannot_be_backed_up_is_1_and_leaves_nothing(folder):
    assert "no calrig database" in reason("backup", "copy.db", status=1)
    store, copy = folder / "calrig.db", folder / "copy.db"
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
    assert list(folder.glob("copy.db*")) == []


def test_a_damaged_store_is_not_taken_for_a_good_copy(folder):
    calrig("import", "poses.csv", "--unit", "A")
    with (folder / "calrig.db").open("r+b") as file:
        file.seek(8192)
        file.write(bytes(4096))
    assert "is damaged" in reason("backup", "copy.db", status=1)
    assert list(folder.glob("copy.db*")) == []


def test_a_killed_backup_leaves_no_copy_and_the_next_one_is_whole(folder):
    calrig("import", "poses.csv", "--unit", "A")
    (folder / "copy.db.unfinished").write_bytes(b"half a copy")
    calrig("backup", "copy.db")
    assert [p.name for p in folder.glob("copy.db*")] == ["copy.db"]


def test_the_writer_is_not_kept_waiting_and_the_copy_is_one_instant(tmp_path):
    url, copies = f"sqlite:///{tmp_path / 'calrig.db'}", tmp_path / "copies"
    copies.mkdir()
    with Store.open(url, writer="test", busy_timeout_s=0.5) as store:
        run = store.create_run(unit="A", rig="r", plan=None, status="running", provenance={})
        done = threading.Event()
        written = 0

        def copy() -> None:
            for k in range(5):
                back_up(url, copies / f"{k}.db")
            done.set()

        thread = threading.Thread(target=copy)
        thread.start()
        while not done.is_set():
            store.append_events(run.id, [("reading", {"k": written}), ("reading", {"k": written})])
            written += 1
        thread.join()
    sizes = []
    for made in sorted(copies.iterdir()):
        with Store.open(f"sqlite:///{made}", writer=None) as copied:
            events = copied.events_after(run.id, limit=10**6)
        assert len(events) % 2 == 1, "half of what one call appended"
        sizes.append(len(events))
    assert sizes == sorted(sizes)
    assert written > 5
    with pytest.raises(StoreError, match="exists and is not overwritten"):
        back_up(url, copies / "0.db")
