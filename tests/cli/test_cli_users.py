"""`calrig users`: in the store, or at the service that holds it."""

from __future__ import annotations

import json
import re

import pytest
from command_line import calrig, reason
from support import serving

from calrig.api.access import Access

TOKEN = "the-benches-of-building-4"


def listed(*arguments):
    users = json.loads(calrig("users", "list", "--json", *arguments).stdout)
    return [(user["name"], user["role"], user["has_token"], user["disabled_at"] is None) for user in users]


@pytest.fixture
def running(service, monkeypatch):
    """The service that holds the store, named as a person would; a client of it without a token."""
    with serving(service, access=Access(TOKEN, patience_s=0.05)) as client:
        monkeypatch.setenv("CALRIG_SERVER", str(client.base_url))
        monkeypatch.setenv("CALRIG_TOKEN", TOKEN)
        yield client


def test_the_first_users_are_made_in_the_store_and_the_service_knows_them(folder):
    calrig("import", "poses.csv", "--unit", "A")  # makes the store
    (token,) = calrig("users", "add", "ada", "--role", "operator").stdout.splitlines()
    assert token.startswith("calrig_")
    assert calrig("users", "add", "ben", "--no-token").stdout == ""
    assert listed() == [("ada", "operator", True, True), ("ben", "viewer", False, True)]
    assert calrig("users", "token", "ada").stdout.strip() not in {token, ""}
    calrig("users", "role", "ben", "admin")
    calrig("users", "disable", "ada")
    assert listed() == [("ada", "operator", False, False), ("ben", "admin", False, True)]
    shown = calrig("users", "list").stdout
    assert "no more" in shown
    assert "by a trusted proxy" in shown
    assert token not in shown


def test_the_same_through_a_running_service_and_it_holds_at_once(running):
    token = calrig("users", "add", "ada", "--role", "viewer").stdout.strip()
    ada = {"Authorization": f"Bearer {token}"}
    assert running.get("/api/runs", headers=ada).status_code == 200
    calrig("users", "role", "ada", "operator")
    assert listed() == [("ada", "operator", True, True)]
    again = calrig("users", "token", "ada").stdout.strip()
    assert running.get("/api/runs", headers=ada).status_code == 401
    calrig("users", "disable", "ada")
    assert running.get("/api/runs", headers={"Authorization": f"Bearer {again}"}).status_code == 401


def test_a_store_that_another_program_holds_is_said_to_be_and_how_to_reach_one_that_serves_it(
    service, store_path
):
    said = reason("users", "add", "ada", "--db", store_path, status=1)
    assert "writes to it" in said
    assert "--server" not in said  # nothing answers there
    service.store.answers_at("http://127.0.0.1:9")  # it is too busy to answer
    assert "--server http://HOST:PORT" in reason("users", "add", "ada", "--db", store_path, status=1)


def test_what_cannot_be_done_is_said_in_one_line(folder, monkeypatch):
    assert "letters, digits" in reason("users", "add", "a b", status=1)
    assert "no user 'eve'" in reason("users", "disable", "eve", status=1)
    calrig("users", "add", "ada", "--role", "king", status=2)
    assert "does not answer" in reason("users", "list", "--server", "http://127.0.0.1:9", status=1)
    assert "is no address" in reason("users", "list", "--server", "lab-pc", status=2)


def test_what_the_service_refuses_is_said_in_its_words(running, monkeypatch):
    calrig("users", "add", "ada", "--role", "admin")
    assert "ada is the last admin" in reason("users", "disable", "ada", status=1)
    monkeypatch.setenv("CALRIG_TOKEN", calrig("users", "add", "ben").stdout.strip())
    said = reason("users", "list", status=1)
    assert re.search(r"ben \(viewer\).* admin", said)
    monkeypatch.delenv("CALRIG_TOKEN")
    assert "has not shown a token" in reason("users", "list", status=1)
