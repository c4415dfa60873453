"""What a bench's role may do in the centre's database: with its own rows, little; with all else, nothing.

Every connection here is a bench's own, on a real server; the centre's role is no superuser either.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import psycopg
import pytest
from a_centre import Centre, connect, prepare
from psycopg.errors import InsufficientPrivilege
from sqlalchemy import make_url
from support import wait_for

from calrig.store.bench_tables import PROTOCOL
from calrig.store.benches import versions_here

NOW = "2026-11-22T12:00:00.000000"
FILLING = f"""
    INSERT INTO run_order (run_uid, bench, rig, epoch, wish, document, taken_epoch, ordered_at)
        SELECT 'run-of-' || name, name, 'r1', 3, 'begin', '{{}}', 0, '{NOW}' FROM bench;
    INSERT INTO bench_command (bench, kind, rig, asked_at) SELECT name, 'stop', 'r1', '{NOW}' FROM bench;
    INSERT INTO parcel (bench, seq, run_uid, document, delivered_at)
        SELECT name, 1, 'run-of-' || name, '{{}}', '{NOW}' FROM bench;
"""
"""An order, a command and a parcel of each bench."""
EMPTYING = "TRUNCATE run_order, bench_command, parcel CASCADE"


@pytest.fixture
def urls(centre: Centre) -> Iterator[dict[str, str]]:
    """Of the benches `a` and `ab`, whose names begin alike; all is there once for each."""
    urls = {name: centre.join(name) for name in ("a", "ab")}
    with connect(centre.url) as owner:
        owner.execute(FILLING)
    yield urls
    for name in urls:
        centre.store.enrolment.revoke(name)
    with connect(centre.url) as owner:
        owner.execute(EMPTYING)


@pytest.fixture
def bench(urls: dict[str, str]) -> Iterator[psycopg.Connection]:
    """The connection of bench `a`."""
    with connect(urls["a"]) as connection:
        yield connection


def test_a_bench_sees_its_own_rows_alone(bench: psycopg.Connection) -> None:
    def seen(query: str) -> list[tuple[object, ...]]:
        return bench.execute(query).fetchall()

    assert seen("SELECT calrig_my_bench()") == [("a",)]
    assert seen("SELECT name FROM bench") == [("a",)]
    assert seen("SELECT run_uid FROM run_order") == [("run-of-a",)]
    assert seen("SELECT bench FROM bench_command") == [("a",)]
    assert seen("SELECT bench, seq FROM parcel") == [("a", 1)]


@pytest.mark.parametrize(
    "query",
    [
        f"UPDATE bench SET last_seen_at = '{NOW}', said = '{{}}'",
        "UPDATE run_order SET taken_epoch = 3, held_epoch = 2",
        f"UPDATE bench_command SET taken_at = '{NOW}', answered_at = '{NOW}', answer = '{{}}'",
    ],
)
def test_what_a_bench_changes_is_its_own(bench: psycopg.Connection, query: str) -> None:
    assert bench.execute(query).rowcount == 1


def test_a_bench_delivers_parcels_of_its_own_each_once(bench: psycopg.Connection) -> None:
    deliver = (
        "INSERT INTO parcel (bench, seq, run_uid, document, data, delivered_at) "
        f"VALUES (%s, 2, 'run-of-a', '{{}}', NULL, '{NOW}') ON CONFLICT (bench, seq) DO NOTHING"
    )
    assert bench.execute(deliver + " RETURNING id", ["a"]).fetchone() is not None
    assert bench.execute(deliver, ["a"]).rowcount == 0
    with pytest.raises(InsufficientPrivilege, match="row-level security"):
        bench.execute(deliver, ["ab"])


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * FROM run",
        "SELECT * FROM pose",
        "SELECT * FROM event",
        "SELECT * FROM unit",
        'SELECT * FROM "user"',
        "SELECT * FROM trail",
        "SELECT * FROM calibration",
        "SELECT * FROM alembic_version",
        "SELECT document FROM parcel",
        "UPDATE bench SET name = 'b'",
        "UPDATE bench SET role = session_user",
        "UPDATE bench SET revoked_at = NULL",
        "UPDATE bench SET refused = NULL",
        "UPDATE bench SET bears = NULL",
        "UPDATE bench SET code_sha256 = 'x', code_until = 'x'",
        "UPDATE bench SET hall = 'x'",
        "UPDATE run_order SET epoch = 9",
        "UPDATE run_order SET wish = 'begin'",
        "UPDATE run_order SET document = '{}'",
        "UPDATE bench_command SET withdrawn_at = NULL",
        "UPDATE parcel SET document = '{}'",
        "INSERT INTO bench (name, said) VALUES ('c', '{}')",
        f"INSERT INTO run_order VALUES ('u', 'a', 'r1', 1, 'begin', '{{}}', 0, '{NOW}')",
        f"INSERT INTO bench_command (bench, kind, asked_at) VALUES ('a', 'stop', '{NOW}')",
        "DELETE FROM run_order",
        "DELETE FROM parcel",
        "TRUNCATE parcel",
        "ALTER TABLE bench DISABLE ROW LEVEL SECURITY",
        "DROP POLICY calrig_own ON bench",
        "CREATE TABLE mine ()",
        "CREATE TEMPORARY TABLE mine ()",
        "CREATE ROLE another",
        "SELECT nextval('bench_command_id_seq')",
    ],
)
def test_all_else_is_refused(bench: psycopg.Connection, query: str) -> None:
    with pytest.raises(InsufficientPrivilege):
        bench.execute(query)


def report(bench: psycopg.Connection, *rigs: object, **more: object) -> str | None:
    """A bench says which rigs it has; why it takes no orders, as the database judges it."""
    said = {"rigs": [{"name": rig} for rig in rigs], **versions_here(), **more}
    answer = bench.execute("UPDATE bench SET said = %s RETURNING refused", [json.dumps(said)]).fetchone()
    assert answer is not None
    return answer[0]


TAKING = "UPDATE run_order SET taken_epoch = 3"


def test_the_second_bench_with_a_rig_of_one_name_takes_no_orders_and_does_the_rest(
    centre: Centre, urls: dict[str, str], bench: psycopg.Connection
) -> None:
    with connect(urls["ab"]) as second:
        assert report(bench, "r1", "r2") is None
        assert "bench a has a rig 'r1' already" in (report(second, "r0", "r1") or "")
        assert report(bench, "r1", "r2") is None  # the first one stays it
        assert second.execute(TAKING).rowcount == 0
        assert bench.execute(TAKING).rowcount == 1
        assert second.execute(f"UPDATE bench_command SET taken_at = '{NOW}'").rowcount == 1
        second.execute(
            "INSERT INTO parcel (bench, seq, run_uid, document, delivered_at) "
            f"VALUES ('ab', 2, 'run-of-ab', '{{}}', '{NOW}')"
        )
        assert (report(second, "r0"), second.execute(TAKING).rowcount) == (None, 1)
        assert "bench ab has a rig 'r0'" in (report(bench, "r1", "r0") or "")  # which came to it later
        centre.store.enrolment.revoke("ab")
        assert report(bench, "r1", "r0") is None


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"protocol": None}, "too old"),
        ({"protocol": "x"}, "too old"),
        ({"protocol": PROTOCOL - 1}, "too old"),
        ({"protocol": PROTOCOL + 1}, "too new"),
        ({"schema_revision": None}, "too old"),
        ({"schema_revision": {"9999": "9999"}}, "too old"),
        ({"schema_revision": "0017"}, f"too old for the centre (protocol {PROTOCOL}, schema 0017 instead of"),
        ({"schema_revision": "9999"}, f"too new for the centre (protocol {PROTOCOL}, schema 9999 instead of"),
        ({"protocol": PROTOCOL + 1, "schema_revision": "0017"}, "too new"),
    ],
)
def test_a_bench_of_another_version_takes_no_orders(
    centre: Centre, bench: psycopg.Connection, told: dict[str, object], why: str
) -> None:
    assert why in (report(bench, "r1", **told) or "")
    assert bench.execute(TAKING).rowcount == 0
    (told,) = [one.refused for one in centre.store.enrolment.benches() if one.name == "a"]
    assert why in (told or "")


def test_an_upgrade_of_the_centre_refuses_what_became_too_old_before_it_reports_again(
    centre: Centre, bench: psycopg.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = {"rigs": [{"name": "r1"}], **versions_here()}
    row = "UPDATE bench SET said = %s, last_seen_at = %s RETURNING refused"
    assert bench.execute(row, [json.dumps(said), NOW]).fetchone() == (None,)
    with monkeypatch.context() as upgraded:
        upgraded.setattr("calrig.store.postgresql.set_up.revisions", lambda: ["9999"])
        prepare(centre.url)
        (told,) = bench.execute("SELECT refused FROM bench").fetchone() or ("",)
        assert "too old for the centre" in (told or "")
        assert bench.execute(TAKING).rowcount == 0
    prepare(centre.url)
    assert bench.execute(TAKING).rowcount == 1


@pytest.mark.parametrize("rigs", [None, 17, "r1", [17, None, {"name": {"name": "r1"}}], {"name": ["r1"]}])
def test_what_a_bench_reports_in_another_form_spoils_no_other_benchs_report(
    urls: dict[str, str], bench: psycopg.Connection, rigs: object
) -> None:
    with connect(urls["ab"]) as other:
        report(other, rigs=rigs)
        assert report(bench, "r2") is None


def test_as_the_group_a_bench_is_still_itself(bench: psycopg.Connection) -> None:
    bench.execute("SET ROLE calrig_bench")
    assert bench.execute("SELECT name FROM bench").fetchall() == [("a",)]
    with pytest.raises(InsufficientPrivilege):
        bench.execute("SET SESSION AUTHORIZATION postgres")


def test_a_bench_of_one_centre_is_nobody_in_anothers_database(
    centre: Centre, urls: dict[str, str], new_database: object
) -> None:
    other = new_database()
    prepare(other)
    elsewhere = make_url(urls["a"]).set(database=make_url(other).database)
    with pytest.raises(psycopg.OperationalError, match="permission denied for database"):
        connect(elsewhere.render_as_string(hide_password=False))


def test_a_revoked_bench_is_cut_off_and_comes_in_no_more(
    centre: Centre, urls: dict[str, str], bench: psycopg.Connection
) -> None:
    bench.execute(
        "SELECT pg_advisory_lock(x'63616C726967'::bigint)"
    )  # the turn of whoever writes: it is freed
    centre.store.enrolment.revoke("a")
    with pytest.raises(psycopg.OperationalError):
        bench.execute("SELECT 1")
    with pytest.raises(psycopg.OperationalError, match="not permitted to log in"):
        connect(urls["a"])
    with connect(urls["ab"]) as other:
        assert other.execute("SELECT name FROM bench").fetchall() == [("ab",)]
    with connect(centre.url) as owner:
        kept = owner.execute("SELECT count(*) FROM run_order WHERE bench = 'a'").fetchone()
    assert kept == (1,)


def test_what_a_revoked_bench_still_has_open_shows_it_nothing(
    centre: Centre, bench: psycopg.Connection
) -> None:
    with connect(centre.url) as owner:
        owner.execute(f"UPDATE bench SET revoked_at = '{NOW}' WHERE name = 'a'")
    for table in ("bench", "run_order"):
        assert bench.execute(f"SELECT count(*) FROM {table}").fetchone() == (0,)


def test_rights_that_are_laid_are_not_laid_again(centre: Centre, urls: dict[str, str]) -> None:
    with connect(centre.url) as owner:
        policies = "SELECT oid FROM pg_policy ORDER BY oid"
        before = owner.execute(policies).fetchall()
        prepare(centre.url)
        assert owner.execute(policies).fetchall() == before


def test_a_database_is_brought_up_to_date_while_a_bench_is_at_work_in_it(
    centre: Centre, urls: dict[str, str]
) -> None:
    waits = "SELECT count(*) FROM pg_locks WHERE NOT granted AND locktype = 'relation'"
    with connect(centre.url) as owner, connect(urls["a"]) as bench, ThreadPoolExecutor(1) as beside:
        owner.execute("DROP FUNCTION calrig_tell_order_v1 CASCADE")
        with bench.transaction():
            bench.execute("SELECT 1 FROM run_order")
            upgrade = beside.submit(prepare, centre.url)
            wait_for(lambda: owner.execute(waits).fetchone() != (0,), "upgrade that waits for the bench")
            assert bench.execute("SELECT name FROM bench").fetchall() == [("a",)]
        upgrade.result()
        assert report(bench, "r1") is None


@pytest.mark.parametrize(
    "lost",
    [
        "REVOKE ALL ON ALL TABLES IN SCHEMA public FROM calrig_bench",  # `pg_restore --no-acl`
        "REVOKE CONNECT ON DATABASE {database} FROM {role}; GRANT CONNECT ON DATABASE {database} TO PUBLIC",
    ],
    ids=["of the tables", "of the database"],
)
def test_rights_that_a_restored_dump_does_not_bring_are_laid_anew(
    centre: Centre, urls: dict[str, str], lost: str
) -> None:
    url = make_url(urls["a"])
    with connect(centre.url) as owner:
        owner.execute(lost.format(database=url.database, role=f'"{url.username}"'))
    prepare(centre.url)
    with connect(urls["a"]) as bench:
        assert bench.execute("SELECT name FROM bench").fetchall() == [("a",)]
    with connect(centre.url) as owner:
        query = "SELECT has_database_privilege('public', current_database(), 'CONNECT')"
        assert owner.execute(query).fetchone() == (False,)
