"""A service from Python in three lines; its events over a line that is cut again and again."""

from __future__ import annotations

import asyncio
import json
import random
import socket
import subprocess
import sys
import threading
from contextlib import aclosing, closing, contextmanager
from pathlib import Path

import pytest
from support import LONG, QUICK, running_service, serving

import calrig
from calrig.client import (
    Invalid,
    PlanDesign,
    Refused,
    RigState,
    RunFailed,
    RunRecord,
    Unreachable,
    documents,
)
from calrig.client import run as events
from calrig.client.run import parsed
from calrig.errors import InputError, WorkError
from calrig.model.diagnosis import ChangedBetween


@pytest.fixture(scope="module")
def served(rig, tmp_path_factory):
    path = tmp_path_factory.mktemp("client") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        yield service, str(client.base_url)


@pytest.fixture(scope="module")
def service(served):
    return calrig.Client(served[1])


@pytest.fixture(scope="module")
def finished(service):
    run = service.calibrate("AS-0042", plan=QUICK, operator="Ada", note="as found")
    return run, list(run.events())


def test_three_lines_calibrate_a_unit(finished):
    run, _ = finished
    assert run.result.bias_deg == pytest.approx(0.8, abs=0.2)  # the simulated mount's offset
    assert run.record.verdict.says
    assert (run.record.unit, run.record.operator, run.record.note) == ("AS-0042", "Ada", "as found")
    assert len(run.poses()) == run.result.n_poses == 6


def test_events_are_an_iterator_of_all_that_happened(finished):
    run, log = finished
    assert [event.id for event in log] == list(range(1, len(log) + 1))
    states = [event.data["status"] for event in log if event.type == "state"]
    assert states == ["queued", "running", "completed"]
    assert log[-1].is_last
    assert list(run.events(after=log[-3].id)) == log[-2:]
    assert list(run.events(after=log[-1].id)) == []


def test_what_was_measured_is_compared_and_applied(service, finished):
    run, _ = finished
    (unit,) = service.compare("AS-0042").units
    assert [one.bias_deg for one in unit.runs] == [run.result.bias_deg]
    calibration = service.calibration("AS-0042")
    reading_deg = run.result.bias_deg + run.result.scale * 12.0
    assert calibration.elevation_deg(reading_deg) == pytest.approx(12.0)
    assert service.runs(unit="AS-0042", begins=run.id[:8]) == [run.look()]


def test_refusals_are_exceptions_in_the_service_s_words(service, monkeypatch):
    with pytest.raises(Refused, match="there is no run nope") as refused:
        service.run("nope")
    assert refused.value.status == 404
    assert isinstance(refused.value, WorkError)
    with pytest.raises(Invalid, match="stepp") as invalid:
        service.calibrate("A", plan={"stepp": 5})
    assert isinstance(invalid.value, InputError)
    with pytest.raises(InputError, match=r"absent\.csv: cannot be read"):
        service.import_poses("absent.csv", "A")
    with pytest.raises(Invalid, match="certificate"):
        service.plan(target_u_deg=0.001)
    with pytest.raises(Unreachable, match="does not answer"):
        calrig.Client("http://127.0.0.1:1").rigs()
    with pytest.raises(InputError, match="no address"):
        calrig.Client("lab-pc:8000")
    with pytest.raises(InputError, match="printable ASCII"):
        calrig.Client(service.server, token="two\nlines").rigs()
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
    assert service.rigs() == calrig.Client(service.server).rigs(), "no proxy hears what stays on this machine"


def test_a_plan_is_designed_and_taken_as_it_is(service):
    design = service.plan(time_s=60.0, trace=False)
    run = service.calibrate("AS-2", plan=design)
    assert run.record.plan["elevations_deg"] == design.plan["elevations_deg"]
    assert design.expected.duration_s <= 60.0
    assert run.abort().status == "aborted"
    with pytest.raises(RunFailed, match="aborted") as failed:
        _ = run.result
    assert failed.value.record.id == run.id


def test_asyncio_does_the_same(served, rig):
    _, url = served

    async def work():
        client = calrig.AsyncClient(url)
        run = await client.calibrate("AS-3", plan=LONG)
        async with aclosing(run.events()) as events:
            kinds = [event.type async for event in aiter_slice(events, 3)]
        assert kinds[0] == "state"
        with pytest.raises(Refused, match="busy"):
            await client.calibrate("AS-4", rig=rig.name)
        await run.abort()
        assert (await run.wait()).status == "aborted"
        with pytest.raises(RunFailed):
            await run.result()
        return await client.compare("AS-3"), await client.rigs()

    async def aiter_slice(events, n):
        async for event in events:
            yield event
            n -= 1
            if n == 0:
                return

    compared, (known,) = asyncio.run(work())
    assert compared.units[0].unit == "AS-3"
    assert known.name == rig.name


