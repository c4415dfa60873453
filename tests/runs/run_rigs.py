"""A rig whose truth the tests can look at while a service runs it over its ports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from support import after_commits, fast, known_as
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.analysis.diagnoses import Diagnoses
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.store import Event, Run, Store

STANDS_DPS = 1e-6
STOPPED_S = 0.1
"""How soon after the request the table must stand, s of the rig's clock (issue 2, item 3)."""
T = TypeVar("T")
CLOCK = VirtualClock()
"""The time of all rigs of this folder. The test's thread takes part: time stands unless the test waits."""


def diagnosed(store: Store, run_id: str, *more: str) -> dict[str, Any]:
    """A run's diagnosis, with more runs of its unit, kept with it."""
    diagnoses = Diagnoses(store)
    return diagnoses.keep(run_id, diagnoses.question(run_id, more)())


def plan(**given: Any) -> Plan:
    """A quick plan: three elevations once, in less than a second on a rig twenty times faster than life."""
    return Plan.model_validate(
        {"elevations_deg": [-30, 0, 30], "sweeps": 1, "settle_s": 0.5, "dwell_s": 1.0, **given}
    )


ENDLESS = plan(elevations_deg=[-80, 80], sweeps=100, velocity_dps=10, settle_s=2.0, dwell_s=4.0)
"""Long slow moves and long dwells, which no test waits for the end of."""


class TruthRig:
    """A simulated rig in virtual time, with the settings that a service knows it by.

    Options are the simulator's, over those of `support.FAST`.
    """

    def __init__(self, name: str = "bench-1", **options: Any) -> None:
        self.simulated = virtual_rig(fast(options), CLOCK)
        self.time_scale = self.simulated.settings.time_scale
        self.settings = known_as(name, self.simulated)

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self.simulated.clock()

    def table_dps(self, from_s: float, to_s: float, step_s: float = 0.002) -> np.ndarray:
        """How fast the table truly turned, every `step_s` of simulated time."""
        with self.simulated.bench.lock:
            return self.simulated.bench.mechanics.table(np.arange(from_s, to_s, step_s)).rate_dps

    def table_deg(self, at_s: float) -> float:
        """Where the table truly is."""
        with self.simulated.bench.lock:
            return float(self.simulated.bench.mechanics.table(np.array([at_s])).angle_deg[0])

    def moves(self) -> bool:
        """Whether the table turns at this moment."""
        now_s = self.now_s
        return bool(abs(self.table_dps(now_s, now_s + 0.001)[0]) > STANDS_DPS)

    def stands_for_good(self) -> bool:
        """Whether the table stands now and nothing that was commanded will move it."""
        now_s = self.now_s
        return bool(np.abs(self.table_dps(now_s, now_s + 200.0, 0.05)).max() <= STANDS_DPS)

    def stood_after_s(self, request_s: float) -> float:
        """Seconds of the clock from an instant of simulated time to when the table stood for good."""
        rates = np.abs(self.table_dps(request_s, request_s + 60.0))
        turning = np.flatnonzero(rates > STANDS_DPS)
        return 0.0 if not len(turning) else 0.002 * (turning[-1] + 1) / self.time_scale

    def has_moved(self) -> bool:
        """Whether the table has turned since it was switched on."""
        return bool(np.abs(self.table_dps(0.0, self.now_s + 0.01, 0.01)).max() > STANDS_DPS)


def until(look: Callable[[], T | None], what: str, deadline_s: float = 15.0) -> T:
    """Lets time run to the first instant at which there is something; fails, saying what was awaited."""
    return CLOCK.until(look, what, deadline_s)


def until_written(look: Callable[[], T | None], what: str, deadline_s: float = 15.0) -> T:
    """As `until`, for what is seen in the store: a look comes at the instant after each commit."""
    return CLOCK.until(after_commits(look, CLOCK), what, deadline_s)


def until_stored(store: Store, run: Run, n_poses: int, deadline_s: float = 60.0) -> None:
    """Let time run until so many poses are stored, looking ten times a second: a look is a query."""
    give_up_s = CLOCK.now_s() + deadline_s
    while store.poses.count(run.id) < n_poses:
        assert CLOCK.now_s() < give_up_s, f"no {n_poses} poses within {deadline_s:g} s"
        CLOCK.sleep(0.1)


def pass_time(bench: TruthRig, duration_s: float) -> None:
    """Lets so much simulated time go by."""
    CLOCK.sleep(duration_s / bench.time_scale)


def events(store: Store, run: Run, kind: str | None = None) -> list[Event]:
    """The run's events, of one type or all."""
    return [e for e in store.events.after(run.id, 0, 100_000) if kind in (None, e.type)]


def states(store: Store, run: Run) -> list[str]:
    """The states that the run announced, in order."""
    return [event.data["status"] for event in events(store, run, "state")]


def begin(service: RunService, chosen: Plan = ENDLESS, unit: str = "AS-1", rig: str | None = None) -> Run:
    return service.start(unit=unit, plan=chosen, rig=rig)


def moving(bench: TruthRig, service: RunService, run: Run) -> None:
    """Until the table is on its way to a pose: past homing, and in the midst of a long move."""
    until_written(lambda: service.run(run.id).status == "running", "begin")
    until(lambda: abs(bench.table_deg(bench.now_s)) > 10, "move")
    assert bench.moves()


def homing(bench: TruthRig, service: RunService, run: Run) -> None:
    """Until the table looks for its reference."""
    until(bench.moves, "homing")
    assert bench.simulated.stage.state in (0x1E, 0x1F)


def dwelling(bench: TruthRig, service: RunService, run: Run) -> None:
    """Until the second dwell has begun."""
    until_written(lambda: service.run(run.id).progress.poses_done >= 1, "first pose", 30)
    until(lambda: not bench.moves(), "dwell")


def paused(bench: TruthRig, service: RunService, run: Run) -> None:
    """Until the run holds."""
    service.pause(run.id)
    until_written(lambda: service.run(run.id).status == "paused", "pause", 30)
