"""A full disk, a read-only one, a network drive, damage: said with what to do, and nothing is lost by it."""

from __future__ import annotations

import errno
import fcntl
import os
import random
import signal
import sqlite3
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import lay_empty_store
from test_store_migrations import later_program
from test_store_open import python

from calrig.calibration.pose import Pose
from calrig.store import SampleBlock, Store, StoreDamagedError, StoreError, StoreUnavailableError, file_system


def block(index: int, n: int = 500) -> SampleBlock:
    noise = np.random.default_rng(index)
    return SampleBlock(
        index, "dwell", np.arange(n) / 200, noise.normal(size=(n, 3)), np.ones((n, 3)), np.full(n, 24.0)
    )


def filled(url: str, result: dict[str, Any] | None = None, poses: int = 20) -> str:
    """A run with poses, samples and events; its id."""
    lay_empty_store(Path(url.removeprefix("sqlite:///")))
    with Store.open(url, writer="test") as store:
        run = store.create_run(unit="A", rig="r", plan={"step_deg": 5}, status="running", provenance={})
        for k in range(poses):
            pose = Pose(float(k), k + 0.1 * (k % 3), temperature_c=20 + k / 7, covariates={"humidity": k / 3})
            event = ("pose", {"index": k, "reading_deg": k / 7})
            done = {"poses_done": k + 1, "poses_total": poses, "fraction": k / poses, "remaining_s": None}
            store.add_pose(run.id, k, pose, [block(k)], [event], progress=done)
        store.update_run(run.id, status="completed", result=result)
    return run.id


