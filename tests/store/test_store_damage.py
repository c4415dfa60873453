"""Damage to a store's file is said with what to do, and never gives another number."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich_store import filled
from test_store_open import python

from calrig.store import Store, StoreDamagedError, StoreError


def everything(store: Store, run_id: str) -> dict[str, Any]:
    """All that can be asked of a run; where the store refuses, the refusal."""
    asked: dict[str, Callable[[], Any]] = {
        "run": lambda: store.runs.get(run_id),
        "poses": lambda: store.poses.of(run_id),
        "events": lambda: [
            (e.seq, e.data["reading_deg"]) for e in store.events.after(run_id) if "index" in e.data
        ],
        "samples": lambda: {n: v.tobytes() for n, v in vars_of(store.samples.of(run_id)).items()},
        "comparison": store.units.comparison,
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
    run_id = filled(url, result, poses=40)
    with Store.open(url, writer=None) as store:
        truth = everything(store, run_id)
    sound = database.read_bytes()
    dice = random.Random(5)
    said = 0
    for _ in range(20):
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
    assert said > 7, "most of a store is samples, and each block of them has a checksum"


def read_samples(url: str, run_id: str, writer: str | None) -> None:
    with Store.open(url, writer=writer) as store:
        store.samples.of(run_id)


@pytest.mark.parametrize("writer", ["serve", None])
def test_a_truncated_file_is_said_and_left_alone(url, database, writer):
    run_id = filled(url)
    os.truncate(database, database.stat().st_size // 2)
    was = database.read_bytes()
    with pytest.raises(StoreDamagedError, match=r"damaged: keep a copy.*calrig backup"):
        read_samples(url, run_id, writer)
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
store.runs.create(unit="B", rig="bench", plan=None, status="running", provenance={})
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
        with pytest.raises(StoreDamagedError, match=f"1 poses of run {run_id} are missing"):
            store.poses.of(run_id)
        with pytest.raises(StoreDamagedError, match=f"event 3 of run {run_id} is missing"):
            store.events.after(run_id)


def test_a_reading_whose_digit_has_changed_is_noticed(url, database):
    run_id = filled(url, poses=5)
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("UPDATE pose SET reading_deg = reading_deg + 1 WHERE pose_index = 2")
        connection.commit()
    with (
        Store.open(url, writer=None) as store,
        pytest.raises(StoreDamagedError, match=f"pose 2 of run {run_id} is not what was stored"),
    ):
        store.poses.of(run_id)
