"""How a bench joins a centre: a code that works once within a day, over HTTP and from a terminal."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from a_centre import Centre, connect, of, turn
from command_line import calrig
from sqlalchemy import make_url
from starlette.exceptions import HTTPException
from support import serving

from calrig.api.access import FORGOTTEN_S, MOST_ALL, MOST_EACH, Access, Attempts
from calrig.runs.service import RunService
from calrig.settings import CentreSettings
from calrig.store import Store
from calrig.store.bench_tables import PROTOCOL
from calrig.store.benches import versions_here
from calrig.store.enrolment import WrongCode
from calrig.store.errors import NotFound, Refused
from calrig.store.postgresql.set_up import agent_url, is_on_this_machine

NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)
TOKEN = "the-benches-of-building-4"


def by(code: str) -> dict[str, object]:
    """What an agent of this version joins by."""
    return {"code": code, **versions_here()}


@pytest.fixture
def name() -> Iterator[str]:
    """Of a bench that nobody has heard of."""
    _NAMES.append(f"bench-{len(_NAMES)}")
    return _NAMES[-1]


_NAMES: list[str] = []


class TestCodes:
    def test_a_code_works_once_and_only_its_hash_is_kept(self, centre: Centre, name: str) -> None:
        awaited, code = centre.store.enrolment.add(name, "hall 2", now=NOW)
        assert (awaited.hall, awaited.code_until) == ("hall 2", NOW + timedelta(days=1))
        with connect(centre.url) as owner:
            kept = owner.execute("SELECT bench::text FROM bench WHERE name = %s", [name]).fetchone()
        assert code not in str(kept)
        joined, url = centre.store.enrolment.enroll(code, now=NOW)
        assert joined == name
        with connect(url) as bench:
            assert bench.execute("SELECT calrig_my_bench()").fetchone() == (name,)
        with pytest.raises(WrongCode, match="was used"):
            centre.store.enrolment.enroll(code, now=NOW)
        (member,) = [one for one in centre.store.enrolment.benches() if one.name == name]
        assert (member.code_until, member.enrolled_at, member.revoked_at) == (None, NOW, None)

    def test_after_a_day_it_works_no_more_and_another_one_does(self, centre: Centre, name: str) -> None:
        _, late = centre.store.enrolment.add(name, now=NOW)
        with pytest.raises(WrongCode, match="older than a day"):
            centre.store.enrolment.enroll(late, now=NOW + timedelta(days=1, seconds=1))
        _, code = centre.store.enrolment.add(name, now=NOW + timedelta(days=2))
        with pytest.raises(WrongCode):
            centre.store.enrolment.enroll(late, now=NOW + timedelta(days=2))
        assert centre.store.enrolment.enroll(code, now=NOW + timedelta(days=3))[0] == name

    def test_who_was_revoked_joins_again_with_another_password(self, centre: Centre, name: str) -> None:
        _, code = centre.store.enrolment.add(name)
        _, before = centre.store.enrolment.enroll(code)
        with pytest.raises(Refused, match=f"joined already: revoke it first .`calrig bench revoke {name}`"):
            centre.store.enrolment.add(name)
        assert centre.store.enrolment.revoke(name).revoked_at is not None
        assert centre.store.enrolment.revoke(name).revoked_at is not None  # told twice, done once
        _, code = centre.store.enrolment.add(name)
        _, after = centre.store.enrolment.enroll(code)
        assert make_url(after).username == make_url(before).username
        assert make_url(after).password != make_url(before).password
        with connect(after) as bench:
            assert bench.execute("SELECT name FROM bench").fetchall() == [(name,)]
        done = [e.what for e in centre.store.trail.entries() if e.detail["bench"] == name]
        assert done == ["bench_added", "bench_enrolled", "bench_revoked", "bench_added", "bench_enrolled"]
        assert centre.store.trail.broken_link() is None

    def test_passwords_are_kept_as_scram_verifiers(self, centre: Centre, postgresql_server: str) -> None:
        role = make_url(centre.join("scram")).username
        with connect(postgresql_server) as admin:
            kept = admin.execute("SELECT rolpassword FROM pg_authid WHERE rolname = %s", [role]).fetchone()
        assert kept is not None
        assert kept[0].startswith("SCRAM-SHA-256$")

    def test_another_version_and_a_rig_that_another_bench_has_are_refused_and_spend_no_code(
        self, centre: Centre, name: str
    ) -> None:
        rig = f"rig-of-{name}"
        with connect(centre.join(f"{name}-a")) as other:
            said = {"rigs": [{"name": rig}], **versions_here()}
            other.execute("UPDATE bench SET said = %s", [json.dumps(said)])
        _, code = centre.store.enrolment.add(name)
        for joins, why in (
            ({"protocol": PROTOCOL - 1}, "too old .* upgrade the bench first"),
            ({"protocol": PROTOCOL + 1}, "too new .* upgrade the centre first"),
            ({"schema_revision": "0017"}, rf"too old .* \(protocol {PROTOCOL}, schema 0017 instead of"),
            ({"schema_revision": "9999"}, "too new .* upgrade the centre first"),
            ({"rigs": ["r", rig]}, f"bench {name}-a has a rig '{rig}' already"),
        ):
            with pytest.raises(Refused, match=why):
                centre.store.enrolment.enroll(code, **joins)
        assert centre.store.enrolment.enroll(code, rigs=["r"])[0] == name

    def test_a_bench_that_is_not_there_or_cannot_be_is_said_to_be(self, centre: Centre) -> None:
        with pytest.raises(NotFound, match="there is no bench 'x'"):
            centre.store.enrolment.revoke("x")
        for wrong in ("", "hall 2", "a/b", "b" * 21):
            with pytest.raises(Refused, match="a bench's name has 1 to 20"):
                centre.store.enrolment.add(wrong)

    def test_where_the_centre_may_make_no_roles_it_is_told_how_it_may(
        self, postgresql_server: str, owned_template: tuple[str, str]
    ) -> None:
        plain = f"calrig_plain_{uuid.uuid4().hex[:8]}"  # as `createuser` and `createdb -O` make them
        url = of(postgresql_server, database=plain, username=plain)
        with connect(postgresql_server) as server:
            with turn(server):
                server.execute(f"CREATE ROLE {plain} LOGIN")
                server.execute(f"CREATE DATABASE {plain} OWNER {plain}")
            with (
                Store.open(url, writer="tests") as store,
                pytest.raises(Refused, match="GRANT calrig_bench TO … WITH ADMIN OPTION"),
            ):
                store.enrolment.add("b")
            with turn(server):
                server.execute(f"DROP DATABASE {plain} WITH (FORCE)")
                server.execute(f"DROP ROLE {plain}")

    def test_a_file_has_no_benches(self, tmp_path: Path) -> None:
        with Store.open(f"sqlite:///{tmp_path}/calrig.db", writer="tests") as store:
            with pytest.raises(Refused, match="benches join a centre, whose store is in PostgreSQL"):
                store.enrolment.add("b")
            assert store.enrolment.benches() == []


@pytest.mark.parametrize(
    ("centre", "host", "port", "expected"),
    [
        ("postgresql://owner:pw@db.lab:5433/c", None, None, "db.lab:5433/c?sslmode=verify-full"),
        ("postgresql://owner@db.lab/c?sslmode=require&sslkey=k", None, None, "db.lab/c?sslmode=verify-full"),
        ("postgresql:///c?host=/run/pg", "db.lab", 5433, "db.lab:5433/c?sslmode=verify-full"),
        ("postgresql:///c?host=/run/pg", None, None, "/c?host=%2Frun%2Fpg"),
        ("postgresql://owner@127.0.0.1/c", None, None, "127.0.0.1/c"),
        ("postgresql://owner@[::1]:5433/c", None, None, "[::1]:5433/c"),
    ],
)
def test_across_a_network_the_server_has_to_prove_who_it_is(
    centre: str, host: str | None, port: int | None, expected: str
) -> None:
    url = agent_url(make_url(centre), "calrig_b", "secret", host, port)
    shown = url.render_as_string(hide_password=False)
    assert shown == f"postgresql+psycopg://calrig_b:secret@{expected}"
    assert is_on_this_machine(url) is ("sslmode" not in shown)


class TestAttempts:
    """In a time that is given."""

    @pytest.fixture
    def time_s(self) -> SimpleNamespace:
        return SimpleNamespace(now=0.0)

    @pytest.fixture
    def attempt(self, time_s: SimpleNamespace) -> Callable[[str], tuple[Attempts, Any]]:
        attempts = Attempts(lambda: time_s.now)

        def begin(address: str) -> tuple[Attempts, Any]:
            return attempts, attempts.begin(SimpleNamespace(client=SimpleNamespace(host=address)))

        return begin

    def test_an_address_has_a_few_a_minute(self, attempt: Any, time_s: SimpleNamespace) -> None:
        for last in range(MOST_EACH):
            attempt(f"2001:db8::{last}")  # 64 bits are one client's
        with pytest.raises(HTTPException, match="too many wrong codes from 2001:db8::9"):
            attempt("2001:db8::9")
        attempt("2001:db8:0:1::9")
        time_s.now = FORGOTTEN_S
        attempt("2001:db8::9")

    def test_all_addresses_together_have_not_many_more(self, attempt: Any) -> None:
        for n in range(MOST_ALL):
            attempt(f"10.0.{n}.1")
        with pytest.raises(HTTPException):
            attempt("10.1.0.1")

    def test_right_ones_are_not_counted(self, attempt: Any) -> None:
        for _ in range(2 * MOST_EACH):
            attempts, begun = attempt("10.0.0.1")
            attempts.right(begun)


@pytest.fixture
def client(centre: Centre) -> Iterator[httpx.Client]:
    """Of the centre's service, without a token."""
    with (
        closing(RunService(centre.store, ())) as service,
        serving(service, access=Access(TOKEN, patience_s=0.05)) as client,
    ):
        yield client


