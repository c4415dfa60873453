"""A store that somebody else wrote: nothing in it runs, and all of it is read or said to be damaged."""

from __future__ import annotations

import io
import json
import shutil
import sqlite3
import zipfile
import zlib
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from empty_store import lay_empty_store
from test_store_migrations import later_program
from test_store_trouble import filled

from calrig.store import Store, StoreDamagedError, StoreError, back_up


def sealed(document: dict[str, Any]) -> str:
    """A document with the checksum that it ought to have: whoever writes by hand can reckon, too."""
    text = json.dumps(document, ensure_ascii=False, separators=(",", ":"))
    return json.dumps({**document, " crc32": zlib.crc32(text.encode())}, ensure_ascii=False)


N = 500
ARRAYS = {
    "time_s": np.arange(N) / 200,
    "accel_g": np.ones((N, 3)),
    "gyro_dps": np.ones((N, 3)),
    "temperature_c": np.ones(N),
}


def packed(**changed: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{**ARRAYS, **changed})
    return buffer.getvalue()


def bomb(said: tuple[int, ...], n_bytes: int) -> bytes:
    """An archive whose first array says that it has a shape, and unpacks to so many bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ARRAYS:
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                header, {"descr": "<f8", "fortran_order": False, "shape": said}
            )
            with archive.open(f"{name}.npy", "w") as file:
                file.write(header.getvalue())
                for _ in range(n_bytes // 1_000_000):
                    file.write(bytes(1_000_000))
    return buffer.getvalue()


JSON_TEXTS = {
    "nested lists": "[" * 100_000,
    "nested objects": '{"a":' * 50_000,
    "a number": "5",
    "a list": "[1, 2]",
    "not a number": '{"a": NaN}',
    "infinite": '{"a": 1e999}',
    "five thousand digits": f'{{"a": {"9" * 5000}}}',
    "a lone surrogate": '{"a": "\\ud800"}',
    "of other types": sealed({"poses_done": "x", "filter": 5, "rate_hz": "x", "reading_deg": []}),
}
TEXTS = {"bytes": b"\xff\xfe", "a number": 5}
NUMBERS = {"text": "abc", "bytes": b"zz", "infinite": float("inf")}
BLOBS = {
    "text": "abc",
    "a number": 5,
    "no archive": b"PK",
    "a flat array": packed(accel_g=np.ones(7)),
    "words": packed(time_s=np.array(["a"] * N)),
    "complex numbers": packed(time_s=np.ones(N) * 1j),
    "records": packed(time_s=np.zeros(N, dtype=[("a", "f8")])),
    "one number": packed(time_s=np.float64(1)),
    "too few times": packed(time_s=np.arange(3.0)),
    "a shape beyond memory": bomb((10**13,), 0),
    "a bomb": lambda: bomb((16_250_000,), 130_000_000),  # of four such; 500 MB is the most of a block
}
COLUMNS = {
    "run": (("plan", "progress", "result", "faults", "provenance"), JSON_TEXTS),
    "event": (("data",), JSON_TEXTS),
    "pose": (("covariates",), JSON_TEXTS),
    "run ": (("unit", "rig", "kind", "status", "note"), {**TEXTS, "a word": "well"}),
    "run  ": (("created_at",), TEXTS),
    "event ": (("type", "at"), TEXTS),
    "pose ": (("reading_deg", "sweep", "n_samples", "crc32"), NUMBERS),
    "calibration": (("bias_deg", "scale", "crc32"), NUMBERS),
    "sample_block": (("data",), BLOBS),
}
PLANTED = [
    pytest.param(table.strip(), column, values, id=f"{table.strip()}.{column}")
    for table, (columns, values) in COLUMNS.items()
    for column in columns
]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A store and the id of the run in it."""
    database = tmp_path_factory.mktemp("sound") / "calrig.db"
    figures = {"bias_deg": 0.25, "scale": 1.0, "rms_raw_deg": 0.2, "rms_calibrated_deg": 0.1}
    return database, filled(f"sqlite:///{database}", figures, poses=2)


