"""A full disk, a read-only one, a network drive: said with what to do, and nothing is lost by it."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich_store import block, filled
from test_store_migrations import later_program

from calrig.calibration.poses import Pose
from calrig.store import Store, StoreError, StoreUnavailableError
from calrig.store.sqlite import file as file_system


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
            assert len(reader.poses.of(run_id)) == 3, "reading needs no room"
    disk.make_room()
    with Store.open(url_of(disk), writer="serve") as store:
        assert [run.id for run in store.runs.page()[0]] == ([run_id] if there else [])


def test_a_disk_that_fills_in_the_middle_keeps_what_was_stored_and_goes_on_with_room(disk):
    with Store.open(url_of(disk), writer="run") as store:
        run = store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        stored = 0
        disk.fill()
        (disk / "ballast").open("r+b").truncate(300_000)
        with pytest.raises(StoreUnavailableError, match="the disk is full"):
            for k in range(1000):
                store.poses.add(run.id, k, Pose(float(k), float(k)), [block(k)], [("pose", {"index": k})])
                stored += 1
        assert 0 < stored < 1000
        assert [p.index for p in store.poses.of(run.id)] == list(range(stored))
        assert len(store.samples.of(run.id)) == 500 * stored
        disk.make_room()
        store.poses.add(run.id, stored, Pose(0.0, 0.0), [block(stored)], [("pose", {"index": stored})])
        assert len(store.poses.of(run.id)) == stored + 1


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
        assert len(store.poses.of(run_id)) == 20


def test_a_disk_too_full_for_the_migration_itself_leaves_the_store_as_it_was(disk, tmp_path, monkeypatch):
    run_id = filled(url_of(disk), poses=3)
    later_program(
        tmp_path, monkeypatch, then='op.execute("UPDATE sample_block SET data = zeroblob(2000000)")'
    )
    with pytest.raises(StoreError, match=r"could not be brought.*disk is full.*as it was; a copy is in"):
        Store.open(url_of(disk), writer="serve")
    monkeypatch.undo()
    with Store.open(url_of(disk), writer="serve") as store:
        assert len(store.samples.of(run_id)) == 1500


def test_a_read_only_disk_is_read_and_not_written(disk):
    run_id = filled(url_of(disk), poses=3)
    disk.remount("ro")
    with Store.open(url_of(disk), writer=None) as reader:
        assert len(reader.poses.of(run_id)) == 3
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
            store.amendments.void(run_id, "bumped")
            with pytest.raises(StoreUnavailableError, match="a writer has taken it while it was read"):
                reader.runs.get(run_id)


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
        assert len(reader.poses.of(run_id)) == 3
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
    monkeypatch.setattr(Path, "as_uri", lambda path: f"{as_uri(path)}?vfs=unix-none&")
    with pytest.raises(StoreError, match=r"network drive.*journal.*local disk"):
        Store.open(url, writer="serve")
