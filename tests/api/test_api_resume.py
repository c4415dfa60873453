"""An interrupted run at the API: resumed, told where its stage stands, or ended."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from command_line import calrig, reason
from support import after_commits, ended, fast, known_as, running_service, serving
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.plan import Plan
from calrig.runs.run_queue import mark_interrupted
from calrig.simulator.rig import SimulatedRig

PLAN: dict[str, Any] = {"elevations_deg": [-60, 60], "sweeps": 2, "settle_s": 0.5, "dwell_s": 1.0}
OFFSET_DEG = 0.8
"""The mount's, in `support.FAST`."""


@dataclass(frozen=True)
class Killed:
    """A service after the one before it was killed while the table of its rig was on its way.

    Attributes:
        client: of the service.
        service: itself.
        run_id: of the run that was killed.
        stands_deg: where the table truly stands since.
        simulated: the rig.
    """

    client: httpx.Client
    service: Any
    run_id: str
    stands_deg: float
    simulated: SimulatedRig

    @property
    def path(self) -> str:
        return f"/api/runs/{self.run_id}"

    @property
    def remembered_deg(self) -> float | None:
        left_deg: float | None = self.service.store.positions.of("stepper").stage_deg
        return left_deg

    def table_deg(self) -> float:
        return table(self.simulated)[0]

    def is_at_rest(self) -> bool:
        """Whether the table stands where the kill left it."""
        return self.table_deg() == pytest.approx(self.stands_deg, abs=0.01)

    def resume(self, **body: Any) -> dict[str, Any]:
        """Resumes the run, and gives it once it has ended or is interrupted again."""
        self.simulated.stage.reset()  # as opening its port resets it, wherever the table is
        self.client.post(f"{self.path}/resume", json=body).raise_for_status()
        run: dict[str, Any] = ended(self.client, self.run_id)
        return run


def killed_in_a_move(store_path: Path, **stage: Any) -> Iterator[Killed]:
    clock = VirtualClock()
    options = fast({"stage": {"driver": "grbl", **stage}, "mechanics": {"power_up_deg": 0.0}})
    with virtual_rig(options, clock) as simulated:
        rig = known_as("stepper", simulated)
        with clock.taking_part(), running_service(store_path, rig) as service:
            run = service.start(unit="AS-1", plan=Plan.model_validate(PLAN))
            clock.until(after_commits(lambda: service.store.poses.count(run.id) == 2, clock), "two poses")
            clock.until(lambda: abs(table(simulated)[1]) > 5.0, "move")
        with running_service(store_path, rig) as service:  # over the store as a killed program leaves it
            service.store.runs.update(run.id, status="running", error=None)
            if service.store.positions.of("stepper") is not None:
                service.store.positions.save("stepper", None)
            assert mark_interrupted(service.store, {}) == [run.id]
            with serving(service) as client:
                yield Killed(client, service, run.id, table(simulated)[0], simulated)


def table(simulated: SimulatedRig) -> tuple[float, float]:
    """Angle and rate of the table now, degrees and degrees per second."""
    with simulated.bench.lock:
        now = simulated.bench.mechanics.table(np.array([simulated.clock()]))
    return float(now.angle_deg[0]), float(now.rate_dps[0])


@pytest.fixture
def killed(store_path: Path) -> Iterator[Killed]:
    """On a stepper without a switch."""
    yield from killed_in_a_move(store_path, homing=False)


@pytest.fixture
def killed_with_a_switch(store_path: Path) -> Iterator[Killed]:
    yield from killed_in_a_move(store_path, homing=True)


def test_it_says_what_it_needs_and_goes_on_once_it_is_told_right(killed: Killed) -> None:
    left = killed.client.get(killed.path).json()
    assert left["status"] == "interrupted"
    asks = f"`calrig resume {killed.run_id} --stage-at DEGREES`"
    assert asks in left["error"], "said before anybody tries"
    poses_before = left["progress"]["poses_done"]

    untold = killed.resume()
    assert untold["status"] == "interrupted"
    assert "nothing was moved" in untold["error"]
    assert asks in untold["error"]

    wrong = killed.resume(stage_at_deg=killed.stands_deg + 40.0)
    assert wrong["status"] == "interrupted"
    assert "gravity says" in wrong["error"] and asks in wrong["error"]
    assert killed.remembered_deg is None, "as it was"
    assert killed.is_at_rest()

    right = killed.resume(stage_at_deg=killed.stands_deg)
    assert (right["status"], right["error"]) == ("completed", None)
    assert right["progress"]["poses_done"] == 4 > poses_before
    assert right["result"]["bias_deg"] == pytest.approx(OFFSET_DEG, abs=0.1)
    assert killed.remembered_deg == pytest.approx(killed.table_deg(), abs=0.05)


