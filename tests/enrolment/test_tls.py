"""A bench comes in by TLS and its password, and only to the server whose name the certificate proves."""

from __future__ import annotations

import os
import shutil
import socket
import ssl
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from socketserver import BaseRequestHandler, ThreadingTCPServer

import httpx
import psycopg
import pytest
from a_centre import Centre, connect, of
from sqlalchemy import make_url
from support import at_work, lasting_port, serving
from typer.testing import CliRunner, Result

from calrig.cli.benches import checked_by
from calrig.cli.main import app
from calrig.runs.service import RunService
from calrig.store import Store

HBA = """\
local   all all                             trust
hostssl all all           127.0.0.1/32      scram-sha-256
host    all all           all               reject
"""
"""Who is let in how: across a network nobody without TLS and a password."""


def certify(folder: Path) -> Path:
    """Makes an authority, and of it a certificate for `localhost`; returns the authority's own."""

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    openssl("req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2", "-subj", "/CN=lab CA")
    openssl("req", *key, "-keyout", "server.key", "-out", "server.csr", "-subj", "/CN=localhost")
    (folder / "names").write_text("subjectAltName=DNS:localhost\n")
    signed = ("-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-extfile", "names")
    openssl("x509", "-req", "-in", "server.csr", "-out", "server.pem", *signed)
    return folder / "ca.pem"


@pytest.fixture(scope="module")
def tls_server() -> Iterator[tuple[str, int, Path]]:
    """A server of its own that listens on a port with TLS: the superuser's URL, the port, the authority.

    The server of the wheel knows no TLS: this one is Debian's.
    """
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    if not found or shutil.which("openssl") is None:
        pytest.skip("needs Debian's postgresql and openssl")
    account = "postgres" if os.geteuid() == 0 else None  # a server does not run as root

    def run(program: str, *arguments: str) -> None:
        subprocess.run([found[-1] / program, *arguments], user=account, check=True, capture_output=True)

    with tempfile.TemporaryDirectory(prefix="calrig-tls-") as made:
        folder, data = Path(made), Path(made) / "data"
        if account is not None:
            shutil.chown(folder, account)
        run("initdb", "-D", str(data), "-U", "postgres", "--auth=trust", "--no-sync")
        ca = certify(folder)
        for name in ("server.pem", "server.key"):
            shutil.copy(folder / name, data / name)
            (data / name).chmod(0o600)
            shutil.chown(data / name, account or os.geteuid())
        (data / "pg_hba.conf").write_text(HBA)
        port = lasting_port()
        tls = "-c ssl=on -c ssl_cert_file=server.pem -c ssl_key_file=server.key"
        listening = f"-h 127.0.0.1 -p {port} -k {folder} -c fsync=off {tls}"
        run("pg_ctl", "-w", "-D", str(data), "-l", str(data / "log"), "-o", listening, "start")
        try:
            yield f"postgresql+psycopg://postgres@:{port}/postgres?host={folder}", port, ca
        finally:
            run("pg_ctl", "-w", "-D", str(data), "-m", "immediate", "stop")


@pytest.fixture(scope="module")
def joined(tls_server: tuple[str, int, Path]) -> str:
    """The URL that a bench has got, of a centre that is reached as `db.lab.example`."""
    admin, port, ca = tls_server
    with connect(admin) as server:
        server.execute("CREATE DATABASE centre")
    url = of(admin, database="centre")
    with Store.open(url, writer="tests") as store:
        _, code = store.enrolment.add("b")
        _, told = store.enrolment.enroll(code, host="db.lab.example", port=port)
    return checked_by(told, ca)


def reached_at(told: str, name: str, **query: str) -> str:
    """The bench's URL where the server's name leads to this machine."""
    url = make_url(told)
    return url.set(host=name).update_query_dict(query).render_as_string(hide_password=False)


@contextmanager
def tls_in_front(client: httpx.Client, folder: Path) -> Iterator[str]:
    """A proxy that ends TLS before the service, as a centre has one; its address."""
    certificate = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    certificate.load_cert_chain(folder / "server.pem", folder / "server.key")

    class Relay(BaseRequestHandler):
        def handle(self) -> None:
            with (
                suppress(OSError),  # who does not believe the certificate hangs up
                certificate.wrap_socket(self.request, server_side=True) as outside,
                socket.create_connection((client.base_url.host, client.base_url.port)) as inside,
            ):
                back = threading.Thread(target=copy, args=(inside, outside), daemon=True)
                back.start()
                copy(outside, inside)
                back.join()

    def copy(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while piece := source.recv(65536):
                sink.sendall(piece)
            sink.shutdown(socket.SHUT_WR)

    relay = ThreadingTCPServer(("127.0.0.1", 0), Relay)
    relay.daemon_threads = True  # they go with their connections, which a test that fails may leave open
    with at_work(relay):
        yield f"https://localhost:{relay.server_address[1]}"


def test_the_code_goes_by_tls_to_who_proves_to_be_the_centre(centre: Centre, tmp_path: Path) -> None:
    for folder in ("lab", "another"):
        (tmp_path / folder).mkdir()
        certify(tmp_path / folder)
    _, code = centre.store.enrolment.add("by-tls")
    kept = tmp_path / "centre.url"
    with (
        closing(RunService(centre.store, ())) as service,
        serving(service) as client,
        tls_in_front(client, tmp_path / "lab") as address,
    ):

        def enroll(authority: str) -> Result:
            ca = tmp_path / authority / "ca.pem"
            asked = ["agent", "enroll", "--centre", address, "--code", code, "--ca", ca, "--out", kept]
            return CliRunner().invoke(app, [str(one) for one in asked])

        refused = enroll("another")
        assert (refused.exit_code, "its certificate is not believed" in refused.stderr) == (1, True)
        assert "--ca" in refused.stderr
        assert not kept.exists()
        assert enroll("lab").exit_code == 0
    with connect(kept.read_text().strip()) as bench:
        assert bench.execute("SELECT calrig_my_bench()").fetchone() == ("by-tls",)


def test_the_right_name_is_let_in_by_tls(joined: str) -> None:
    with connect(reached_at(joined, "localhost")) as bench:
        assert bench.execute("SELECT calrig_my_bench()").fetchone() == ("b",)
        secured = "SELECT ssl FROM pg_stat_ssl WHERE pid = pg_backend_pid()"
        assert bench.execute(secured).fetchone() == (True,)


def test_another_name_is_not_believed(joined: str) -> None:
    with pytest.raises(psycopg.OperationalError, match="does not match host name"):
        connect(reached_at(joined, "127.0.0.1"))
    with pytest.raises(psycopg.OperationalError, match="does not match host name"):
        connect(reached_at(joined, "db.lab.example", hostaddr="127.0.0.1"))


def test_another_authority_is_not_believed(joined: str, tmp_path: Path) -> None:
    other = certify(tmp_path)
    with pytest.raises(psycopg.OperationalError, match="certificate verify failed"):
        connect(reached_at(joined, "localhost", sslrootcert=str(other)))


def test_a_wrong_password_opens_nothing(joined: str) -> None:
    wrong = make_url(reached_at(joined, "localhost")).set(password="guessed")
    with pytest.raises(psycopg.OperationalError, match="password authentication failed"):
        connect(wrong.render_as_string(hide_password=False))


def test_nobody_comes_in_without_tls(joined: str) -> None:
    with pytest.raises(psycopg.OperationalError, match="no encryption"):
        connect(reached_at(joined, "localhost", sslmode="disable"))
