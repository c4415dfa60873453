"""One run over damaged wires, and what became of it by the simulator's physics, not by what calrig says."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.estimation.angles import wrap_deg
from calrig.instruments.clock import WALL, Clock
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig
from calrig.simulator.sketch_board import SketchBoard
from calrig.store import RawSamples, Run, Store, StoredPose

from .proxy import Proxy
from .proxy_damage import TO_HOST, Damage, Fault
from .proxy_virtual import VirtualProxy

LIMITS_DEG = (-60.0, 60.0)
HUNG_S = 90.0
STANDS_DPS = 1e-6
TIME_SCALE = 20.0
READING_FLOOR_DEG = 0.02
"""Of a standard error: what the filter has yet to forget of a move, half a second after it."""
STAGE_DEG = 0.02
"""What two reads that agree, and a stepper's step, leave."""
PLAN: dict[str, Any] = {"elevations_deg": [-35, -5, 30], "sweeps": 2, "settle_s": 0.5, "dwell_s": 1.0}
IN_REAL_TIME: dict[str, Any] = {**PLAN, "settle_s": 1.5, "dwell_s": 2.0, "sweeps": 1}
"""Longer than a busy machine keeps the simulated text board from printing."""
RIG: dict[str, Any] = {
    "mount": {"offset_deg": 0.8},
    "imu": {"gyro_bias_dps": [1.4, -0.6, 0.3]},
}
STAGE = {"velocity_dps": 60.0, "acceleration_dps2": 240.0, "homing_velocity_dps": 30.0}
MOTION = {
    "smc100": re.compile(rb"\d+(?:PA([-+\d.]+)|OR)\r\n"),
    "esp301": re.compile(rb"\d(?:PA([-+\d.]+)|OR)\r"),
    "grbl": re.compile(rb"(?:G[01] ?[X-Z]([-+\d.]+).*|\$H)\n"),
    "zaber": re.compile(rb"/1 1 \d+ (?:move abs ([-\d]+)|home)\b.*\n"),
}
STOP = {
    "smc100": re.compile(rb"\d+ST\r\n"),
    "esp301": re.compile(rb"\dST\r"),
    "grbl": re.compile(rb"!"),
    "zaber": re.compile(rb"/1 1 stop\n"),
}
MICROSTEPS_PER_DEG = 6400.0


@dataclass(frozen=True)
class Case:
    """One run to try: the dialect of its stage, the wire that is damaged, how, and the seed of the damage."""

    name: str
    stage: str
    wire: str
    fault: Fault | None
    seed: int
    sketch: str | None = None
    sweeps: int = 2

    def __str__(self) -> str:
        fault = self.fault
        how = "whole" if fault is None else f"{fault.kind} {fault.direction} {fault.size:g}"
        return f"{self.name}: {how}, wire of the {self.wire}, {self.stage}, board {self.sketch or 'calrig'}"


@dataclass
class Outcome:
    """What became of a run; each list holds a line for each thing that may not be."""

    case: Case
    status: str = "hung"
    error: str | None = None
    faults: dict[str, int] = field(default_factory=dict)
    lasted_s: float = 0.0
    damaged: int = 0
    worst_sigma: float = 0.0
    honest: bool = False
    wrong: list[str] = field(default_factory=list)
    without_reason: list[str] = field(default_factory=list)
    left_moving: list[str] = field(default_factory=list)
    hung: list[str] = field(default_factory=list)
    uncounted: list[str] = field(default_factory=list)
    beyond: list[str] = field(default_factory=list)


class Sensed:
    """Everything that the sensor truly measured on a bench, each sample with the instant it was taken at."""

    def __init__(self, bench: Bench) -> None:
        self._at_s: dict[bytes, float] = {}
        measured = bench.counts

        def counts(times_s: Any, rate_hz: float = 200.0) -> Any:
            taken = measured(times_s, rate_hz)
            self._at_s.update(zip((row.tobytes() for row in taken.astype("<i2")), times_s, strict=True))
            return taken

        bench.counts = counts  # type: ignore[method-assign]

    def times_s(self, samples: RawSamples) -> list[float | None]:
        """When each sample was taken; None for one that the sensor never measured."""
        columns = (
            samples.accel_g * (32768 / 2),
            (samples.temperature_c[:, None] - 36.53) * 340,
            samples.gyro_dps * (32768 / 250),
        )
        rows = np.rint(np.hstack(columns)).astype("<i2")
        return [self._at_s.get(row.tobytes()) for row in rows]