class Disk(type(Path())):
    """A folder on a small file system of its own."""

    def fill(self) -> None:
        """Leaves no room."""
        file = os.open(self / "ballast", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        try:
            while True:
                os.write(file, bytes(4096))
        except OSError as error:
            assert error.errno == errno.ENOSPC
        finally:
            os.close(file)

    def make_room(self) -> None:
        (self / "ballast").unlink()

    def remount(self, how: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{how}", self], check=True)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """Two megabytes of a real file system."""
    folder = Disk(tmp_path / "disk")
    folder.mkdir()
    try:
        subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", folder], check=True, capture_output=True
        )
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no file system can be mounted here: run as root")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def url_of(folder: Path) -> str:
    return f"sqlite:///{folder / 'calrig.db'}"


@pytest.mark.parametrize("there", [False, True], ids=["new", "existing"])
def test_a_writer_on_a_full_disk_is_refused_and_begins_once_there_is_room(disk, there):
    run_id = filled(url_of(disk), poses=3) if there else None
    disk.fill()
    with pytest.raises(StoreUnavailableError, match="the disk is full: free some space"):
        Store.open(url_of(disk), writer="serve")
    if there:
        with Store.open(url_of(disk), writer=None) as reader:
            assert len(reader.poses(run_id)) == 3, "reading needs no room"
    disk.make_room()
    with Store.open(url_of(disk), writer="serve") as store:
        assert [run.id for run in store.runs()[0]] == ([run_id] if there else [])


def test_a_disk_that_fills_in_the_middle_keeps_what_was_stored_and_goes_on_with_room(disk):
    with Store.open(url_of(disk), writer="run") as store:
        run = store.create_run(unit="A", rig="r", plan=None, status="running", provenance={})
        stored = 0
        disk.fill()
        (disk / "ballast").open("r+b").truncate(300_000)
        with pytest.raises(StoreUnavailableError, match="the disk is full"):
            for k in range(1000):
                store.add_pose(run.id, k, Pose(float(k), float(k)), [block(k)], [("pose", {"index": k})])
                stored += 1
        assert 0 < stored < 1000
        assert [p.index for p in store.poses(run.id)] == list(range(stored))
        assert len(store.samples(run.id)) == 500 * stored
        disk.make_room()
        store.add_pose(run.id, stored, Pose(0.0, 0.0), [block(stored)], [("pose", {"index": stored})])
        assert len(store.poses(run.id)) == stored + 1


def test_a_disk_too_full_for_the_copy_before_a_migration_leaves_the_store_as_it_was(
    disk, tmp_path, monkeypatch
):
    run_id = filled(url_of(disk))
    later_program(tmp_path, monkeypatch)
    disk.fill()
    (disk / "ballast").open("r+b").truncate((disk / "ballast").stat().st_size - 100_000)
    was = (disk / "calrig.db").read_bytes()
    with pytest.raises(StoreError, match=r"nothing was changed.*\.bak: the disk is full: free some space"):
        Store.open(url_of(disk), writer="serve")
    assert (disk / "calrig.db").read_bytes() == was
    assert sorted(p.name for p in disk.iterdir()) == ["ballast", "calrig.db", "calrig.db.lock"]
    disk.make_room()
    with Store.open(url_of(disk), writer="serve") as store:
        assert len(store.poses(run_id)) == 20


def test_a_disk_too_full_for_the_migration_itself_leaves_the_store_as_it_was(disk, tmp_path, monkeypatch):
    run_id = filled(url_of(disk), poses=3)
    later_program(
        tmp_path, monkeypatch, then='op.execute("UPDATE sample_block SET data = zeroblob(2000000)")'
    )
    with pytest.raises(StoreError, match=r"could not be brought.*disk is full.*as it was; a copy is in"):
        Store.open(url_of(disk), writer="serve")
    monkeypatch.undo()
    with Store.open(url_of(disk), writer="serve") as store:
        assert len(store.samples(run_id)) == 1500


def test_a_read_only_disk_is_read_and_not_written(disk):
    run_id = filled(url_of(disk), poses=3)
    disk.remount("ro")
    with Store.open(url_of(disk), writer=None) as reader:
        assert len(reader.poses(run_id)) == 3
    with pytest.raises(StoreError, match=r"lock cannot be made \(Read-only file system\).*name another"):
        Store.open(url_of(disk), writer="serve")
    disk.remount("rw")
    Store.open(url_of(disk), writer="serve").close()


def test_a_reader_without_locks_says_so_where_a_writer_came_meanwhile(disk):
    run_id = filled(url_of(disk), poses=3)
    disk.remount("ro")
    with Store.open(url_of(disk), writer=None) as reader:
        disk.remount("rw")
        with Store.open(url_of(disk), writer="serve") as store:
            store.void_run(run_id, "bumped")
            with pytest.raises(StoreUnavailableError, match="a writer has taken it while it was read"):
                reader.run(run_id)


def test_a_network_drive_is_not_written_to_and_read_only_where_nobody_writes(
    url, database, tmp_path, monkeypatch
):
    run_id = filled(url, poses=3)
    was = database.read_bytes()
    mounts = tmp_path / "mountinfo"
    mounts.write_text(
        "22 1 8:1 / / rw shared:1 - ext4 /dev/sda1 rw\n"
        f"40 22 0:35 / {tmp_path} rw shared:2 - nfs4 server:/lab rw,vers=4.2\n"
    )
    monkeypatch.setattr(file_system, "MOUNTS", mounts)
    with pytest.raises(StoreError, match=r"network drive.*nfs4.*local disk.*calrig backup"):
        Store.open(url, writer="serve")
    with Store.open(url, writer=None) as reader:
        assert len(reader.poses(run_id)) == 3
    Path(f"{database}-wal").write_bytes(b"somebody writes on another host")
    with pytest.raises(StoreError, match=r"network drive.*nfs4"):
        Store.open(url, writer=None)
    assert database.read_bytes() == was


def test_mount_points_with_blanks_and_the_last_of_two_are_understood(tmp_path, monkeypatch):
    mounts = tmp_path / "mountinfo"
    mounts.write_text(
        "22 1 8:1 / / rw - ext4 /dev/sda1 rw\n"
        "40 22 0:35 / /mnt/lab\\040share rw - cifs //server/lab rw\n"
        "41 22 0:36 / /mnt/twice rw - nfs server:/old rw\n"
        "42 22 0:37 / /mnt/twice rw - xfs /dev/sdb1 rw\n"
    )
    monkeypatch.setattr(file_system, "MOUNTS", mounts)
    assert file_system.file_system(Path("/mnt/lab share/calrig.db")) == "cifs"
    assert file_system.file_system(Path("/mnt/twice/calrig.db")) == "xfs"
    assert file_system.file_system(Path("/mnt/lab/calrig.db")) == "ext4"


@pytest.mark.parametrize("refusal", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_drive_that_cannot_lock_is_said(url, database, monkeypatch, refusal):
    def flock(_file: int, _how: int) -> None:
        raise OSError(refusal, os.strerror(refusal))

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(StoreError, match=r"cannot be locked: .*local disk"):
        Store.open(url, writer="serve")
    assert not database.exists()


def test_a_drive_without_a_write_ahead_log_is_said(url, monkeypatch):
    as_uri = Path.as_uri  # one of SQLite's own ways to a file, for drives that share no memory
    monkeypatch.setattr(Path, "as_uri", lambda path: f"{as_uri(path)}?vfs=unix-none")
    with pytest.raises(StoreError, match=r"network drive.*journal.*local disk"):
        Store.open(url, writer="serve")


def everything(store: Store, run_id: str) -> dict[str, Any]:
    """All that can be asked of a run; where the store refuses, the refusal."""
    asked: dict[str, Callable[[], Any]] = {
        "run": lambda: store.run(run_id),
        "poses": lambda: store.poses(run_id),
        "events": lambda: [
            (e.seq, e.data["reading_deg"]) for e in store.events_after(run_id) if "index" in e.data
        ],
        "samples": lambda: {n: v.tobytes() for n, v in vars_of(store.samples(run_id)).items()},
        "comparison": store.comparison,
    }
    answers: dict[str, Any] = {}
    for name, ask in asked.items():
        try:
            answers[name] = ask()
        except StoreError as error:
            answers[name] = error
    return answers


def vars_of(samples: Any) -> dict[str, np.ndarray]:
    return {name: getattr(samples, name) for name in ("time_s", "accel_g", "gyro_dps", "temperature_c")}


NUMBERS = ("result", "progress", "faults", "plan", "diagnosis", "provenance")


def same(name: str, answer: Any, truth: Any) -> bool:
    """Whether an answer has the numbers of the truth; a letter of a name is not promised."""
    if name == "run":
        return answer is None or all(getattr(answer, n) == getattr(truth, n) for n in NUMBERS)
    if name == "comparison":
        return [row[4:] for row in answer] in ([row[4:] for row in truth], [])
    return bool(answer == truth)


def test_a_flipped_bit_is_said_or_does_no_harm_and_never_gives_another_number(
    url, database, result, tmp_path
):
    run_id = filled(url, result, poses=12)
    with Store.open(url, writer=None) as store:
        truth = everything(store, run_id)
    sound = database.read_bytes()
    dice = random.Random(5)
    said = 0
    for _ in range(30):
        flipped = bytearray(sound)
        at = dice.randrange(len(flipped))
        flipped[at] ^= 1 << dice.randrange(8)
        broken = tmp_path / "broken.db"
        broken.write_bytes(flipped)
        try:
            with Store.open(f"sqlite:///{broken}", writer=None) as store:
                answers = everything(store, run_id)
        except StoreError:
            said += 1
            continue
        refused = [a for a in answers.values() if isinstance(a, StoreError)]
        assert all("damaged" in str(a) and "newest backup" in str(a) for a in refused)
        said += bool(refused)
        wrong = [n for n, a in answers.items() if not isinstance(a, StoreError) and not same(n, a, truth[n])]
        assert wrong == [], f"byte {at}"
    assert said > 10, "most of a store is samples, and each block of them has a checksum"


def read_samples(url: str, writer: str | None) -> None:
    with Store.open(url, writer=writer) as store:
        store.samples("1")


@pytest.mark.parametrize("writer", ["serve", None])
def test_a_truncated_file_is_said_and_left_alone(url, database, writer):
    filled(url)
    os.truncate(database, database.stat().st_size // 2)
    was = database.read_bytes()
    with pytest.raises(StoreDamagedError, match=r"damaged: keep a copy.*calrig backup"):
        read_samples(url, writer)
    assert database.read_bytes() == was


def test_an_empty_file_with_a_log_beside_it_is_not_taken_for_a_new_store(url, database):
    database.touch()
    log = Path(f"{database}-wal")
    log.write_bytes(b"an hour of somebody's morning")
    with pytest.raises(StoreDamagedError, match="empty and its -wal file is not"):
        Store.open(url, writer="serve")
    assert log.read_bytes() == b"an hour of somebody's morning"


DIE = """
import os, signal, sys
from calrig.store import Store
store = Store.open(sys.argv[1], writer="run")
store.create_run(unit="B", rig="bench", plan=None, status="running", provenance={})
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_after_a_writer_died_its_store_is_looked_through_before_anything_is_written(url, database):
    filled(url)
    with closing(sqlite3.connect(database)) as connection:
        (poses_page,) = connection.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'pose'"
        ).fetchone()
    with python(DIE, url) as writer:
        assert writer.wait() == -signal.SIGKILL
    log = Path(f"{database}-wal")
    assert log.stat().st_size > 0
    with database.open("r+b") as file:  # the poses' first page, which the log does not hold
        file.seek(4096 * (poses_page - 1))
        file.write(bytes(4096))
    was = database.read_bytes(), log.read_bytes()
    with pytest.raises(StoreDamagedError, match="damaged: keep a copy"):
        Store.open(url, writer="serve")
    assert (database.read_bytes(), log.read_bytes()) == was


def test_poses_and_events_that_vanished_are_missed(url, database):
    run_id = filled(url, poses=5)
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("DELETE FROM pose WHERE pose_index = 4")
        connection.execute("DELETE FROM event WHERE seq = 3")
        connection.commit()
    with Store.open(url, writer=None) as store:
        with pytest.raises(StoreDamagedError, match="1 poses of run 1 are missing"):
            store.poses(run_id)
        with pytest.raises(StoreDamagedError, match="event 3 of run 1 is missing"):
            store.events_after(run_id)


def test_a_reading_whose_digit_has_changed_is_noticed(url, database):
    run_id = filled(url, poses=5)
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("UPDATE pose SET reading_deg = reading_deg + 1 WHERE pose_index = 2")
        connection.commit()
    with (
        Store.open(url, writer=None) as store,
        pytest.raises(StoreDamagedError, match="pose 2 of run 1 is not what was stored"),
    ):
        store.poses(run_id)
