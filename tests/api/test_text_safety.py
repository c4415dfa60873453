"""Texts from outside are shown as text wherever they end up, and reach neither SQL nor paths."""

from __future__ import annotations

import re
import subprocess
import sys
from http.client import HTTPConnection
from types import SimpleNamespace
from urllib.parse import quote

import pytest

from calrig.cli import terminal
from calrig.errors import printable
from calrig.instruments.transcript import read_transcript, taped

POSES = "target_deg,reading_deg,+5V\n-30,-29.5,5.01\n0,-0.4,4.99\n30,30.6,5.00\n"
NASTY = (
    "..", "../../../../etc/passwd", "%2e%2e%2f%2e%2e%2fetc%2fpasswd", "/etc/passwd", "\x00", "1\x00",
    "a\x00.csv",
    "' OR '1'='1",
    '"; DROP TABLE run; --', "1; DELETE FROM pose", "1 UNION SELECT 1", "-1", "1e9",
    "٣", "１",
    "\r\nSet-Cookie: a=b", "<script>alert(1)</script>", "\u202e", "{{7*7}}", "%s%n", "9" * 30,
)  # fmt: skip
PATHS = (
    "/api/runs/{}", "/api/runs/{}/poses", "/api/runs/{}/samples", "/api/runs/{}/events",
    "/api/runs/{}/diagnosis", "/api/runs/{}/transcript", "/api/runs/{}/figures/residual",
    "/api/runs/1/figures/{}", "/api/runs/1/samples?pose={}",
    "/api/rigs/{}/error-map", "/api/rigs/{}/figures/error-map", "/api/units/{}", "/api/units/{}/calibration",
    "/api/compare?unit={}", "/api/compare/figures/{}", "/web/{}", "/vendor/{}", "/{}",
)  # fmt: skip


@pytest.fixture(scope="module")
def imported(shared_client):
    """A run, the first of its store."""
    return upload(shared_client, "f.csv").raise_for_status().json()


def upload(client, file_name, unit="AS-1", **fields):
    return client.post("/api/imports", files={"file": (file_name, POSES)}, data={"unit": unit, **fields})


@pytest.mark.parametrize("path", PATHS)
def test_no_path_or_query_reaches_a_file_or_the_database(shared_client, imported, path):
    # Not by httpx, which takes `..` out of a path by itself.
    connection = HTTPConnection(shared_client.base_url.host, shared_client.base_url.port, timeout=20)
    for nasty in NASTY:
        for written in (
            quote(nasty, safe=""),
            quote(nasty, safe="").replace(".", "%2e"),
            quote(nasty, safe="/"),
        ):
            connection.request("GET", path.format(written))
            answer = connection.getresponse()
            text = answer.read().decode()
            assert answer.status in {404, 405, 422}, (written, text)
            assert "root:" not in text
    connection.close()
    assert shared_client.get("/api/runs/1").json() == imported


@pytest.mark.parametrize("key", ["unit", "rig", "status", "cursor", "limit"])
def test_no_filter_reaches_the_database(shared_client, imported, key):
    for nasty in NASTY:
        answer = shared_client.get("/api/runs", params={key: nasty})
        assert answer.status_code == 422 or answer.json() == {"items": [], "next_cursor": None}, nasty
    assert shared_client.get("/api/runs").json()["items"][-1] == imported


@pytest.mark.parametrize(
    "name", [*NASTY, 'a"; filename="b', "x" * 3000, "\x1b[31m", "a\\b", "=cmd()", "\ud7ff"]
)
def test_a_files_name_is_a_text_and_no_path(shared_client, name):
    answer = upload(shared_client, name, unit="F-1")
    assert answer.status_code == 201, answer.text
    kept = answer.json()["provenance"]["imported_from"]
    assert kept.isprintable()
    assert len(kept) <= 200


