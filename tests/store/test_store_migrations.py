"""Migrations: from nothing, from an older database with a copy kept, never from a newer one."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from empty_store import lay_empty_store
from sqlalchemy import create_engine

from calrig.settings import packed
from calrig.store import Store, StoreError
from calrig.store import database as revisions
from calrig.store.sqlite.copying import stored_revision

LATER = """
import sqlalchemy as sa
from alembic import op

revision = "{revision}"
down_revision = "{down}"


def upgrade():
    with op.batch_alter_table("unit") as unit:
        unit.add_column(sa.Column("maker", sa.String(), nullable=False, server_default="unknown"))
    {then}
"""


def later_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, then: str = "pass") -> str:
    """From here on calrig is one revision ahead; returns that revision."""
    folder = tmp_path / "migrations"
    shutil.copytree(packed("migrations"), folder, ignore=shutil.ignore_patterns("__pycache__"))
    down = revisions.revisions()[-1]
    revision = f"{int(down) + 1:04}"
    (folder / "versions" / f"{revision}_makers.py").write_text(
        LATER.format(revision=revision, down=down, then=then)
    )
    monkeypatch.setattr(revisions, "packed", lambda _: folder)
    return revision


@pytest.fixture
def filled(url: str, database: Path) -> str:
    lay_empty_store(database)
    with Store.open(url, writer="serve") as store:
        return store.runs.create(unit="A", rig="r", plan=None, status="completed", provenance={}).id


def test_migrations_and_tables_say_the_same(store, database):
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext
    from alembic.script import ScriptDirectory

    from calrig.store.tables import SQLModel

    with create_engine(f"sqlite:///{database}").connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, SQLModel.metadata) == []
    scripts = ScriptDirectory(str(packed("migrations")))
    assert [s.revision for s in scripts.walk_revisions()][::-1] == revisions.revisions()
    assert scripts.get_heads() == revisions.revisions()[-1:]


def test_a_new_database_needs_no_copy(store, database):
    assert stored_revision(database) == revisions.revisions()[-1]
    assert list(database.parent.glob("*.bak*")) == []


def test_an_older_database_is_brought_up_to_date_after_a_copy_is_kept(
    filled, url, database, tmp_path, monkeypatch
):
    before = stored_revision(database)
    revision = later_program(tmp_path, monkeypatch)

    with pytest.raises(StoreError, match=r"older calrig.*run `calrig serve` once"):
        Store.open(url, writer=None)
    with Store.open(url, writer="serve") as store:
        assert store.runs.get(filled).unit == "A"

    assert stored_revision(database) == revision
    with closing(sqlite3.connect(database)) as connection:
        assert connection.execute("SELECT serial, maker FROM unit").fetchall() == [("A", "unknown")]
    copy = database.with_name(f"calrig.db.before-{revision}.bak")
    assert stored_revision(copy) == before
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("SELECT unit FROM run").fetchall() == [("A",)]
    Store.open(url, writer="serve").close()
    assert [p.name for p in tmp_path.glob("*.bak*")] == [copy.name], "a copy only when something changes"


def test_a_copy_is_never_overwritten(filled, url, database, tmp_path, monkeypatch):
    revision = later_program(tmp_path, monkeypatch)
    first = database.with_name(f"calrig.db.before-{revision}.bak")
    first.write_bytes(b"precious")
    Store.open(url, writer="serve").close()
    assert first.read_bytes() == b"precious"
    assert database.with_name(f"calrig.db.before-{revision}.2.bak").exists()


@pytest.mark.parametrize(
    "then", ['op.execute("SELECT no_such_column FROM run")', 'op.execute("DELETE FROM unit")']
)
def test_a_migration_that_fails_leaves_the_database_as_it_was(
    filled, url, database, tmp_path, monkeypatch, then
):
    def contents() -> list[str]:
        with closing(sqlite3.connect(database)) as connection:
            return list(connection.iterdump())

    was = contents()
    later_program(tmp_path, monkeypatch, then)
    with pytest.raises(StoreError, match=r"could not be brought to revision.*it is as it was; a copy is in"):
        Store.open(url, writer="serve")
    assert contents() == was


@pytest.mark.parametrize("writer", ["serve", None])
def test_a_newer_database_is_refused_untouched_with_what_to_do(filled, url, database, tmp_path, writer):
    with pytest.MonkeyPatch.context() as later:
        revision = later_program(tmp_path, later)
        Store.open(url, writer="serve").close()
    was = database.read_bytes()

    with pytest.raises(StoreError) as refused:
        Store.open(url, writer=writer)

    assert f"newer calrig (revision {revision}" in str(refused.value)
    assert "install the newer calrig" in str(refused.value)
    assert f"calrig.db.before-{revision}.bak" in str(refused.value)
    assert database.read_bytes() == was


@pytest.mark.parametrize("revision", revisions.revisions()[:-1])
def test_a_store_of_every_earlier_revision_is_brought_up_to_date(url, database, revision):
    make_as_of(database, revision)
    with Store.open(url, writer="serve") as store:
        (pose,) = store.poses.of("1")
        assert (pose.index, pose.pose.reading_deg, pose.pose.covariates) == (0, 10.25, {"humidity": 0.4})
        assert store.runs.get("1").result.bias_deg == 0.25
        (row,) = store.units.comparison()
        assert (row.unit, row.result["bias_deg"]) == ("A", 0.25)
        assert [(event.seq, event.type) for event in store.events.after("1")] == [(1, "state")]
    assert stored_revision(database) == revisions.revisions()[-1]
    copy = database.with_name(f"calrig.db.before-{revisions.revisions()[-1]}.bak")
    assert stored_revision(copy) == revision


def test_the_trail_of_a_store_of_counted_runs_stays_whole_and_goes_on(url, database):
    """Its hashes are of the runs' numbers, as the calrig of that time wrote them."""
    make_as_of(database, "0006")
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.executemany(f"INSERT INTO trail VALUES ({', '.join('?' * 11)})", COUNTED)
    with Store.open(url, writer="serve") as store:
        assert store.trail.broken_link() is None
        store.amendments.void("1", "slipped again")
        run = store.runs.create(unit="A", rig="r", plan={}, status="queued", provenance={}, follows="1")
        assert [entry.run_id for entry in store.trail.entries()] == ["1", None, "1", "1", run.id]
        assert run.follows == "1"
        assert store.trail.broken_link() is None
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE trail SET run_id = '01' WHERE seq = 3")
    with Store.open(url, writer=None) as store:
        assert store.trail.broken_link() == 3


