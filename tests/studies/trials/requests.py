"""Requests made from the OpenAPI document, right and wrong ones, against the real application and a rig.

Schemathesis makes them and holds every answer to the document. Of the requests that name a run, a unit or a
rig, half name one that is there; what a request has started is stopped before the next one.
"""

from __future__ import annotations

import multiprocessing
import random
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from calrig.api import jobs
from calrig.api.access import Access
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.launch import launch
from tests.studies.trials.counting import Count, Extent, none_of
from tests.support import FAST, LONG, QUICK, ended, running_service, serving

REQUESTS = 20_000
A_ROUND = 24
"""Requests to one path before the next one has its turn; fewer, where every path would not have two turns."""
SELDOM = {"POST /api/rigs/scan": 8, "POST /api/runs/{run_id}/diagnosis": 200}
"""At most so many of all: a scan waits seven seconds for boards to answer, a diagnosis computes long."""
ANSWER_S = 60.0
CHECKS = (
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
)
POSES = "target_deg,reading_deg,supply_v\n-30,-29.5,3.3\n0,0.4,\n30,30.6,3.2\n"
TOKEN = "the-benches-of-building-4"
KNOWN = {"Authorization": f"Bearer {TOKEN}"}
"""Of requests: some of them make users, after whom nobody else comes in."""
STOPS = frozenset({"abort", "pause", "resume", "stop"})