def try_case(case: Case, store: Store, folder: Path, virtual: VirtualClock | None = None) -> Outcome:
    """Carries out one run over the damaged wire and judges it: over terminals, or in virtual time."""
    outcome = Outcome(case)
    clock = WALL if virtual is None else virtual
    scale = 1.0 if case.sketch else TIME_SCALE
    options = {
        **RIG,
        "seed": case.seed,
        "time_scale": scale,
        "stage": {"driver": case.stage, **STAGE},
        "board": {"sketch": case.sketch},
    }
    with ExitStack() as stack:
        made = SimulatorSettings.from_options(options)
        rig = SimulatedRig(made) if virtual is None else virtual_rig(made, virtual)
        sensed = Sensed(rig.bench)
        proxies = {
            wire: stack.enter_context(_proxy(case, wire, rig, folder, virtual)) for wire in ("stage", "board")
        }
        settings = RigSettings(
            name="bench-1",
            limits_deg=LIMITS_DEG,
            stage=StageSettings(driver=case.stage, port=proxies["stage"].port),
            imu=BoardSettings(driver=rig.imu_driver, port=proxies["board"].port),
            reference=ReferenceSettings(std_deg=0.29),
        )
        service = stack.enter_context(closing(RunService(store, [settings])))
        began_s = clock.now_s()
        chosen = Plan.model_validate({**PLAN, "sweeps": case.sweeps} if case.sketch is None else IN_REAL_TIME)
        run = service.wait(service.start(unit="AS-1", plan=chosen).id, HUNG_S)
        outcome.lasted_s = clock.now_s() - began_s
        _settle(proxies["stage"], clock)
        _judge(outcome, run, rig, proxies, store, sensed)
    return outcome


@contextmanager
def _proxy(
    case: Case, wire: str, rig: SimulatedRig, folder: Path, virtual: VirtualClock | None
) -> Iterator[Proxy | VirtualProxy]:
    """A rig's wire with the proxy in it."""
    damage = _damage(case, wire, rig, time.monotonic if virtual is None else virtual.now_s)
    proxy: Proxy | VirtualProxy
    with ExitStack() as stack:
        if virtual is None:
            straight = rig.stage_wire if wire == "stage" else rig.board_wire
            straight.start()
            stack.callback(straight.stop)
            proxy = Proxy(straight.url, folder / f"{case.name}-{wire}", damage, case.seed)
        else:
            device = rig.stage if wire == "stage" else rig.board
            proxy = VirtualProxy(device, wire, virtual, damage, case.seed)
            proxy.start()
        stack.callback(proxy.stop)
        yield proxy


def _settle(proxy: Proxy | VirtualProxy, clock: Clock) -> None:
    """Until nothing is on its way to the stage any more."""
    give_up_s = clock.now_s() + 10.0
    while not proxy.quiet and clock.now_s() < give_up_s:
        clock.sleep(0.01)


def _damage(case: Case, wire: str, rig: SimulatedRig, now_s: Callable[[], float]) -> Damage:
    device = rig.stage if wire == "stage" else rig.board

    def happens(what: str) -> None:
        if what == "reset" and not isinstance(device, SketchBoard):
            device.reset()
        else:
            device.fault = {"reset": "reset", "freeze": "frozen", "thaw": None}[what]

    packets = wire == "board" and case.sketch is None
    return Damage(case.fault if wire == case.wire else None, packets=packets, device=happens, now_s=now_s)


def _judge(
    outcome: Outcome,
    run: Run,
    rig: SimulatedRig,
    proxies: dict[str, Proxy | VirtualProxy],
    store: Store,
    sensed: Sensed,
) -> None:
    outcome.status, outcome.error, outcome.faults = run.status, run.error, dict(run.faults)
    case, damaged = outcome.case, proxies[outcome.case.wire]
    outcome.damaged = sum(damaged.done.values())
    if run.finished_at is None:
        outcome.hung.append(f"{run.status} after {HUNG_S:g} s, progress {run.progress}")
    elif run.status != "completed" and not (run.status == "failed" and _is_reason(run.error)):
        outcome.without_reason.append(f"{run.status}: {run.error}")
    for stored in store.poses.of(run.id):
        _judge_pose(outcome, stored, run, rig, store, sensed)
    _judge_stop(outcome, rig, proxies["stage"])
    _judge_commands(outcome, proxies["stage"])
    shown = case.fault is not None and case.fault.kind not in ("delay", "cut", "stall") and not case.sketch
    if shown and run.status == "completed" and damaged.done[TO_HOST] >= 5 and not any(run.faults.values()):
        outcome.uncounted.append(f"{damaged.done[TO_HOST]} damaged pieces and no fault on the run")