@pytest.mark.parametrize("text", ["\x00", "\ud800", "\x1b[2J", "a\nb", "\u202e"])
def test_a_serial_number_that_is_not_printable_is_refused(shared_client, text):
    body = b'{"unit": "%s"}' % "".join(f"\\u{ord(c):04x}" for c in text).encode()
    answer = shared_client.post("/api/runs", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert answer.json()["detail"].isprintable()


def test_a_download_is_named_by_the_service_alone(shared_client, imported):
    for path in ("poses?format=csv", "samples", "samples?format=npz"):
        answer = shared_client.get(f"/api/runs/{imported['id']}/{path}")
        assert re.fullmatch(r'attachment; filename="[a-z0-9.-]+"', answer.headers["Content-Disposition"])


def test_what_is_exported_holds_no_formula_and_comes_back_the_same(shared_client, imported):
    text = shared_client.get(f"/api/runs/{imported['id']}/poses?format=csv").text
    header, *rows = text.splitlines()
    assert not any(name.startswith(tuple("=+-@\t\r")) for name in header.split(","))
    assert rows[1] == "0.0,-0.4,4.99"  # a negative number stays a number
    again = shared_client.post(
        "/api/imports", files={"file": ("again.csv", text)}, data={"unit": "copy"}
    ).json()
    poses = [shared_client.get(f"/api/runs/{run['id']}/poses").json() for run in (imported, again)]
    assert poses[0] == poses[1]
    assert poses[0][0]["+5V"] == 5.01


def calrig(*arguments, cwd):
    command = [sys.executable, "-m", "calrig", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("name", ["\x1b[31mred.csv", "two\nlines.csv", "\u202egnp.csv", "[bold]x[/bold].csv"])
def test_a_files_name_says_nothing_to_the_terminal(tmp_path, name):
    done = calrig("import", name, "--unit", "A", "--db", "a.db", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.rstrip("\n").isprintable()


EVIL = "[red]a[/red][link=http://x]b[/link]\x1b]0;owned\x07\x1b[2J\u202e"


def test_what_devices_say_is_shown_as_it_is(capsys):
    found = SimpleNamespace(
        port=EVIL, kind="stage", driver="smc100", identity=EVIL, usb_id="1:2", usb_serial=EVIL
    )
    terminal.print_ports([found], f"# {EVIL}\n")
    shown = capsys.readouterr().out
    assert "[red]a[/red]" in shown
    assert shown.replace("\n", "").isprintable()


def test_a_serial_number_is_no_markup(capsys):
    number = {"bias_dps": [None] * 3, "bias_std_dps": [None] * 3, "scale": None, "scale_std": None}
    result = dict.fromkeys(
        ("bias_deg", "bias_std_deg", "scale", "scale_std", "rms_raw_deg", "rms_calibrated_deg", "noise_deg")
    )
    result |= {"gyro": number, "temperature_c": None, "reference": None, "n_poses": 3}
    terminal.print_result(SimpleNamespace(id="1", unit="[red]AS-1[/red]", rig="bench-1", result=result))
    assert "[red]AS-1[/red]" in capsys.readouterr().out


def test_printable_text_stays_as_it_is():
    assert printable("Ünit № 7 [a] 'b'\n") == "Ünit № 7 [a] 'b'\n"
    assert printable("\x1b[31m\r\udcff") == r"\x1b[31m\r\udcff"


@pytest.mark.parametrize(
    "port", ["../../evil", "/dev/ttyUSB0", "socket://h:1/..\\x", "a\n0.5 > 00", "x" * 500, "\x00"]
)
def test_a_transcript_lies_in_its_folder_whatever_the_port_is_called(tmp_path, port):
    with taped(tmp_path / "record") as tapes:
        tape = tapes.of(port)
        tape.note(">", b"1TS\r\n")
    (file,) = (tmp_path / "record").iterdir()
    assert file.is_file()
    (piece,) = read_transcript(file.read_text().splitlines())
    assert piece.data == b"1TS\r\n"
    assert len(read_transcript(tape.last_minute().splitlines())) == 1


COMMANDS = (("import", "--unit", "A", "--db", "a.db"), ("diagnose",), ("noise",))
TELLING_ITS_PEAK = """
import re, sys
from pathlib import Path
from calrig.cli.main import main
try:
    main()
finally:
    print(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
"""
"""The command line, which then prints the most memory it had, in kB. What a parent is told of its child
(`ru_maxrss`) begins with the parent's own."""


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_a_file_of_two_gigabytes_is_not_read(tmp_path, command):
    file = tmp_path / "large.csv"
    with file.open("wb") as opened:
        opened.write(b"target_deg,reading_deg,accel_x_g\n1,2,3\n")
        opened.truncate(2_000_000_000)  # sparse: it takes no room
    done = subprocess.run(
        [sys.executable, "-c", TELLING_ITS_PEAK, command[0], str(file), *command[1:]],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "bytes" in done.stderr
    assert int(done.stdout) < 350_000  # with the interpreter and numpy


def test_a_plan_of_a_gigabyte_is_not_read(tmp_path):
    plan = tmp_path / "plan.json"
    with plan.open("wb") as opened:
        opened.truncate(1_000_000_000)
    done = calrig("run", "--unit", "A", "--plan", str(plan), "--db", "a.db", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
