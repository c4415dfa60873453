"""The API within this process: answers come as they are made, and what breaks off is said to."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace

import pytest
from fastapi import APIRouter
from starlette.responses import StreamingResponse
from support import running_service

from calrig.analysis.errors import Conflict
from calrig.api.access import Who, requires
from calrig.api.in_process import ADDRESS, in_process
from calrig.client import Client, Refused, Unreachable

PATIENCE_S = 30.0


@pytest.fixture
def asked(tmp_path):
    """A client of a few paths, and what their application has seen."""
    router, seen = APIRouter(), SimpleNamespace(go_on=threading.Event(), left=threading.Event())

    @router.get("/lines")
    async def lines() -> StreamingResponse:
        async def told():
            try:
                yield b"first\n"
                while not seen.go_on.is_set():
                    await asyncio.sleep(0)
                yield "second \u2028 half\n".encode()
            finally:
                seen.left.set()

        return StreamingResponse(told())

    @router.get("/broken")
    async def broken() -> StreamingResponse:
        async def told():
            yield b"first\n"
            raise ValueError("in its midst")

        return StreamingResponse(told())

    @router.post("/said", dependencies=[requires("admin")])
    async def said(body: dict[str, str], who: Who) -> object:
        return {"body": body, "who": who}

    @router.get("/refused")
    async def refused() -> None:
        raise Conflict("the rig is busy")

    with (
        running_service(tmp_path / "calrig.db") as service,
        in_process(service, (SimpleNamespace(router=router),)) as through,
    ):
        yield Client(ADDRESS, through=through), seen


def test_lines_come_before_the_answer_is_whole(asked):
    client, seen = asked
    with client.lines("/lines", {}) as lines:
        assert next(lines) == b"first"
        seen.go_on.set()
        assert next(lines).decode() == "second \u2028 half"
        assert list(lines) == []


def test_an_answer_that_nobody_reads_on_ends(asked):
    client, seen = asked
    with client.lines("/lines", {}) as lines:
        assert next(lines) == b"first"
        assert not seen.left.is_set()
    assert seen.left.wait(PATIENCE_S)


def test_who_asks_is_admin_and_no_token_goes_along(asked, monkeypatch):
    monkeypatch.setenv("CALRIG_TOKEN", "two\nlines")
    assert asked[0].post("/said", {"a": "°"}) == {"body": {"a": "°"}, "who": None}


def test_a_refusal_is_said_without_an_address(asked):
    with pytest.raises(Refused) as refused:
        asked[0].get("/refused")
    assert (str(refused.value), refused.value.status) == ("the rig is busy", 409)


def test_an_answer_that_breaks_off_is_no_whole_one(asked):
    with pytest.raises(Unreachable):
        asked[0].text("/broken")


def test_nobody_answers_once_it_has_ended(tmp_path):
    with running_service(tmp_path / "calrig.db") as service:
        with in_process(service, ()) as through:
            client = Client(ADDRESS, through=through)
        with pytest.raises(Unreachable, match="has ended"):
            client.rigs()