def _is_reason(error: str | None) -> bool:
    return bool(error) and "internal error" not in str(error)


def _judge_pose(
    outcome: Outcome, stored: StoredPose, run: Run, rig: SimulatedRig, store: Store, sensed: Sensed
) -> None:
    pose, name = stored.pose, f"pose {stored.index}"
    if outcome.case.sketch is not None:
        _judge_by_stage(outcome, name, stored)
        return
    times_s = sensed.times_s(store.samples.of(run.id, stored.index))
    if None in times_s:
        outcome.wrong.append(f"{name}: {times_s.count(None)} samples that the sensor never measured")
        return
    taken_s = np.array(times_s, dtype=float)
    if (np.diff(taken_s) <= 0).any():
        outcome.wrong.append(f"{name}: a sample twice, or out of its order")
    with rig.bench.lock:
        true_deg = rig.bench.sensor(taken_s).angle_deg.mean()
        table = rig.bench.mechanics.table(taken_s)
        before = rig.bench.mechanics.table(np.arange(0.0, taken_s[0], 0.005))
    off_deg = wrap_deg(pose.reading_deg - true_deg)
    stderr_deg = max(pose.reading_stderr_deg or 0.0, READING_FLOOR_DEG)
    outcome.worst_sigma = max(outcome.worst_sigma, abs(off_deg) / stderr_deg)
    if abs(off_deg) > 6 * stderr_deg:
        outcome.wrong.append(f"{name}: reading off by {off_deg:.3f}°, standard error {stderr_deg:.3f}°")
    if pose.stage_deg is None or abs(pose.stage_deg - table.angle_deg.mean()) > STAGE_DEG:
        outcome.wrong.append(f"{name}: stage_deg {pose.stage_deg}, truly {table.angle_deg.mean():.3f}°")
    elif abs(pose.stage_deg - pose.target_deg) > 0.3:
        outcome.wrong.append(f"{name}: at {pose.stage_deg:g}° for {pose.target_deg:g}°")
    turning = np.sign(before.rate_dps[np.abs(before.rate_dps) > STANDS_DPS])
    if pose.approach and len(turning) and pose.approach != turning[-1]:
        outcome.wrong.append(f"{name}: approach {pose.approach}, truly {turning[-1]:.0f}")


def _judge_by_stage(outcome: Outcome, name: str, stored: StoredPose) -> None:
    """A sketch's text cannot be matched with registers; its stage is on a whole wire and tells the truth."""
    pose = stored.pose
    assert pose.stage_deg is not None
    off_deg = wrap_deg(pose.reading_deg - pose.stage_deg - RIG["mount"]["offset_deg"])
    stderr_deg = max(pose.reading_stderr_deg or 0.0, READING_FLOOR_DEG)
    outcome.worst_sigma = max(outcome.worst_sigma, abs(off_deg) / stderr_deg)
    if abs(off_deg) > 6 * stderr_deg:
        outcome.wrong.append(f"{name}: reading off by {off_deg:.3f}°, standard error {stderr_deg:.3f}°")


def _judge_stop(outcome: Outcome, rig: SimulatedRig, proxy: Proxy | VirtualProxy) -> None:
    """After the end nothing moves, nor will: nothing is on its way to the stage that would make it."""
    with rig.bench.lock:
        now_s = rig.clock()
        turns = np.abs(rig.bench.mechanics.table(np.arange(now_s, now_s + 200.0, 0.05)).rate_dps)
    written = b"".join(data for _, data in proxy.sent)
    motions = [found.end() for found in MOTION[outcome.case.stage].finditer(written)]
    told = not motions or STOP[outcome.case.stage].search(written, motions[-1]) is not None
    warned = "cut its motor power" in (outcome.error or "")
    outcome.honest = warned
    if turns.max() > STANDS_DPS and not warned:
        outcome.left_moving.append("it moves after the run's end")
    elif not told and not warned:
        outcome.left_moving.append("it was not told to stop after its last motion")


def _judge_commands(outcome: Outcome, proxy: Proxy | VirtualProxy) -> None:
    written = b"".join(data for _, data in proxy.sent)
    for found in MOTION[outcome.case.stage].finditer(written):
        if found[1] is None:
            continue
        target_deg = float(found[1]) / (MICROSTEPS_PER_DEG if outcome.case.stage == "zaber" else 1.0)
        if not LIMITS_DEG[0] <= target_deg <= LIMITS_DEG[1]:
            outcome.beyond.append(f"{found[0]!r} was sent")
