"""The log: one line an event, with the run it is about; nothing that came from outside can forge one."""

from __future__ import annotations

import io
import json
import logging
import re
from collections.abc import Iterator

import httpx
import pytest
from command_line import log_put_back
from raw_http import connected, head
from support import QUICK, ended, wait_for

from calrig import logs

FORGED = "0042\n2026-01-01T00:00:00.000Z info calrig: all is well\x1b[2K\u2028\r"


@pytest.fixture
def lines() -> Iterator[io.StringIO]:
    """The log of this process, in whatever format the test configures; put back afterwards."""
    with log_put_back():
        yield io.StringIO()


def test_text_is_one_line_and_says_what_it_is_about(lines):
    logs.configure("text", lines)
    with logs.about(run_id="17", rig="bench-1"):
        logging.getLogger("calrig.runs").warning("board says %s", "hello")
    logging.getLogger("calrig.runs").info("of no run")
    first, second = lines.getvalue().splitlines()
    assert re.fullmatch(
        r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z warning calrig\.runs: board says hello "
        r"\[run_id=17 rig=bench-1\]",
        first,
    )
    assert second.endswith("info calrig.runs: of no run")


def test_json_is_one_document_a_line(lines):
    logs.configure("json", lines)
    with logs.about(run_id="17", unit="AS/1"):
        logging.getLogger("calrig.runs").info("run %s", "17", extra={"fields": {"status": 201}})
    line = json.loads(lines.getvalue())
    assert line.pop("time").endswith("Z")
    assert line == {
        "level": "info",
        "logger": "calrig.runs",
        "message": "run 17",
        "run_id": "17",
        "unit": "AS/1",
        "status": 201,
    }


@pytest.mark.parametrize("format_", logs.FORMATS)
def test_what_a_device_says_cannot_forge_a_line(lines, format_):
    logs.configure(format_, lines)
    log = logging.getLogger("calrig.instruments")
    with logs.about(unit=FORGED):
        log.warning("the board says %s", FORGED)
        try:
            raise ValueError(FORGED)
        except ValueError:
            log.exception("it failed")
    written = lines.getvalue()
    assert not set(written) & set("\x1b\r\u2028")
    if format_ == "json":
        parsed = [json.loads(line) for line in written.splitlines()]
        assert [line["message"] for line in parsed] == [f"the board says {FORGED}", "it failed"]
        assert FORGED in parsed[1]["traceback"]
    else:
        events = [line for line in written.splitlines() if not line.startswith("  | ")]
        assert len(events) == 2
        assert all("calrig.instruments: " in line for line in events)


def test_other_programs_chatter_stays_out_and_their_warnings_come_in(lines):
    logs.configure("json", lines)
    logging.getLogger("uvicorn.error").info("Started server process")
    logging.getLogger("uvicorn.error").warning("Invalid HTTP request received.")
    assert [json.loads(line)["logger"] for line in lines.getvalue().splitlines()] == ["uvicorn.error"]


def test_requests_that_change_something_or_fail_are_said_and_no_token_is(client: httpx.Client, lines):
    logs.configure("json", lines)
    secret = {"Authorization": "Bearer sesame-42", "Cookie": "calrig=sesame-42"}
    client.get("/api/runs", headers=secret)
    client.post("/api/runs?token=sesame-42", json={"unit": ""}, headers=secret)
    begun = client.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).json()
    assert ended(client, begun["id"])["status"] == "completed"
    client.post(f"/api/runs/{begun['id']}/void", json={"reason": "trial"})
    for line, follows in (("/void", "its answer"), ("is completed", "what the store has")):
        wait_for(lambda line=line: line in lines.getvalue(), f"the line of {line}, which follows {follows}")
    written = lines.getvalue()
    said = [json.loads(line) for line in written.splitlines()]
    requests = [line for line in said if line["logger"] == "calrig.api.origin_check"]
    assert [(r["method"], r["path"], r["status"]) for r in requests] == [
        ("POST", "/api/runs", 422),
        ("POST", "/api/runs", 201),
        ("POST", f"/api/runs/{begun['id']}/void", 200),
    ]
    assert requests[-1]["run_id"] == begun["id"]
    assert all(r["client"] == "127.0.0.1" and 0 <= r["duration_s"] < 20 for r in requests)
    of_the_run = [line for line in said if line["logger"] == "calrig.runs.recorder"]
    assert [line["message"] for line in of_the_run] == [
        f"run {begun['id']} is running",
        f"run {begun['id']} is completed",
    ]
    assert {(r["run_id"], r["rig"], r["unit"]) for r in of_the_run} == {(begun["id"], "bench-1", "AS-1")}
    assert "sesame" not in written


def test_an_upload_that_is_broken_off_is_no_invalid_one(shared_client: httpx.Client, lines):
    logs.configure("json", lines)
    kind = "Content-Type: multipart/form-data; boundary=xx"
    with connected(shared_client) as one:
        one.sendall(
            head(shared_client, "POST /api/imports HTTP/1.1", kind, "Content-Length: 9000") + b"--xx\r\n"
        )
    wait_for(lambda: "/api/imports" in lines.getvalue(), "the request's line")
    said = [json.loads(line) for line in lines.getvalue().splitlines()]
    assert [line["status"] for line in said if line["logger"] == "calrig.api.origin_check"] == [499]