ADMIN = {"Authorization": f"Bearer {TOKEN}"}


class TestOverHttp:
    def test_an_admin_makes_a_code_and_the_agent_needs_nothing_else(
        self, centre: Centre, client: httpx.Client, name: str
    ) -> None:
        assert client.post("/api/benches", json={"name": name}).status_code == 401
        added = client.post("/api/benches", json={"name": name, "hall": "2"}, headers=ADMIN)
        assert added.status_code == 201
        joined = client.post("/api/benches/enroll", json=by(added.json()["code"])).raise_for_status()
        assert joined.json()["bench"] == name
        with connect(joined.json()["db"]) as bench:
            assert bench.execute("SELECT name, hall FROM bench").fetchall() == [(name, "2")]
        listed = client.get("/api/benches", headers=ADMIN).json()
        assert [one["hall"] for one in listed if one["name"] == name] == ["2"]
        assert not re.search('sha256|password|code"', json.dumps(listed))
        gone = client.delete(f"/api/benches/{name}", headers=ADMIN).raise_for_status().json()
        assert gone["revoked_at"] is not None
        assert client.delete("/api/benches/unheard-of", headers=ADMIN).status_code == 404

    def test_wrong_codes_are_refused_and_soon_not_even_looked_at(
        self, client: httpx.Client, name: str
    ) -> None:
        code = client.post("/api/benches", json={"name": name}, headers=ADMIN).json()["code"]
        for _ in range(MOST_EACH):
            answer = client.post("/api/benches/enroll", json={"code": "guessed"})
            assert (answer.status_code, "by this code" in answer.json()["detail"]) == (403, True)
        answer = client.post("/api/benches/enroll", json=by(code))
        assert (answer.status_code, answer.headers["Retry-After"]) == (429, "60")

    def test_a_code_is_not_spent_on_an_agent_that_could_not_reach_the_database(
        self, centre: Centre, name: str
    ) -> None:
        _, code = centre.store.enrolment.add(name)
        with (
            closing(RunService(centre.store, ())) as service,
            serving(service) as client,
        ):
            elsewhere = {"X-Forwarded-For": "192.0.2.7"}
            answer = client.post("/api/benches/enroll", json=by(code), headers=elsewhere)
            assert (answer.status_code, "agent_db_host" in answer.json()["detail"]) == (409, True)
        reached = CentreSettings(agent_db_host="db.lab.example", agent_db_port=5433)
        with (
            closing(RunService(centre.store, ())) as service,
            serving(service, centre=reached) as client,
        ):
            answer = client.post("/api/benches/enroll", json=by(code), headers=elsewhere)
            url = make_url(answer.raise_for_status().json()["db"])
            assert (url.host, url.port, dict(url.query)) == (
                "db.lab.example",
                5433,
                {"sslmode": "verify-full"},
            )


