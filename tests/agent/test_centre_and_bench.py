"""A centre and a bench together: real service over HTTP, real agent, real database, a simulated rig."""

from __future__ import annotations

import io
import json
import random
import re
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest
from a_bench import ENDLESS, Cable, HandWritten, Rig, agent_at, rigs_of
from support import QUICK, ended, imported, serving, wait_for

from calrig.centre.service import CentreService
from calrig.cli.followed_run import FollowedRun
from calrig.client import Client
from calrig.store import Store
from calrig.store.postgresql.database import TURN

CLOCK = "calrig.agent.agent.utc_now"


@pytest.fixture
def page(centre: HandWritten) -> Iterator[httpx.Client]:
    """A client of the centre's service."""
    with (
        Store.open(centre.url, writer="tests") as store,
        closing(CentreService(store, centre.url)) as service,
        serving(service) as client,
    ):
        yield client


def started(page: httpx.Client, **body: object) -> str:
    """The id of a run that the centre was asked for, once its bench is there."""
    wait_for(lambda: [rig for rig in page.get("/api/rigs").json() if rig["state"] != "offline"], "bench")
    answer = page.post("/api/runs", json={"unit": "AS-1", "plan": QUICK, **body})
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


def run_of(page: httpx.Client, run_id: str) -> dict:
    return page.get(f"/api/runs/{run_id}").raise_for_status().json()


def test_a_run_of_the_centre_is_watched_ends_and_gives_a_revision(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig) as agent:
        run_id = started(page)
        numbers, kinds = [], []
        with page.stream("GET", f"/api/runs/{run_id}/events") as stream:
            for line in stream.iter_lines():
                if line.startswith("id:"):
                    numbers.append(int(line[3:]))
                elif line.startswith("event:"):
                    kinds.append(line[6:].strip())
        run, at_bench = run_of(page, run_id), agent.service.run(run_id)
        samples = agent.service.store.samples.of(run_id)
    assert numbers == list(range(1, len(numbers) + 1))
    assert kinds.count("pose") == 6
    assert (run["status"], run["unit"], run["rig"]) == ("completed", "AS-1", "bench-1")
    assert run["result"]["bias_deg"] == pytest.approx(at_bench.result.bias_deg, abs=1e-12)
    assert len(page.get(f"/api/runs/{run_id}/poses").json()) == 6
    kept = np.load(io.BytesIO(page.get(f"/api/runs/{run_id}/samples?format=npz").content))
    assert np.array_equal(kept["gyro_x_dps"], samples.gyro_dps[:, 0])
    (revision,) = page.get("/api/units/AS-1/calibrations").json()
    assert (revision["run_id"], revision["status"]) == (run_id, "in_force")