def test_every_field_is_one_that_the_service_has():
    document = json.loads((Path(calrig.__file__).parent / "docs" / "openapi.json").read_text())
    answers = document["components"]["schemas"]
    for kind, theirs in ((RunRecord, "RunAnswer"), (PlanDesign, "DesignAnswer")):
        assert kind.model_fields.keys() | kind.model_computed_fields == set(answers[theirs]["properties"])


def test_a_field_that_a_newer_service_adds_is_kept(service):
    newer = [{**rig.model_dump(), "colour": "red"} for rig in service.rigs()]
    (rig,) = documents.each(RigState, newer)
    assert (rig.colour, rig["name"]) == ("red", rig.name)
    with pytest.raises(KeyError):
        rig["weight"]


def test_a_field_that_a_newer_service_adds_is_kept_at_every_depth(finished):
    """`calrig run` against a newer service ends with its result and not in an error."""
    run, _ = finished
    newer = run.record.model_dump(mode="json")
    newer = {**newer, "verdict": {**newer["verdict"], "colour": "red"}}
    newer["result"] = {**newer["result"], "over_range": {**newer["result"]["over_range"], "colour": "red"}}
    record = documents.typed(RunRecord, newer)
    assert record.verdict.colour == record.result.over_range.colour == "red"


def test_a_key_that_is_a_word_of_python_is_read_by_its_name_in_json():
    """As programs have it that were written when these were dictionaries."""
    change = ChangedBetween.model_validate({"from": "a", "to": "b"})
    assert change["from"] == change.from_ == change.model_dump()["from"] == "a"


def test_importing_calrig_imports_no_client_and_the_client_nothing_heavy():
    heavy = ("pydantic", "numpy", "fastapi", "sqlalchemy")
    loaded = f"print([m for m in {heavy} if m in sys.modules])"
    script = f"import sys, calrig; {loaded}; calrig.Client; {loaded}"
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert said.split() == ["[]", "['pydantic']"]


@contextmanager
def cut_line(url: str, pieces: list[int]):
    """A relay to a service that hangs up after so many bytes of each answer, then passes on all of them."""
    host, _, port = url.removeprefix("http://").partition(":")

    def carry(near: socket.socket, most: int | None) -> None:
        with closing(near), closing(socket.create_connection((host, int(port)))) as far:
            far.sendall(near.recv(65536))  # of a GET, all there is
            while (most is None or most > 0) and (piece := far.recv(65536)):
                piece = piece[:most]
                near.sendall(piece)
                most = None if most is None else most - len(piece)

    def accept() -> None:
        while True:
            try:
                near, _ = listener.accept()
            except OSError:
                return
            most = pieces.pop(0) if pieces else None
            threading.Thread(target=carry, args=(near, most), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=accept, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            listener.shutdown(socket.SHUT_RDWR)


def test_a_line_that_is_cut_anywhere_loses_and_doubles_nothing(service, monkeypatch):
    monkeypatch.setattr(events, "AGAIN_S", 0.01)
    run = service.calibrate("AS-0042", plan=QUICK)
    whole = list(run.events())
    cuts = random.Random(1)
    pieces = [0, 20, *(cuts.randrange(250, 1500) for _ in range(12))]
    with cut_line(service.server, pieces) as url:
        followed = calrig.Client(url)
        path = f"/api/runs/{run.id}"
        away = []
        assert list(events.Run(followed, run.record).events(away=away.append)) == whole
        assert "does not answer" in str(away[0])
        assert pieces == [], "every cut was made"
        assert followed.get(path)["status"] == "completed"


def test_a_run_that_is_not_there_is_said_at_once(service):
    with pytest.raises(Refused, match="there is no run 99"):
        next(events.Run(service, RunRecord.model_construct(id="99", unit="")).events())


def test_fields_of_events_are_read_as_the_standard_has_them():
    lines = b": a comment\r\n\r\nid: 7\r\nevent:pose\ndata: {\ndata:  1}\nretry\n\ndata: not whole"
    assert list(parsed(lines.splitlines(keepends=True))) == [
        {"id": "7", "event": "pose", "data": "{\n 1}", "retry": ""}
    ]