@pytest.mark.parametrize(("table", "column", "values"), PLANTED)
def test_what_was_planted_is_read_or_said_to_be_damaged(sound, tmp_path, table, column, values):
    original, run_id = sound
    database = tmp_path / "calrig.db"
    shutil.copy(original, database)
    with (
        Store.open(f"sqlite:///{database}", writer=None) as store,
        closing(sqlite3.connect(database)) as by_hand,
    ):
        for name, value in values.items():
            planted = value() if callable(value) else value
            by_hand.execute(f"UPDATE {table} SET {column} = ?", (planted,))
            by_hand.commit()
            look_at_everything(store, run_id, name)


def look_at_everything(store: Store, run_id: str, planted: str) -> None:
    asked = {
        "run": lambda: store.runs.get(run_id),
        "runs": store.runs.page,
        "unit": lambda: store.units.get("A"),
        "poses": lambda: store.poses.of(run_id),
        "events": lambda: store.events.after(run_id),
        "samples": lambda: store.samples.of(run_id),
        "blocks": lambda: list(store.samples.blocks_of(run_id)),
        "comparison": store.units.comparison,
    }
    for name, ask in asked.items():
        try:
            told = ask()
        except StoreError as error:
            assert isinstance(error, StoreDamagedError), (planted, name)
            assert len(str(error)) < 1000, (planted, name)
        else:
            if name in {"run", "runs", "events"}:
                assert "\\x" not in str(told), f"{planted}: bytes where text belongs"
                str(told).encode()


SPIES = {
    "trigger": "CREATE TRIGGER spy AFTER INSERT ON run BEGIN UPDATE unit SET serial = 'mine'; END",
    "view": "CREATE VIEW spy AS SELECT * FROM run",
    "virtual table": "CREATE VIRTUAL TABLE spy USING fts5(words)",
    "trigger whose name clears the screen": 'CREATE TRIGGER "spy\n\x1b[2J" AFTER UPDATE ON run BEGIN '
    "DELETE FROM pose; END",
}


def plant(database: Path, statement: str) -> bytes:
    with closing(sqlite3.connect(database)) as connection:
        connection.execute(statement)
        connection.commit()
    return database.read_bytes()


@pytest.fixture
def honest_store(url: str, database: Path) -> None:
    lay_empty_store(database)
    with Store.open(url, writer="test") as store:
        store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})


@pytest.mark.usefixtures("honest_store")
@pytest.mark.parametrize("statement", SPIES.values(), ids=SPIES)
def test_what_was_planted_is_named_and_nothing_is_opened_copied_or_converted(
    url, database, tmp_path, monkeypatch, statement
):
    was = plant(database, statement)
    told = r"calrig\.db: .*did not make.*spy.*nothing was changed.*backup"
    for writer in ("import", None):
        with pytest.raises(StoreError, match=told):
            Store.open(url, writer=writer)
    with pytest.raises(StoreError, match=told):
        back_up(url, tmp_path / "copy.db")
    later_program(tmp_path, monkeypatch)
    with pytest.raises(StoreError, match=told) as refused:
        Store.open(url, writer="serve")
    assert str(refused.value).isprintable()
    assert database.read_bytes() == was
    assert not list(tmp_path.glob("*.bak")) + list(tmp_path.glob("copy*"))


def test_a_table_that_was_made_a_view_is_not_even_asked_for_unfinished_runs(url, database):
    """Such a view would never end: opening says what is wrong instead."""
    Store.open(url, writer="test").close()
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA foreign_keys = OFF")
        connection.execute("DROP TABLE run")
    plant(
        database,
        "CREATE VIEW run AS WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) "
        "SELECT k AS id, 'r' AS rig, 'none' AS status FROM n",
    )
    with pytest.raises(StoreError, match=r"did not make.*view 'run'"):
        Store.open(url, writer="serve")


def test_the_stages_of_a_store_that_is_refused_are_stopped_all_the_same(url, database, honest_store):
    plant(database, SPIES["trigger"])
    stopped: list[str] = []
    with pytest.raises(StoreError, match="did not make"):
        Store.open(url, writer="serve", left_by_the_dead=stopped.extend)
    assert stopped == ["r"]


def test_functions_that_a_schema_must_not_call_are_refused_it(store, database):
    with store._database.reading() as session:
        assert session.connection().exec_driver_sql("PRAGMA trusted_schema").scalar() == 0
