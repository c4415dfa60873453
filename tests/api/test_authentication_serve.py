"""`calrig serve` opens itself to others only with a token, and says so."""

from __future__ import annotations

import re
import socket
import subprocess
import sys

import httpx
import pytest

from calrig.api.access import AccessError, access_here
from calrig.settings import Settings

TOKEN = "the-benches-of-building-4"
RIG = """
[[rig]]
name = "bench-1"
stage = {driver = "smc100", port = "/dev/there-is-none"}
imu = {driver = "calrig", port = "/dev/there-is-none-either"}
"""
CALRIG = (sys.executable, "-m", "calrig")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the command is run: a configuration, a store, and no token."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALRIG_DB", str(tmp_path / "calrig.db"))
    monkeypatch.delenv("CALRIG_TOKEN", raising=False)
    (tmp_path / "calrig.toml").write_text(RIG)
    return tmp_path


@pytest.fixture
def serve(folder):
    """Starts the service; returns its first line and a client by way of loopback."""
    processes = []

    def serve(*arguments):
        process = subprocess.Popen(
            [*CALRIG, "serve", "--port", "0", *arguments], stdout=subprocess.PIPE, text=True
        )
        processes.append(process)
        line = process.stdout.readline()
        port = re.search(r":(\d+), store", line)[1]
        return line, f"http://127.0.0.1:{port}"

    yield serve
    for process in processes:
        process.terminate()
        process.wait(60)
        process.stdout.close()


def test_without_a_token_others_are_not_let_in_and_the_command_says_how_to_make_one(folder):
    command = [*CALRIG, "serve", "--port", "0", "--host", "0.0.0.0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert "set CALRIG_TOKEN" in line
    assert "token_urlsafe" in line
    assert not (folder / "calrig.db").exists()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5"])
def test_an_address_that_others_reach_needs_a_token(folder, host):
    with pytest.raises(AccessError, match="CALRIG_TOKEN"):
        access_here(host, host, Settings())


@pytest.mark.parametrize(
    ("token", "host"), [("", "127.0.0.1"), ("short", "0.0.0.0"), ("x" * 15 + " x", "::1")]
)
def test_a_token_that_could_be_guessed_or_typed_wrong_is_refused_everywhere(folder, monkeypatch, token, host):
    monkeypatch.setenv("CALRIG_TOKEN", token)
    with pytest.raises(AccessError, match="16 ASCII characters"):
        access_here(host, host, Settings())


def test_names_for_people_elsewhere_need_a_token_too(folder):
    with pytest.raises(AccessError, match="`hosts`"):
        access_here("127.0.0.1", "127.0.0.1", Settings(hosts=("calrig.lab.example",)))


def test_on_all_addresses_it_says_that_it_asks_for_the_token_and_is_reached_by_each_of_them(
    serve, monkeypatch
):
    monkeypatch.setenv("CALRIG_TOKEN", TOKEN)
    line, url = serve("--host", "0.0.0.0")
    assert "asks for the token of CALRIG_TOKEN" in line
    assert TOKEN not in line
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    assert httpx.get(f"{url}/api/rigs").status_code == 401
    names = ["127.0.0.1:1", "localhost", "0.0.0.0", socket.gethostname(), f"{socket.gethostname()}.local"]
    for name in names:
        assert httpx.get(f"{url}/api/rigs", headers={**bearer, "Host": name}).status_code == 200, name
    elsewhere = httpx.get(f"{url}/api/rigs", headers={**bearer, "Host": "evil.example"})
    assert elsewhere.status_code == 403


def test_on_loopback_a_token_that_is_set_is_asked_for_and_the_name_of_a_proxy_is_known(
    serve, folder, monkeypatch
):
    monkeypatch.setenv("CALRIG_TOKEN", TOKEN)
    (folder / "calrig.toml").write_text('hosts = ["calrig.lab.example"]\n' + RIG)
    line, url = serve()
    assert "asks for the token of CALRIG_TOKEN" in line
    assert httpx.get(f"{url}/api/runs").status_code == 401
    by_proxy = {
        "Authorization": f"Bearer {TOKEN}",
        "Host": "calrig.lab.example",
        "Origin": "https://calrig.lab.example",
        "X-Forwarded-Proto": "https",
    }
    assert httpx.post(f"{url}/api/logout", headers=by_proxy).status_code == 200