def test_a_bench_whose_clock_is_a_minute_off_takes_no_orders_and_says_why(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead_s = 75.0
    monkeypatch.setattr(CLOCK, lambda: datetime.now(UTC) + timedelta(seconds=ahead_s))

    def said() -> tuple[float | None, str | None]:
        (bench,) = page.get("/api/benches").raise_for_status().json()
        return bench["clock_skew_s"], bench["clock"]

    with agent_at(centre.bench_url, spool, rig, is_accepted=False) as agent:
        run_id = started(page)
        skew_s, why = wait_for(
            lambda: (found := said())[0] is not None and found, "what it says of its clock"
        )
        assert skew_s == pytest.approx(75.0, abs=2.0)
        assert re.fullmatch(
            r"its clock is 7\d s ahead of the centre's \(at most 60 s\), so it takes no .*NTP\)", why
        )
        (at_a_glance,) = page.get("/api/benches/overview").json()
        assert at_a_glance["clock"] is not None
        assert not agent.lease.is_held()
        assert run_of(page, run_id)["status"] == "queued"
        ahead_s = 10.0
        wait_for(lambda: run_of(page, run_id)["held"], "run that is held back")
        page.post(f"/api/runs/{run_id}/resume").raise_for_status()
        assert ended(page, run_id)["status"] == "completed"
        said_then = wait_for(
            lambda: (found := said()[1]) and "takes no" not in found and found, "other words"
        )
        assert "ahead of the centre's: synchronise" in said_then
        ahead_s = 0.0
        wait_for(lambda: said()[1] is None, "nothing to be said")


def test_a_terminal_hears_why_a_run_waits_for_its_bench_and_then_for_go(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead_s = 75.0
    monkeypatch.setattr(CLOCK, lambda: datetime.now(UTC) + timedelta(seconds=ahead_s))
    there = Client(str(page.base_url))
    with agent_at(centre.bench_url, spool, rig, is_accepted=False):
        followed = FollowedRun(there, there.run(started(page)))

        def told(words: str) -> bool:
            return any(words in event.data.get("says", "") for event in followed.news())

        wait_for(lambda: told("so it takes no orders"), "why it waits")
        ahead_s = 0.0
        wait_for(lambda: told("begins once somebody says Go"), "what it waits for")


def test_a_unit_on_a_bench_is_looked_at_before_its_run(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        wait_for(lambda: [one for one in page.get("/api/rigs").json() if one["state"] == "idle"], "bench")
        batch = page.post("/api/batches", json={"units": ["AS-1"], "rigs": ["bench-1"], "plan": QUICK}).json()
        path = f"/api/batches/{batch['id']}"

        def there() -> str:
            (place,) = page.post(f"{path}/look").raise_for_status().json()["rigs"]
            return place["seen"]["says"] if place["seen"] and place["seen"]["state"] == "there" else ""

        assert "without serial number. Check that the unit is AS-1" in wait_for(there, "unit")
        kept = centre.connection.execute("SELECT count(*) FROM bench_command").fetchone()
        assert kept == (1,), "of each rig the last look is kept"
        (place,) = page.post(f"{path}/start", json={"rig": "bench-1", "unit": "AS-1"}).json()["rigs"]
        assert ended(page, place["on"]["run_id"])["status"] == "completed"


def test_a_verification_applies_the_revision_that_the_centre_issued(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        ended(page, started(page))
        verified = ended(page, started(page, plan={**QUICK, "kind": "verification"}))
    assert verified["status"] == "completed"
    assert verified["provenance"]["verifies_revision"] == 1
    assert verified["result"]["rms_calibrated_deg"] < 0.2
    assert len(page.get("/api/units/AS-1/calibrations").json()) == 1


PLAY_DEG = 0.06


def poses_with_play() -> str:
    """Readings on a stage with play, as a file: without witnesses, moves not yet settled look the same."""
    rng, lines = random.Random(3), ["target_deg,reading_deg,pass,approach,time_s"]
    for sweep in range(4):
        approach = 1 if sweep % 2 == 0 else -1
        for elevation_deg in range(-60 * approach, 61 * approach, 10 * approach):
            reading_deg = elevation_deg - approach * PLAY_DEG / 2 + rng.gauss(0.0, 0.025)
            lines.append(f"{elevation_deg},{reading_deg},{sweep},{approach},{4.0 * (len(lines) - 1)}")
    return "\n".join(lines)


def test_a_follow_up_rests_on_runs_that_only_the_centre_has(
    page: httpx.Client, centre: HandWritten, spool: Path
) -> None:
    with (
        rigs_of("bench-1", seed=5, mechanics={"backlash_deg": PLAY_DEG}) as (rig,),
        agent_at(centre.bench_url, spool, rig) as agent,
    ):
        first = imported(page, "AS-1", poses_with_play(), rig="bench-1")
        found = page.post(f"/api/runs/{first['id']}/diagnosis", json={}).raise_for_status().json()
        assert found["verdict"] == "ambiguous"
        second = wait_for(lambda: _begun(page, first["id"]), "bench")
        done = ended(page, second["id"])
        assert agent.service.store.runs.get(first["id"]) is None
    assert (done["status"], done["follows"]) == ("completed", first["id"])
    assert done["provenance"]["follow_up"]["decided_on"]
    assert done["diagnosis"]["runs"] == [first["id"], second["id"]]
    decided = {effect["name"]: effect["confusable_with"] for effect in done["diagnosis"]["effects"]}
    assert decided["backlash"] == []


def _begun(page: httpx.Client, run_id: str) -> dict | None:
    """The follow-up of a run, once there is a bench to carry it out."""
    answer = page.post(f"/api/runs/{run_id}/follow-up")
    return answer.json() if answer.status_code == 201 else None


def measuring(page: httpx.Client) -> str:
    """A run without an end, once it has a pose."""
    run_id = started(page, plan=ENDLESS)
    wait_for(lambda: run_of(page, run_id)["progress"]["poses_done"], "poses")
    return run_id


def test_a_stop_at_the_centre_stops_the_stage(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = measuring(page)
        stopped = page.post("/api/rigs/bench-1/stop")
        assert (stopped.status_code, rig.stands()) == (200, True)
        assert ended(page, run_id)["status"] == "aborted"


def test_the_answer_to_a_stop_waits_for_nobody_who_writes_and_the_trail_has_it_afterwards(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = measuring(page)
        with centre.connection.transaction():
            centre.connection.execute("SELECT pg_advisory_xact_lock(%s)", (TURN,))
            assert page.post("/api/rigs/bench-1/stop").status_code == 200
        wait_for(lambda: run_id in [act["run_id"] for act in aborted(page)], "entry in the trail")


def aborted(page: httpx.Client) -> list[dict]:
    """What the trail has of aborted runs."""
    return page.get("/api/trail", params={"what": "aborted"}).raise_for_status().json()["entries"]


def test_pause_and_resume_reach_the_bench(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    with agent_at(centre.bench_url, spool, rig):
        run_id = measuring(page)
        assert page.post(f"/api/runs/{run_id}/pause").status_code == 200
        wait_for(lambda: run_of(page, run_id)["status"] == "paused", "pause")
        assert page.post(f"/api/runs/{run_id}/resume").status_code == 200
        wait_for(lambda: run_of(page, run_id)["status"] == "running", "resumption")
        assert page.post(f"/api/runs/{run_id}/abort").status_code == 200
        assert ended(page, run_id)["status"] == "aborted"


def test_an_interrupted_run_is_taken_up_again_from_the_centre(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path
) -> None:
    plan = {**QUICK, "sweeps": 40}
    with agent_at(centre.bench_url, spool, rig):
        run_id = started(page, plan=plan)
        wait_for(lambda: run_of(page, run_id)["progress"]["poses_done"] >= 2, "poses")
    left = wait_for(lambda: (r := run_of(page, run_id))["status"] == "interrupted" and r, "interruption")
    with agent_at(centre.bench_url, spool, rig):
        wait_for(lambda: page.post(f"/api/runs/{run_id}/resume").status_code == 200, "bench that is there")
        done = wait_for(lambda: (r := run_of(page, run_id))["status"] == "completed" and r, "end")
    assert done["started_at"] == left["started_at"]
    assert done["faults"]["interrupted"] == 1
    assert [pose["pass"] for pose in page.get(f"/api/runs/{run_id}/poses").json()] == [
        sweep for sweep in range(40) for _ in range(3)
    ]


def test_what_a_bench_did_alone_is_there_once_it_is_back(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    with agent_at(cable.url, spool, rig) as agent:
        cable.cut()
        from calrig.plan import Plan

        run = agent.service.start(unit="AS-8", plan=Plan.model_validate(QUICK), operator="mara")
        assert agent.service.wait(run.id).status == "completed"
        cable.mend()
        wait_for(lambda: page.get(f"/api/runs/{run.id}").status_code == 200, "run")
        there = ended(page, run.id)
    assert (there["status"], there["operator"], there["rig"]) == ("completed", "mara", "bench-1")
    assert len(page.get(f"/api/runs/{run.id}/poses").json()) == 6
    assert len(page.get("/api/units/AS-8/calibrations").json()) == 1
    assert json.loads(page.get("/api/runs?unit=AS-8").text)["items"][0]["id"] == run.id


def test_a_bench_that_is_away_is_stopped_when_it_is_back(
    page: httpx.Client, centre: HandWritten, rig: Rig, spool: Path, cable: Cable
) -> None:
    with agent_at(cable.url, spool, rig) as agent:
        run_id = measuring(page)
        cable.cut()
        refused = page.post("/api/rigs/bench-1/stop")
        assert refused.status_code == 409
        assert "last seen" in refused.json()["detail"] and "the stop stays" in refused.json()["detail"]
        assert agent.service.run(run_id).status == "running"
        assert page.get("/api/rigs").json()[0]["stop_asked_at"] is not None
        cable.mend()
        assert ended(page, run_id)["status"] == "aborted"
        wait_for(lambda: page.get("/api/rigs").json()[0]["stop_asked_at"] is None, "answer")
    assert rig.stands()
