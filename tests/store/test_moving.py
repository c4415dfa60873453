"""A store that is moved is the same store, on whichever engine; of one that is damaged nothing is moved."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import closing
from typing import Any

import pytest
from postgresql_server import MakeDatabase
from rich_store import by_hand, rows_in
from sqlalchemy import create_engine, text
from support import serving
from typer.testing import CliRunner

from calrig.cli.main import app
from calrig.store import Store, StoreDamagedError, StoreError
from calrig.store.moving import Moved, move_store

OF_BENCHES = {"bench", "bench_command", "delivery", "fleet_finding", "parcel", "run_order", "taken_order"}
"""Tables that a service of its own rigs does not fill."""


def hashes(moved: Moved) -> dict[str, tuple[int, str]]:
    return {table.name: (table.rows, table.sha256) for table in moved.tables}


def answers(url: str, token: str) -> dict[str, Any]:
    """What the API tells of everything in a store."""
    from calrig.runs.service import RunService

    with (
        Store.open(url, writer="serve") as store,
        closing(RunService(store, [])) as service,
        serving(service) as client,
    ):
        client.headers["Authorization"] = f"Bearer {token}"
        runs = client.get("/api/runs").json()["items"]
        asked = [
            "runs",
            "units",
            "compare",
            "limits",
            "trail",
            "users",
            "check-units",
            "solve",
            "certificates",
        ]
        asked += [f"calibrations?since={runs[-1]['created_at']}"]
        for run in runs:
            of_it = f"runs/{run['id']}"
            asked += [of_it, f"{of_it}/poses", f"{of_it}/events", f"{of_it}/samples", f"{of_it}/transcript"]
        for unit in client.get("/api/units").json():
            of_it = f"units/{unit['serial']}"
            asked += [of_it, f"{of_it}/calibration", f"{of_it}/calibrations", f"{of_it}/changes"]
        for one in client.get("/api/certificates").json():
            asked += [f"certificates/{one['number']}?format={form}" for form in ("pdf", "dcc", "json")]
        told = {path: client.get(f"/api/{path}") for path in asked}
    assert all(answer.status_code in {200, 404} for answer in told.values())
    return {path: (answer.status_code, answer.content) for path, answer in told.items()}


def test_a_store_goes_there_and_back_and_answers_as_before(rich_and_token, tmp_path, new_database):
    rich, token = rich_and_token
    there, back = new_database(), tmp_path / "back.db"
    before = rich.read_bytes()
    moved = move_store(f"sqlite:///{rich}", there)
    returned = move_store(there, f"sqlite:///{back}")
    assert rich.read_bytes() == before
    assert hashes(returned) == hashes(moved)
    assert {table.name for table in moved.tables if table.rows == 0} <= OF_BENCHES
    told = answers(f"sqlite:///{shutil.copy(rich, tmp_path / 'before.db')}", token)
    assert answers(there, token) == told
    assert answers(f"sqlite:///{back}", token) == told


def test_what_is_stored_next_is_numbered_after_what_was_moved(rich, new_database):
    there = new_database()
    move_store(f"sqlite:///{rich}", there)
    with Store.open(there, writer="serve") as store:
        run = store.runs.create(unit="new", rig="r", plan=None, status="running", provenance={})
        store.events.save_transcripts(run.id, {"port": "text"})
        assert store.trail.broken_link() is None
        assert store.events.transcripts(run.id) == {"port": "text"}


def test_the_hash_of_a_table_is_that_of_its_lines(source, tmp_path, new_database):
    """As `raw_rows` tells, so that anybody can reckon it with other tools."""
    import hashlib

    moved = hashes(move_store(f"sqlite:///{source}", new_database()))
    with by_hand(source) as file:
        rows = file.execute("SELECT rig, stage_deg, at FROM stage_place ORDER BY rig").fetchall()
    lines = [["rig", "stage_deg", "at"], *map(list, rows)]
    told = "".join(json.dumps(one, separators=(",", ":"), ensure_ascii=False) + "\n" for one in lines)
    assert moved["stage_place"] == (2, hashlib.sha256(told.encode()).hexdigest())


def test_what_is_nothing_and_what_is_empty_are_kept_apart(tmp_path, new_database):
    at = "2026-01-01T00:00:00.000000+00:00"
    first, there, back = (new_database(), new_database(), tmp_path / "back.db")
    with create_engine(first).begin() as connection:
        connection.execute(text("INSERT INTO bench (name, said) VALUES ('b', '{}')"))
        for seq, data in enumerate((None, b"", b"\0\xff"), start=1):
            connection.execute(
                text(
                    "INSERT INTO parcel (bench, seq, run_uid, document, data, delivered_at) "
                    r"""VALUES ('b', :seq, 'u', '{"a" : -0.0, "s": "\u0000"}', :data, :at)"""
                ),
                {"seq": seq, "data": data, "at": at},
            )
    moved = move_store(first, there), move_store(there, f"sqlite:///{back}")
    assert hashes(moved[0]) == hashes(moved[1])
    with by_hand(back) as file:
        kept = file.execute("SELECT data, document FROM parcel ORDER BY seq").fetchall()
    document = r'{"a" : -0.0, "s": "\u0000"}'
    assert kept == [(None, document), (b"", document), (b"\0\xff", document)]


def test_a_zero_has_no_sign_and_what_is_no_number_is_refused(tmp_path, new_database):
    there, back = new_database(), tmp_path / "back.db"
    engine = create_engine(there)
    with engine.begin() as connection:
        connection.execute(text("INSERT INTO stage_place VALUES ('r', '-0.0', '2026-01-01T00:00:00+00:00')"))
    zero = move_store(there, f"sqlite:///{back}")
    assert hashes(zero) == hashes(move_store(f"sqlite:///{back}", new_database()))
    with engine.begin() as connection:
        connection.execute(text("UPDATE stage_place SET stage_deg = 'NaN'"))
    with pytest.raises(StoreDamagedError, match=r"'stage_deg' of the row of 'stage_place' with rig 'r'"):
        move_store(there, f"sqlite:///{tmp_path / 'other.db'}")


def test_a_store_that_has_anything_in_it_is_not_moved_into(rich, source, new_database):
    there = new_database()
    with Store.open(there, writer="serve") as store:
        store.positions.save("r", 1.0)
    with pytest.raises(StoreError, match=r"is not empty .1 rows in 'stage_place'.: name an empty"):
        move_store(f"sqlite:///{rich}", there)
    assert rows_in(there) == {"stage_place": 1}
    with pytest.raises(StoreError, match=r"is not empty .*rows in 'run'"):
        move_store(f"sqlite:///{rich}", f"sqlite:///{source}")


def test_a_source_in_which_runs_go_on_is_refused_and_says_whose(source, new_database):
    url = f"sqlite:///{source}"
    with Store.open(url, writer="serve") as store:
        moved = move_store(url, new_database())
        assert any("`calrig serve` (process" in said for said in moved.says)
        run = store.runs.create(unit="A-2", rig="r", plan=None, status="running", provenance={})
        there = new_database()
        with pytest.raises(StoreError, match=rf"`calrig serve` \(process.* carries out run {run.id}: let it"):
            move_store(url, there)
        assert rows_in(there) == {}
    moved = move_store(url, there)
    assert moved.says == (f"1 runs have no end and nobody carries them out ({run.id})",)


def test_a_database_in_which_runs_go_on_is_refused(tmp_path, new_database):
    there = new_database()
    with Store.open(there, writer="serve") as store:
        run = store.runs.create(unit="A", rig="r", plan=None, status="running", provenance={})
        with pytest.raises(StoreError, match=rf"another calrig \(connected.* carries out run {run.id}"):
            move_store(there, f"sqlite:///{tmp_path / 'back.db'}")
    assert move_store(there, f"sqlite:///{tmp_path / 'back.db'}").says


def test_a_source_that_is_older_or_absent_is_said(source, tmp_path, new_database):
    there = new_database()
    with by_hand(source) as file:
        file.execute("UPDATE alembic_version SET version_num = '0006'")
    with pytest.raises(StoreError, match=r"older calrig.*run `calrig serve` once"):
        move_store(f"sqlite:///{source}", there)
    with pytest.raises(StoreError, match="there is no calrig database"):
        move_store(f"sqlite:///{tmp_path / 'absent.db'}", there)
    assert rows_in(there) == {}


def midway(act: Callable[[], None]) -> Callable[[float], None]:
    """Told of the progress, acts once when most rows are laid and none compared."""
    done: list[float] = []

    def told(share: float) -> None:
        if share > 0.2 and not done:
            done.append(share)
            act()

    return told


def test_nobody_is_told_of_what_is_moved_and_everybody_of_what_comes_after(rich, new_database):
    there = new_database()
    with create_engine(there).begin() as connection:
        connection.exec_driver_sql(
            "CREATE FUNCTION tell() RETURNS trigger LANGUAGE plpgsql AS "
            "$$ BEGIN RAISE EXCEPTION 'told of it'; END $$"
        )
        connection.exec_driver_sql(
            "CREATE TRIGGER tell AFTER INSERT ON event FOR EACH ROW EXECUTE FUNCTION tell()"
        )
    move_store(f"sqlite:///{rich}", there)
    with Store.open(there, writer="serve") as store, pytest.raises(StoreError, match="told of it"):
        store.runs.create(unit="new", rig="r", plan=None, status="running", provenance={})


def test_a_target_that_is_lost_midway_has_nothing(rich, new_database):
    there = new_database()
    server = create_engine(there, isolation_level="AUTOCOMMIT")

    def cut() -> None:
        others = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'calrig'"
        with server.connect() as connection:
            assert connection.execute(text(f"{others} AND datname = current_database()")).all()

    with pytest.raises(StoreError, match="cannot be reached") as said:
        move_store(f"sqlite:///{rich}", there, midway(cut))
    assert "postgresql" in str(said.value)
    assert rows_in(there) == {}
    assert hashes(move_store(f"sqlite:///{rich}", there))["run"][0] > 0


@pytest.mark.parametrize("to", ["postgresql", "sqlite"])
def test_a_move_that_is_interrupted_leaves_nothing(rich, tmp_path, new_database, to):
    there = new_database() if to == "postgresql" else f"sqlite:///{tmp_path / 'there.db'}"

    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        move_store(f"sqlite:///{rich}", there, midway(interrupt))
    assert rows_in(there) == {}
    move_store(f"sqlite:///{rich}", there)


def test_the_command_prints_a_table_or_one_document(rich, tmp_path, new_database: MakeDatabase):
    told = CliRunner().invoke(app, ["move-store", str(rich), new_database(), "--json"])
    assert told.exit_code == 0
    document = json.loads(told.stdout)
    assert document.keys() == {"tables", "duration_s"}
    assert {t["name"]: t["rows"] for t in document["tables"]}["issued_calibration"] == 5
    shown = CliRunner().invoke(app, ["move-store", str(rich), str(tmp_path / "copy.db")])
    assert shown.exit_code == 0
    assert all(table["sha256"][:16] in shown.stdout for table in document["tables"])
    again = CliRunner().invoke(app, ["move-store", str(rich), str(tmp_path / "copy.db")])
    assert again.exit_code == 1
    assert again.stderr.count("\n") == 1
    assert "is not empty" in again.stderr
    assert CliRunner().invoke(app, ["move-store", str(rich)]).exit_code == 2


DAMAGE = {
    "a pose": ("UPDATE pose SET reading_deg = reading_deg + 0.001 WHERE pose_index = 3", "pose 3 is not"),
    "a figure": ("UPDATE calibration SET scale = scale * 1.001 WHERE run_id = 4", "'calibration'.*run_id 4"),
    "a document": (
        "UPDATE event SET data = replace(data, '\"index\":7', '\"index\":8') WHERE run_id = 1",
        "'event' with run_id 1, seq 9.*a document is not what was stored",
    ),
    "a revision": (
        "UPDATE issued_calibration SET document = replace(document, 'scale', 'scalf') WHERE unit = 'a-2'",
        "'issued_calibration' with unit 'a-2', revision 1.*not what was issued",
    ),
    "the trail": ("UPDATE trail SET who = 'eve' WHERE seq = 2", "'trail' with seq 2.*trail is broken"),
    "an entry gone": ("DELETE FROM trail WHERE seq = 1", "'trail' with seq 2.*trail is broken"),
    "a pose gone": ("DELETE FROM pose WHERE run_id = 1 AND pose_index = 29", "1 poses of run .* are missing"),
    "an event gone": ("DELETE FROM event WHERE run_id = 1 AND seq = 5", "event 5 of this run is missing"),
    "no number": ("UPDATE pose SET reading_deg = 'warm' WHERE pose_index = 2", "no number in 'reading_deg'"),
    "no text": ("UPDATE run SET note = x'ff00' WHERE id = 2", "with id 2.*no text in 'note'"),
    "no character": (
        r"""UPDATE run SET provenance = '{"cable": "\ud800"}' WHERE id = 2""",
        "'run' with id 2.*surrogates",
    ),
    "not UTF-8": ("UPDATE run SET note = CAST(x'edA080' AS TEXT) WHERE id = 2", "decode to UTF-8.*'note'"),
    "a time": ("UPDATE unit SET created_at = 'noon'", "'unit' with serial 'A-2'.*a time is no time"),
    "no samples": ("UPDATE sample_block SET data = x'' WHERE id = 3", "'sample_block' with id 3.*unpacked"),
    "no transcript": ("UPDATE transcript SET data = x'' WHERE id = 1", "'transcript' with id 1.*unpacked"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_what_is_not_as_it_was_stored_is_named_and_nothing_is_moved(source, new_database, what):
    there = new_database()
    statement, words = DAMAGE[what]
    with by_hand(source) as file:
        assert file.execute(statement).rowcount > 0
    with pytest.raises(StoreDamagedError, match=words) as said:
        move_store(f"sqlite:///{source}", there)
    assert str(source) in str(said.value)
    assert rows_in(there) == {}


def test_a_flipped_byte_of_raw_samples_is_named(source, new_database):
    there = new_database()
    with by_hand(source) as file:
        (packed,) = file.execute("SELECT data FROM sample_block WHERE id = 12").fetchone()
        flipped = bytearray(packed)
        flipped[len(flipped) // 2] ^= 1
        file.execute("UPDATE sample_block SET data = ? WHERE id = 12", (bytes(flipped),))
    with pytest.raises(StoreDamagedError, match=r"'sample_block' with id 12 \(run .*unpacked"):
        move_store(f"sqlite:///{source}", there)
    assert rows_in(there) == {}


NOT_KEPT = {
    "NUL in text": (
        "UPDATE run SET note = 'a' || char(0) || 'b' WHERE id = 2",
        "'note'.*id 2 is text with a NUL",
    ),
    "NaN in a document from before the checksums": (
        """UPDATE run SET provenance = '{"rate_hz": NaN}' WHERE id = 2""",
        "'provenance'.*id 2 is NaN",
    ),
    "a number of 64 bits": (
        "UPDATE run SET follows = 4294967296 WHERE id = 2",
        "'follows'.*id 2 is a number",
    ),
}


@pytest.mark.parametrize("what", NOT_KEPT)
def test_what_postgresql_cannot_keep_is_named_and_nothing_is_moved(source, new_database, what):
    there = new_database()
    statement, words = NOT_KEPT[what]
    with by_hand(source) as file:
        file.execute(statement)
    with pytest.raises(StoreError, match=words):
        move_store(f"sqlite:///{source}", there)
    assert rows_in(there) == {}