def trial(extent: Extent) -> list[Count]:
    """Asks on all processors, each with an application, a store and a rig of its own."""
    n = max(1, extent.of(REQUESTS) // extent.workers)
    tasks = [(extent.seed * 1000 + worker, n, extent.workers) for worker in range(extent.workers)]
    statuses: Counter[int] = Counter()
    seldom: Counter[str] = Counter()
    server_errors: list[str] = []
    others: list[str] = []
    with ProcessPoolExecutor(extent.workers, multiprocessing.get_context("spawn")) as pool:
        for asked in pool.map(_asked, tasks):
            statuses.update(asked.statuses)
            seldom.update(asked.seldom)
            server_errors += asked.server_errors
            others += asked.others
    total = sum(statuses.values())
    shares = Counter(f"{status // 100}xx" for status in statuses.elements())
    tried = f"{total:,} requests ({', '.join(f'{k} {v / total:.0%}' for k, v in sorted(shares.items()))})"
    of_these = ", ".join(f"{count} × {name}" for name, count in sorted(seldom.items()))
    return [
        none_of("5xx answers", tried, server_errors),
        none_of("answers outside the schema", f"the same; of them only {of_these}", others),
    ]


class _Asked:
    """What was asked by one process, and what came back."""

    def __init__(self) -> None:
        self.statuses: Counter[int] = Counter()
        self.seldom: Counter[str] = Counter()
        self.server_errors: list[str] = []
        self.others: list[str] = []

    def note(self, case: Any, status: int, failures: list[str]) -> None:
        """Counts an answer."""
        self.statuses[status] += 1
        if failures or status >= 500:
            said = f"{status}: {'; '.join(failures)}: {case.as_curl_command()}"[:1500]
            (self.server_errors if status >= 500 else self.others).append(said)


def _asked(task: tuple[int, int, int]) -> _Asked:
    first_seed, n, workers = task
    asked = _Asked()
    with _application() as client:
        there = _There(client, random.Random(first_seed))
        schema = schemathesis.openapi.from_url(f"{client.base_url}/api/openapi.json", headers=KNOWN)
        operations = [result.ok() for result in schema.get_all_operations()]
        a_round = min(A_ROUND, max(n // (2 * len(operations)), 1))
        round_ = 0
        while sum(asked.statuses.values()) < n:
            for operation in operations:
                mode = (GenerationMode.POSITIVE, GenerationMode.NEGATIVE)[round_ % 2]
                few = a_round
                if operation.label in SELDOM:
                    left = SELDOM[operation.label] // workers * n * workers // REQUESTS
                    few = min(few, max(left, 1) - asked.seldom[operation.label])
                if few > 0:
                    _ask(operation, mode, few, first_seed + 7919 * round_, there, asked)
            round_ += 1
    return asked


def _ask(operation: Any, mode: Any, n: int, at_seed: int, there: _There, asked: _Asked) -> None:
    """Some requests to one path; one without anything to vary is asked once."""

    @seed(at_seed)
    @settings(
        max_examples=n, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(case=operation.as_strategy(generation_mode=mode))
    def one(case: Any) -> None:
        there.name_what_is_there(case)
        answer = case.call(timeout=ANSWER_S, headers=KNOWN)
        failures: list[str] = []
        try:
            case.validate_response(answer, checks=CHECKS)
        except (Failure, FailureGroup) as error:
            failures = [" ".join(str(e).split()) for e in getattr(error, "exceptions", [error])]
        asked.note(case, answer.status_code, failures)
        asked.seldom.update([operation.label] if operation.label in SELDOM else [])
        there.stop_what_began(case, answer)

    try:
        one()
    except Unsatisfiable:  # nothing about this path can be wrong
        if mode is GenerationMode.NEGATIVE:
            _ask(operation, GenerationMode.POSITIVE, n, at_seed, there, asked)


class _There:
    """What is in the store, and the one run that is going on now and then."""

    def __init__(self, client: httpx.Client, rng: random.Random) -> None:
        self._client = client
        self._rng = rng
        self._rig = client.get("/api/rigs").json()[0]["name"]
        measured = self._measured({"plan": {**QUICK, "sweeps": 4}})
        static = self._measured({"plan": {"kind": "static", "dwell_s": 20.0}})
        imported = self._client.post(
            "/api/imports", files={"file": ("p.csv", POSES)}, data={"unit": "B/1"}
        ).raise_for_status().json()["id"]  # fmt: skip
        self._client.post(f"/api/runs/{measured}/diagnosis", json={}).raise_for_status()
        self._runs = (measured, measured, static, imported)
        self._jobs = [""]

    def _measured(self, body: dict[str, Any]) -> str:
        begun = self._client.post("/api/runs", json={"unit": "A-1", **body}).raise_for_status().json()
        assert ended(self._client, begun["id"], 120.0)["status"] == "completed"
        return str(begun["id"])

    def name_what_is_there(self, case: Any) -> None:
        """Puts names of what there is in the place of half of those that were made up."""
        named = case.path_parameters or {}
        if self._rng.random() < 0.5:
            return
        action = case.path.rsplit("/", 1)[-1]
        if "run_id" in named:
            is_going = action in STOPS and self._rng.random() < 0.1
            named["run_id"] = self._going() if is_going else self._rng.choice(self._runs)
        if "job_id" in named:
            named["job_id"] = self._jobs[-1]
        if "serial" in named:
            named["serial"] = self._rng.choice(("A-1", "B/1"))
        if "index" in named:
            named["index"] = self._rng.randrange(8)
        if "/rigs/{name}" in case.path:
            named["name"] = self._rig
        if case.path.startswith("/api/compare") and isinstance(case.query, dict) and "unit" in case.query:
            case.query["unit"] = ["B/1", "A-1"]
        if isinstance(case.body, dict) and "unit" in case.body:
            case.body["unit"] = "A-1"
            if case.path == "/api/runs":
                case.body.pop("rig", None)
        if isinstance(case.body, dict) and "file" in case.body:
            case.body["file"] = POSES.encode()

    def _going(self) -> str:
        begun = self._client.post("/api/runs", json={"unit": "A-1", "plan": LONG}).raise_for_status()
        return str(begun.json()["id"])

    def stop_what_began(self, case: Any, answer: Any) -> None:
        """Aborts whatever runs: a plan may take days. A job is for the requests to come."""
        if answer.status_code == 202:
            self._jobs.append(answer.json()["id"])
        if case.method == "POST" and "/figures" not in case.path:
            for rig in self._client.get("/api/rigs").json():
                if rig["run_id"] is not None:
                    self._client.post(f"/api/runs/{rig['run_id']}/abort")
                    ended(self._client, rig["run_id"])


@contextmanager
def _application() -> Iterator[httpx.Client]:
    """The real application on a store of its own, with a fast simulated rig behind real ports."""
    jobs.AT_ONCE_S = 0.0  # so that there are jobs: what is asked for here is soon done
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        ports = stack.enter_context(launch(FAST))
        rig = RigSettings(
            name="bench-1",
            stage=StageSettings(driver="smc100", port=ports.stage_port),
            imu=BoardSettings(driver="calrig", port=ports.imu_port),
            reference=ReferenceSettings(std_deg=0.29),
            simulated={},
        )
        service = stack.enter_context(running_service(folder / "calrig.db", rig))
        client = stack.enter_context(serving(service, access=Access(TOKEN)))
        client.headers.update(KNOWN)
        client.timeout = httpx.Timeout(ANSWER_S)
        yield client
