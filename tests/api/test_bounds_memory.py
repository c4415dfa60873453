"""Bodies made to fill a service's memory or disk: each gets an answer, and the service grows by little.

A step of `.ci/run`; `test_bounds.py` has a quick look at the same for every day.
"""

from __future__ import annotations

import gzip
import http.client
import io
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest
from support import PATIENCE_S

MB = 1_000_000
MOST_MB = 200
BOUNDARY = "x-calrig-x"
NO_RIG = """
[[rig]]
name = "bench-1"
stage = {driver = "smc100", port = "/dev/there-is-none"}
imu = {driver = "calrig", port = "/dev/there-is-none-either"}
"""
POSES = b"target_deg,reading_deg"
WIDE = POSES + b"".join(b",c%d" % k for k in range(198)) + b"\n"
LOG = b"time_s,accel_x_g,accel_y_g\n"

pytestmark = [
    pytest.mark.memory,
    pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux tells the peak in /proc"),
]


@dataclass
class Served:
    """The real service in a process of its own."""

    process: subprocess.Popen[str]
    port: int
    temporary: Path

    def grown_mb(self, ask) -> tuple[float, object]:
        """What `ask` gives, and by how much the process was larger meanwhile than before."""
        of_process = Path(f"/proc/{self.process.pid}")
        (of_process / "clear_refs").write_text("5")  # forgets the peak so far (proc(5))
        before = _kb(of_process, "VmRSS")
        answer = ask()
        return (_kb(of_process, "VmHWM") - before) / 1000, answer

    def post(
        self, path: str, pieces: Iterator[bytes], kind: str, length: int | None = None
    ) -> tuple[int, str]:
        """Status and text of the answer; without a length the body is sent in chunks."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=500)
        headers = {"Content-Type": kind} | ({} if length is None else {"Content-Length": str(length)})
        connection.request("POST", path, pieces, headers, encode_chunked=length is None)
        answer = connection.getresponse()
        status, text = answer.status, answer.read().decode()
        connection.close()
        return status, text

    def upload(self, content: bytes, path: str = "/api/imports") -> tuple[int, str]:
        """Sends a file as a browser does."""
        begin, end = _multipart()
        body = begin + content + end
        return self.post(path, iter([body]), f"multipart/form-data; boundary={BOUNDARY}", len(body))


def _kb(of_process: Path, key: str) -> int:
    return int(re.search(rf"{key}:\s+(\d+)", (of_process / "status").read_text())[1])


def _multipart() -> tuple[bytes, bytes]:
    unit = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="unit"\r\n\r\nA\r\n'
    file = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="file"; filename="f.csv"\r\n\r\n'
    return (unit + file).encode(), f"\r\n--{BOUNDARY}--\r\n".encode()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bounds")
    (folder / "calrig.toml").write_text(NO_RIG)
    temporary = folder / "tmp"
    temporary.mkdir()
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "calrig",
            "serve",
            "--port",
            "0",
            "--db",
            "calrig.db",
            "--config",
            "calrig.toml",
        ],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    try:
        line = process.stdout.readline()
        yield Served(process, int(re.search(r"at http://[^ ]*:(\d+)", line)[1]), temporary)
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
        process.stdout.close()


def zipped(content: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.csv", content)
    return buffer.getvalue()


# Hundreds of megabytes in all: each is made when it is sent.

FILES = {
    "a gzip": (lambda: gzip.compress(bytes(20 * MB)), "not UTF-8"),
    "a zip": (lambda: zipped(bytes(20 * MB)), "is not CSV|not UTF-8|line 1"),
    "a million columns": (lambda: POSES + b",c" * MB + b"\n", "1000002 columns; at most 200"),
    "300,000 columns": (lambda: POSES + b",c" * 300_000 + b"\n1,2\n", "300002 columns; at most 200"),
    "one line": (lambda: b"1" * 49 * MB, "longer than"),
    "nothing but commas": (lambda: b"," * 49 * MB, "longer than"),
    "nothing but blank lines": (lambda: POSES + b"\n" * 49 * MB, "longer than"),
    "other names over blank lines": (lambda: b"tilt_a,b\n1,2\n" + b"\n" * 49 * MB, "no such column|line 1"),
    "a quote that does not end": (lambda: POSES + b'\n"' + b"\n" * 49 * MB, "is not CSV"),
    "a million rows": (lambda: POSES + b"\n" + b"1,2\n" * 12 * MB, "more than 100000 rows"),
    "two million cells": (lambda: WIDE + (b"1," * 199 + b"1\n") * 20_000, "more than 2000000 cells"),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("path", ["/api/imports", "/api/noise"])
def test_a_file_made_to_fill_the_memory_is_422_and_says_where(served, path, name):
    make, says = FILES[name]
    content = make()
    grown_mb, (status, text) = served.grown_mb(lambda: served.upload(content, path))
    assert status == 422, text
    assert path == "/api/noise" or re.search(says, text), text
    assert grown_mb < MOST_MB


def test_the_largest_file_that_is_taken_stays_within_the_bound(served):
    rows = WIDE + (b"1.5," * 199 + b"1\n") * 9_999
    grown_mb, (status, text) = served.grown_mb(lambda: served.upload(rows))
    assert status == 201, text
    assert grown_mb < MOST_MB


@pytest.mark.parametrize("length", [None, 2000 * MB], ids=["in chunks", "with its length"])
@pytest.mark.parametrize("kind", ["text/csv", f"multipart/form-data; boundary={BOUNDARY}"])
def test_a_file_of_gigabytes_is_refused_and_its_rest_read_and_dropped(served, kind, length):
    """The test sends no more than shows it: twice what the service may grow by."""
    begin = [_multipart()[0]] if "multipart" in kind else []
    pieces = [*begin, *[b"1,2\n" * 250_000] * (2 * MOST_MB)]
    grown_mb, (status, _) = served.grown_mb(lambda: served.post("/api/imports", iter(pieces), kind, length))
    assert status in ({413} if length or "multipart" in kind else {413, 422})
    assert grown_mb < MOST_MB
    assert list(served.temporary.iterdir()) == []


BODIES = {
    "lists in lists": (lambda: b"[" * 100_000, {422}),
    "objects in objects": (lambda: b'{"a":' * 100_000, {422}),
    "a number of a million digits": (lambda: b'{"unit":' + b"9" * 990_000 + b"}", {422}),
    "1e999999": (lambda: b'{"unit":"A","plan":{"dwell_s":1e999999}}', {422}),
    "half a million elevations": (
        lambda: b'{"unit":"A","plan":{"elevations_deg":[' + b"1," * 490_000 + b"1]}}",
        {422},
    ),
    "a hundred thousand keys": (lambda: b"{" + b",".join(b'"%x":1' % k for k in range(90_000)) + b"}", {422}),
    "a million keys": (lambda: b"{" + b",".join(b'"%x":1' % k for k in range(MB)) + b"}", {413}),
    "a gzip said to be one": (lambda: gzip.compress(bytes(100 * MB)), {422}),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_body_of_json_made_to_fill_the_memory_is_refused(served, name):
    make, statuses = BODIES[name]
    body = make()
    grown_mb, (status, text) = served.grown_mb(
        lambda: served.post("/api/runs", iter([body]), "application/json", len(body))
    )
    assert status in statuses, text
    assert grown_mb < MOST_MB


def part(name: str, content: str) -> bytes:
    return f"--{BOUNDARY}\r\nContent-Disposition: form-data; {name}\r\n\r\n{content}\r\n".encode()


FORMS = {
    "a million parts": lambda: part('name="f"', "") * 600_000,
    "many files": lambda: part('name="file"; filename="f"', "1" * 50_000) * 900,
    "a name without end": lambda: (
        b'--%s\r\nContent-Disposition: form-data; name="' % BOUNDARY.encode() + b"a" * 40 * MB
    ),
    "headers without end": lambda: b"--%s\r\n" % BOUNDARY.encode() + b"A: b\r\n" * 5 * MB,
    "a boundary that does not come": lambda: b"x" * 40 * MB,
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_made_to_fill_the_memory_is_422(served, name):
    form = FORMS[name]()
    kind = f"multipart/form-data; boundary={BOUNDARY}"
    grown_mb, (status, text) = served.grown_mb(
        lambda: served.post("/api/imports", iter([form]), kind, len(form))
    )
    assert status == 422, text
    assert grown_mb < MOST_MB


def test_eight_large_uploads_at_once_take_turns(served):
    rows = (
        POSES
        + b",time_s,note\n"
        + b"10.25,10.5,,aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa\n" * 40_000
    )
    bad = rows + b"x" * (49 * MB - len(rows))  # whose last line is no row: all of it is parsed, nothing kept
    answers: list[tuple[int, str]] = []

    def all_at_once() -> None:
        with ThreadPoolExecutor(8) as crowd:
            answers.extend(crowd.map(lambda _: served.upload(bad), range(8)))

    grown_mb, _ = served.grown_mb(all_at_once)
    assert [status for status, _ in answers] == [422] * 8
    assert grown_mb < MOST_MB