def test_a_wrong_word_leaves_a_place_that_is_remembered(killed: Killed) -> None:
    killed.service.store.positions.save("stepper", killed.stands_deg)
    assert killed.resume(stage_at_deg=killed.stands_deg - 40.0)["status"] == "interrupted"
    assert killed.remembered_deg == killed.stands_deg
    killed.simulated.stage.reset()
    body = {"unit": "AS-1", "plan": PLAN, "stage_at_deg": killed.stands_deg + 40.0}
    refused = killed.client.post("/api/runs", json=body).raise_for_status().json()
    assert ended(killed.client, refused["id"])["status"] == "failed"
    assert killed.remembered_deg == killed.stands_deg
    assert killed.is_at_rest()
    assert killed.resume()["status"] == "completed", "with nothing said, by what is remembered"


def test_a_word_a_little_off_is_found_out_at_the_last_pose_and_asked_for_again(killed: Killed) -> None:
    """Gravity allows ten degrees; the unit's own reading before the interruption does not."""
    off = killed.resume(stage_at_deg=killed.stands_deg + 3.0)
    assert off["status"] == "interrupted"
    assert "across the interruption" in off["error"]
    assert f"`calrig resume {killed.run_id} --stage-at DEGREES`" in off["error"]
    assert killed.remembered_deg is None
    assert killed.resume(stage_at_deg=killed.table_deg())["status"] == "completed"


def test_with_homing_nobody_says_where_the_stage_stands(killed_with_a_switch: Killed) -> None:
    killed = killed_with_a_switch
    assert "--stage-at" not in killed.client.get(killed.path).json()["error"]
    answer = killed.client.post(f"{killed.path}/resume", json={"stage_at_deg": 0.0})
    assert answer.status_code == 422
    assert "has homing" in answer.json()["detail"]
    assert answer.headers["Calrig-Fields"] == "stage_at_deg"
    assert killed.client.get(killed.path).json()["status"] == "interrupted"
    killed.simulated.stage.reset()
    assert killed.client.post(f"{killed.path}/resume").json()["status"] in ("queued", "running")  # no body
    assert ended(killed.client, killed.run_id)["status"] == "completed"


def test_a_word_that_is_none_is_refused(killed: Killed) -> None:
    for wrong in ({"stage_at_deg": 361}, {"stage_at_deg": "up"}, {"stage_at": 3}):
        assert killed.client.post(f"{killed.path}/resume", json=wrong).status_code == 422, wrong
        assert killed.client.get(killed.path).json()["status"] == "interrupted", wrong


def test_it_can_be_ended_instead_and_then_takes_no_word(killed: Killed) -> None:
    assert killed.client.post(f"{killed.path}/abort").raise_for_status().json()["status"] == "aborted"
    answer = killed.client.post(f"{killed.path}/resume", json={"stage_at_deg": killed.stands_deg})
    assert answer.status_code == 409
    assert "is aborted" in answer.json()["detail"]
    assert killed.remembered_deg is None


def test_it_is_resumed_from_the_terminal(killed: Killed) -> None:
    killed.simulated.stage.reset()
    to_service = (killed.run_id, "--server", str(killed.client.base_url))
    said = reason("resume", *to_service, status=1)
    assert said.count("calrig resume") == 1, "one way on, the one that works"
    killed.simulated.stage.reset()
    done = calrig("resume", *to_service, "--stage-at", f"{killed.stands_deg:.2f}", "--json")
    assert json.loads(done.stdout)["status"] == "completed"


def test_the_terminal_refuses_a_place_for_a_stage_with_homing(killed_with_a_switch: Killed) -> None:
    killed = killed_with_a_switch
    to_service = (killed.run_id, "--server", str(killed.client.base_url))
    assert "has homing" in reason("resume", *to_service, "--stage-at", "3", status=2)
    assert "--stage-at" in calrig("resume", *to_service, "--stage-at", "400", status=2).stderr