class TestFromATerminal:
    def test_a_bench_joins_and_its_url_is_for_its_owner_alone(
        self, centre: Centre, client: httpx.Client, name: str, tmp_path: Path
    ) -> None:
        code = calrig("bench", "add", name, "--hall", "3", "--db", centre.url).stdout.strip()
        assert f"{name}" in calrig("bench", "list", "--db", centre.url).stdout
        kept = tmp_path / "new folder" / "centre.url"
        said = calrig("agent", "enroll", "--centre", client.base_url, "--code", code, "--out", kept)
        assert f"this is bench {name} now" in said.stdout
        assert oct(kept.stat().st_mode & 0o777) == "0o600"
        with connect(kept.read_text().strip()) as bench:
            assert bench.execute("SELECT name, hall FROM bench").fetchall() == [(name, "3")]
        assert make_url(kept.read_text()).password not in said.output
        calrig("bench", "revoke", name, "--db", centre.url)
        listed = json.loads(calrig("bench", "list", "--json", "--db", centre.url).stdout)
        assert [one["revoked_at"] is None for one in listed if one["name"] == name] == [False]

    def test_an_admin_elsewhere_asks_the_service(
        self, client: httpx.Client, name: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("CALRIG_TOKEN", TOKEN)
        assert calrig("bench", "add", name, "--server", client.base_url).stdout.strip()
        calrig("bench", "revoke", name, "--server", client.base_url)
        listed = json.loads(calrig("bench", "list", "--json", "--server", client.base_url).stdout)
        assert name in [one["name"] for one in listed]

    def test_a_wrong_code_leaves_the_file_before_as_it_was(
        self, client: httpx.Client, tmp_path: Path
    ) -> None:
        kept = tmp_path / "centre.url"
        kept.write_text("postgresql+psycopg://of-another-centre\n")
        said = calrig("agent", "enroll", "--centre", client.base_url, "--code", "x", "--out", kept, status=1)
        assert "no bench may join by this code" in said.stderr
        assert [file.name for file in tmp_path.iterdir()] == ["centre.url"]
        assert kept.read_text() == "postgresql+psycopg://of-another-centre\n"

    def test_a_file_is_no_centre_and_none_is_made(self, tmp_path: Path) -> None:
        said = calrig("bench", "add", "b", "--db", tmp_path / "calrig.db", status=2)
        assert "benches join a centre, whose store is in PostgreSQL" in said.stderr
        assert list(tmp_path.iterdir()) == []

    def test_no_code_goes_over_a_network_in_plain_text(self, tmp_path: Path) -> None:
        said = calrig("agent", "enroll", "--centre", "http://centre.lab:8000", "--code", "x", status=2)
        assert "code and password could be read on the way: name it by https://" in said.stderr
        said = calrig(
            "agent", "enroll", "--centre", "https://centre.lab", "--code", "x", "--ca", tmp_path / "no.pem",
            status=2,
        )  # fmt: skip
        assert "no.pem: No such file" in said.stderr
