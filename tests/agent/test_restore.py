"""Backup and restore of a centre as the documentation gives them: from one PostgreSQL server to another."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from a_bench import Rig, agent_at
from sqlalchemy import make_url
from support import QUICK, ended, lasting_port, serving, wait_for

from calrig.centre.service import CentreService
from calrig.plan import Plan
from calrig.store import Store

HBA = """\
local   all all                             trust
host    all all           127.0.0.1/32      scram-sha-256
"""


@dataclass(frozen=True)
class Server:
    """A server of Debian's PostgreSQL, and its programs, run as whom it runs as."""

    folder: Path
    port: int
    bin: Path
    account: str | None

    @property
    def url(self) -> str:
        """Of the centre's database, for its owner."""
        return f"postgresql+psycopg://calrig@:{self.port}/calrig?host={self.folder}"

    def run(self, program: str, *arguments: str) -> str:
        """What a program prints that is told where the server is."""
        where = {"PGHOST": str(self.folder), "PGPORT": str(self.port), "PGUSER": "postgres"}
        done = subprocess.run(
            [self.bin / program, *arguments],
            user=self.account,
            check=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=self.folder,
            env={**os.environ, **where},
        )
        return done.stdout


@contextmanager
def server() -> Iterator[Server]:
    """One that is empty."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    if not found:
        pytest.skip("needs Debian's postgresql, with pg_dump")
    account = "postgres" if os.geteuid() == 0 else None  # a server does not run as root
    with tempfile.TemporaryDirectory(prefix="calrig-restore-") as made:
        one = Server(Path(made), lasting_port(), found[-1], account)
        if account is not None:
            shutil.chown(made, account)
        data = one.folder / "data"
        one.run("initdb", "-D", str(data), "-U", "postgres", "--auth=trust", "--no-sync")
        (data / "pg_hba.conf").write_text(HBA)
        listening = f"-h 127.0.0.1 -p {one.port} -k {one.folder} -c fsync=off"
        one.run("pg_ctl", "-w", "-D", str(data), "-l", str(data / "log"), "-o", listening, "start")
        try:
            yield one
        finally:
            one.run("pg_ctl", "-w", "-D", str(data), "-m", "immediate", "stop")


@contextmanager
def centre_at(url: str) -> Iterator[tuple[Store, httpx.Client]]:
    """Its service over HTTP."""
    with (
        Store.open(url, writer="tests") as store,
        closing(CentreService(store, url)) as service,
        serving(service) as client,
    ):
        yield store, client


def known_of(client: httpx.Client, run_id: str) -> list[Any]:
    """What a run came to, with its poses, samples and revision, byte for byte."""
    of_run = f"/api/runs/{run_id}"
    paths = of_run, f"{of_run}/poses", f"{of_run}/samples", "/api/units/AS-1/calibration", "/api/trail"
    return [client.get(path).raise_for_status().content for path in paths]


@pytest.mark.centre
def test_a_restored_centre_has_every_run_and_its_benches_go_on_with_the_password_they_have(
    rig: Rig, spool: Path
) -> None:
    with server() as lost, server() as new:
        lost.run("createuser", "--createrole", "calrig")
        lost.run("createdb", "--owner", "calrig", "calrig")
        with centre_at(lost.url) as (store, client):
            _, code = store.enrolment.add("hall-2")
            bench_url = make_url(store.enrolment.enroll(code, host="127.0.0.1", port=lost.port)[1])
            with agent_at(bench_url.render_as_string(hide_password=False), spool, rig) as agent:
                wait_for(lambda: client.get("/api/rigs").json(), "rig")
                before = client.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).json()["id"]
                ended(client, before)
                wait_for(lambda: agent.service.store.spool.undelivered() == [], "delivery")
                lost.run("pg_dump", "--format", "custom", "--file", "calrig.dump", "calrig")
                lost.run("pg_dumpall", "--roles-only", "--file", "roles.sql")
                known = known_of(client, before)
                since = agent.service.start(unit="AS-2", plan=Plan.model_validate(QUICK)).id
                assert agent.service.wait(since).status == "completed"
        for file in ("roles.sql", "calrig.dump"):
            shutil.copy(lost.folder / file, new.folder / file)
            (new.folder / file).chmod(0o644)
        new.run("psql", "--file", "roles.sql", "postgres")
        new.run("createdb", "--owner", "calrig", "calrig")
        new.run("pg_restore", "--dbname", "calrig", "calrig.dump")
        moved_url = bench_url.set(port=new.port).render_as_string(hide_password=False)
        with centre_at(new.url) as (store, client), agent_at(moved_url, spool, rig):
            assert known_of(client, before) == known
            assert store.trail.broken_link() is None
            after = client.post("/api/runs", json={"unit": "AS-3", "plan": QUICK}).json()["id"]
            assert ended(client, after)["status"] == "completed"
