"""Texts from outside reach neither SQL nor paths, and come out as they went in."""

from __future__ import annotations

import re
from http.client import HTTPConnection
from urllib.parse import quote

import pytest
from support import PATIENCE_S, imported

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
    "/api/runs/RUN/figures/{}", "/api/runs/RUN/samples?pose={}",
    "/api/rigs/{}/error-map", "/api/rigs/{}/figures/error-map", "/api/units/{}", "/api/units/{}/calibration",
    "/api/compare?unit={}", "/api/compare/figures/{}", "/web/{}", "/web/vendor/{}", "/{}",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(shared_client):
    return imported(shared_client, "AS-1", POSES)


@pytest.mark.parametrize("path", PATHS)
def test_no_path_or_query_reaches_a_file_or_the_database(shared_client, run, path):
    # Not by httpx, which takes `..` out of a path by itself.
    connection = HTTPConnection(shared_client.base_url.host, shared_client.base_url.port, timeout=PATIENCE_S)
    for nasty in NASTY:
        quoted = quote(nasty, safe="")
        for written in {quoted, quoted.replace(".", "%2e"), quote(nasty, safe="/")}:
            connection.request("GET", path.replace("RUN", run["id"]).format(written))
            answer = connection.getresponse()
            text = answer.read().decode()
            assert answer.status in {404, 405, 422}, (written, text)
            assert "root:" not in text
    connection.close()
    assert shared_client.get(f"/api/runs/{run['id']}").json() == run


@pytest.mark.parametrize("key", ["unit", "rig", "status", "cursor", "limit"])
def test_no_filter_reaches_the_database(shared_client, run, key):
    for nasty in NASTY:
        answer = shared_client.get("/api/runs", params={key: nasty})
        assert answer.status_code == 422 or answer.json() == {"items": [], "next_cursor": None}, nasty
    assert shared_client.get("/api/runs").json()["items"][-1] == run


@pytest.mark.parametrize(
    "name", [*NASTY, 'a"; filename="b', "x" * 3000, "\x1b[31m", "a\\b", "=cmd()", "\ud7ff"]
)
def test_a_files_name_is_a_text_and_no_path(shared_client, name):
    kept = imported(shared_client, "F-1", POSES, name)["provenance"]["imported_from"]
    assert kept.isprintable()
    assert len(kept) <= 200


@pytest.mark.parametrize("text", ["\x00", "\ud800", "\x1b[2J", "a\nb", "\u202e"])
def test_a_serial_number_that_is_not_printable_is_refused(shared_client, text):
    body = b'{"unit": "%s"}' % "".join(f"\\u{ord(c):04x}" for c in text).encode()
    answer = shared_client.post("/api/runs", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert answer.json()["detail"].isprintable()


def test_a_text_that_no_store_could_keep_is_refused(shared_client, run):
    for path, field in (("note", "note"), ("void", "reason")):
        for text in (b"a\\u0000b", b"a\\ud800"):
            body = b'{"%s": "%s"}' % (field.encode(), text)
            answer = shared_client.post(
                f"/api/runs/{run['id']}/{path}", content=body, headers={"Content-Type": "application/json"}
            )
            assert answer.status_code == 422, answer.text
            assert answer.json()["detail"].isprintable()


def test_a_download_is_named_by_the_service_alone(shared_client, run):
    for path in ("poses?format=csv", "samples", "samples?format=npz"):
        answer = shared_client.get(f"/api/runs/{run['id']}/{path}")
        assert re.fullmatch(r'attachment; filename="[a-z0-9.-]+"', answer.headers["Content-Disposition"])


def test_what_is_exported_holds_no_formula_and_comes_back_the_same(shared_client, run):
    text = shared_client.get(f"/api/runs/{run['id']}/poses?format=csv").text
    header, *rows = text.splitlines()
    assert not any(name.startswith(tuple("=+-@\t\r")) for name in header.split(","))
    assert rows[1] == "0.0,-0.4,4.99"  # a negative number stays a number
    again = imported(shared_client, "copy", text)
    poses = [shared_client.get(f"/api/runs/{one['id']}/poses").json() for one in (run, again)]
    assert {pose.pop("mount") for pose in poses[0] + poses[1]} == {f"{one['id']} 0°" for one in (run, again)}
    assert poses[0] == poses[1]
    assert poses[0][0]["+5V"] == 5.01