COUNTED = [
    (1, "2026-01-02T03:04:05.000006+00:00", "ada", "started", "A", "r", 1, None, None,
     '{" crc32":2745614147}', "73743b8f6878368557d05c801213a3a1668331307d6e2c2a0d249369a97bf15f"),
    (2, "2026-01-02T03:04:05.000007+00:00", None, "limits_changed", None, None, None, None, None,
     '{" crc32":2745614147}', "e1e3675ae8f0b2831da52ee27739230054dcccbc45b3a190f462c5db053be548"),
    (3, "2026-01-02T03:04:05.000008+00:00", None, "voided", "A", "r", 1, None, "slipped",
     '{" crc32":2745614147}', "3540c38d1ce2b0c22766a03b42ac716e7201725c92b2e4a9f5ae42644b9955d3"),
]  # fmt: skip
"""Rows of a trail that calrig wrote at revision 0006, when a run's id was its number."""


def make_as_of(database: Path, revision: str) -> None:
    """A store as calrig made it at that revision, with one completed run."""
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(packed("migrations")))
    with create_engine(f"sqlite:///{database}").begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
        at = "2026-01-02T03:04:05.000006+00:00"
        uid, one = ("uid,", "'1',") if revision >= "0007" else ("", "")
        for statement in (
            f"INSERT INTO unit (serial, created_at) VALUES ('A', '{at}')",
            f"INSERT INTO run (id, {uid} unit, rig, kind, status, progress, result, faults, provenance, "
            f"created_at, started_at, finished_at) VALUES (1, {one} 'A', 'r', 'calibration', 'completed', "
            f"'{{}}', '{{\"bias_deg\":0.25}}', '{{}}', '{{}}', '{at}', '{at}', '{at}')",
            "INSERT INTO calibration (run_id, bias_deg, rms_raw_deg) VALUES (1, 0.25, 0.3)",
            "INSERT INTO pose (run_id, pose_index, target_deg, reading_deg, covariates) "
            "VALUES (1, 0, 10, 10.25, '{\"humidity\":0.4}')",
            f"INSERT INTO event (run_id, seq, type, data, at) VALUES (1, 1, 'state', '{{}}', '{at}')",
        ):
            connection.exec_driver_sql(statement)
