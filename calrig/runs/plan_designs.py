"""Design a plan (CONTRACT section 9) from the request and from what earlier runs of the rig have shown.

Earlier runs give the settling time, the precision of readings, and whether the rig can sweep continuously.
The design itself is pure computation, for a process of its own.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from pydantic import ValidationError

from calrig.analysis.errors import Invalid
from calrig.analysis.stage_maps import kept_of
from calrig.calibration.plan_design import (
    GAIN_ERROR,
    LEAST_S,
    NOT_MEASURED,
    SHARE,
    Design,
    DesignProblem,
    Goals,
    Gyro,
    OutOfReachError,
    Pace,
    Precision,
    Sweeping,
    Turning,
    ended,
    forgotten_s,
    limit_s,
    precision_of_run,
    quickest,
    ring_down_s,
    within,
)
from calrig.calibration.poses import Filtering
from calrig.estimation.angles import AXES
from calrig.estimation.kalman import KalmanNoise
from calrig.model.plan import Plan, Until
from calrig.run_ids import short_name
from calrig.runs.plan_estimates import RigTiming, reference_uncertainty, rig_pace
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document

RUNS_LOOKED_AT = 10
SAMPLES_LOOKED_AT = 200_000
"""A quarter of an hour at 200 Hz: moves enough, and read in some hundredths of a second."""


@dataclass(frozen=True, slots=True)
class Settling:
    """What is known of it.

    Attributes:
        least_s: until the stage is at rest.
        gyro: of the filter that is to forget the moves; None where nothing is known of it.
    """

    least_s: float
    said: str
    gyro: Gyro | None


def settling_of(rig: RigSettings, plan: Plan, store: Store | None) -> Settling:
    """As the gyro showed it in the last run on the rig whose samples are there; else the plan's own."""
    if store is not None:
        runs, _ = store.runs.page(rig=rig.name, status="completed", limit=RUNS_LOOKED_AT)
        for run in runs:
            if not run.voided and (rang_s := _rang_s(store, run)) is not None:
                seen = f"vibration ended {rang_s:.2f} s after the move" if rang_s else "no settling seen"
                said = f"{seen} in run {short_name(run.id)}"
                return Settling(max(LEAST_S, round(rang_s, 2)), said, _gyro(rig, plan, run))
    return Settling(plan.settle_s, "as entered; no run on this rig shows it yet", None)


def _rang_s(store: Store, run: Run) -> float | None:
    plan = run.plan or {}
    if plan.get("kind") not in ("calibration", "verification") or plan.get("target_std_deg"):
        return None
    time_s, rate_dps = [], []
    axis = AXES.index(plan.get("mount_axis", "x")[-1])
    for block in store.samples.blocks_of(run.id):
        time_s.append(np.asarray(block.time_s))
        rate_dps.append(np.asarray(block.gyro_dps)[:, axis])
        if sum(map(len, time_s)) > SAMPLES_LOOKED_AT:
            break
    if not time_s:
        return None
    half_s = 0.5 * plan["dwell_s"]
    dwells = [
        (middle_s - half_s - plan["settle_s"], middle_s - half_s, middle_s + half_s)
        for one in store.poses.of(run.id)
        if (middle_s := one.pose.time_s) is not None
    ]
    return ring_down_s(np.concatenate(time_s), np.concatenate(rate_dps), dwells)


def _gyro(rig: RigSettings, plan: Plan, run: Run) -> Gyro:
    """The rig's filter, and how wrong the gyro was in a run."""
    scale = None if run.result is None else run.result.gyro.scale
    filtering = Filtering(KalmanNoise(**rig.filter.model_dump()), plan.rate_hz)
    return Gyro(filtering, GAIN_ERROR if scale is None else abs(1.0 - scale))


FEWEST_POSES = 8


def precision_of(rig: RigSettings, unit: str, store: Store | None) -> Precision:
    """Of dwells: by the unit's last calibration on the rig, else by the rig's last one."""
    if store is None:
        return NOT_MEASURED
    for serial in [unit, None] if unit else [None]:
        runs, _ = store.runs.page(rig=rig.name, unit=serial, status="completed", limit=RUNS_LOOKED_AT)
        for run in runs:
            dwells = (run.plan or {}).get("kind") == "calibration"
            if dwells and not run.voided and (found := precision_shown(run)) is not None:
                return found
    return NOT_MEASURED


def precision_shown(run: Run) -> Precision | None:
    """By a completed run; None where its dwells had no one length, or its poses are too few."""
    result, plan = run.result, run.plan or {}
    if result is None or plan.get("target_std_deg"):
        return None
    left = result.rms_with_effects_deg or result.rms_calibrated_deg
    n, noise_deg = result.n_poses, result.noise_deg
    if left is None or noise_deg is None or n < FEWEST_POSES:
        return None
    freedom = n - 2
    scatter_deg = left * (n / freedom) ** 0.5
    return precision_of_run(short_name(run.id), plan["dwell_s"], noise_deg, scatter_deg, freedom)


MOST_SWEEPS_READ = 50
REFUSED = "take a plan of dwells"
"""What a sweep ends with that stage, board or motor vibration does not let be (`runs.sweeping`)."""


@dataclass(frozen=True, slots=True)
class MaySweep:
    """`sweeping` where a rig may, else `because`: both None where the plan asks for what no sweep does."""

    sweeping: Sweeping | None = None
    because: str | None = None


def may_sweep(
    rig: RigSettings, plan: Plan, store: Store | None, pace: RigTiming, dwelling: Precision
) -> MaySweep:
    """Unless a sweep of the rig was refused and none has succeeded since, or its board sends no rates.

    `dwelling` says how precise dwells are: stretches too, where no sweep tells.
    """
    if plan.kind not in ("calibration", "sweep") or plan.asks_for_mounts:
        return MaySweep()
    runs = [] if store is None else store.runs.page(rig=rig.name, limit=MOST_SWEEPS_READ)[0]
    if (silent := _without_rates(runs)) is not None:
        return MaySweep(
            because=f"a sweep needs rates, and the board sent none in run {short_name(silent.id)}"
        )
    precision = dwelling
    for run in runs:
        if (run.plan or {}).get("kind") != "sweep" or run.voided:
            continue
        if run.status == "failed" and REFUSED in (run.error or ""):
            return MaySweep(because=f"sweep {short_name(run.id)} was refused: {run.error}")
        if run.status == "completed":
            precision = precision_shown(run) or dwelling
            break
    most_dps = pace.velocity_dps
    if plan.kind != "sweep" and plan.velocity_dps is not None:
        most_dps = min(most_dps, plan.velocity_dps)
    return MaySweep(Sweeping(Turning(most_dps, pace.acceleration_dps2), precision))


def _without_rates(runs: list[Run]) -> Run | None:
    """The last completed run on the rig, if its result knows of no gyro."""
    for run in runs:
        if run.status == "completed" and run.result is not None:
            return run if None in run.result.gyro.bias_dps else None
    return None


@dataclass(frozen=True, slots=True)
class DesignRequest:
    """What somebody asks of a plan: an expanded uncertainty, standard errors, or what a time is worth.

    `until` is what its run is to end at; with `sweep` it may turn without stopping.
    """

    goals: Goals
    time_s: float | None = None
    trace: bool = True
    until: Until | None = None
    sweep: bool = True


@dataclass(frozen=True, slots=True)
class DesignInputs:
    """What is asked and all that is known: `plan` is what it keeps, `task` what the rig can do.

    `no_sweep` is why the rig may not sweep, where a run of it has shown that.
    """

    wanted: DesignRequest
    plan: Plan
    task: DesignProblem
    settling: Settling
    no_sweep: str | None = None


def question(
    wanted: DesignRequest,
    plan: Plan,
    rig: RigSettings,
    unit: str,
    store: Store | None,
    maps: Mapping[str, Document],
) -> DesignInputs:
    """What `plan_answers.answer` needs to design the plan for a rig and a unit.

    `plan` has what is kept: range, rate, velocity, seed, and the settling where none has been measured. The
    noise is that of the last run of `unit` on the rig, else of the last one on it; `store` is None where
    there is none yet, and `maps` are those that files give, by rig.

    Raises:
        Invalid: the plan that is kept has no range.
    """
    if plan.kind == "static":
        raise Invalid("a static log has no poses to be designed", ["plan.kind"])
    low, high = min(plan.elevations()), max(plan.elevations())
    if high - low < 1.0:
        raise Invalid(f"a plan over {high - low:g}° has no scale: give it a range", ["plan.start_deg"])
    settling, pace = settling_of(rig, plan, store), rig_pace(rig, store)
    precision = precision_of(rig, unit, store)
    in_force = maps.get(rig.name) if store is None else kept_of(store, rig.name, maps)
    turns = may_sweep(rig, plan, store, pace, precision) if wanted.sweep else MaySweep()
    task = DesignProblem(
        range_deg=(low, high),
        precision=precision,
        pace=_pace(plan, pace, settling.least_s),
        type_b=reference_uncertainty(rig, unit, plan.elevations(), store, in_force),
        trace=wanted.trace,
        until=wanted.until is not None,
        seed=plan.seed,
        sweeping=turns.sweeping,
    )
    return DesignInputs(wanted, plan, task, settling, turns.because)


def _pace(plan: Plan, known: RigTiming, settle_s: float) -> Pace:
    velocity_dps = None if plan.kind == "sweep" else plan.velocity_dps  # of a sweep, that of its turns
    travel_s = partial(known.travel_s, velocity_dps=velocity_dps)
    return Pace(travel_s, settle_s, known.questions_s, known.begin_s, known.stands_deg, known.pass_s)


SETTLED_AFTER = 4
"""Designs, each with the settling that the moves of the one before ask for."""


@dataclass(frozen=True, slots=True)
class Designed:
    """A plan, what is expected of it, the time that none is under, and what to know of it.

    `whole` is the design, `design` as much of it as a run is expected to take. Of a plan for a time, no plan
    reaches as much in less than `limit_s`.
    """

    plan: Plan
    design: Design
    whole: Design
    limit_s: float
    says: tuple[str, ...]
    may_sweep: bool = False
    for_a_time: bool = False

    def document(self) -> dict[str, Any]:
        """CONTRACT section 9's answer, and `suspects`: what would be found of each."""
        expected = self.design
        return {
            "plan": self.plan.model_dump(mode="json"),
            "expected": {
                "duration_s": expected.duration_s,
                "expanded_uncertainty_deg": expected.expanded_deg,
                "bias_std_deg": expected.bias_std_deg,
                "scale_std": expected.scale_std,
            },
            "limit": {"duration_s": self.limit_s, "why": _why(self)},
            "suspects": [
                {**asdict(one), "rms_deg": one.rms_deg if one.rms_deg < 1e6 else None}
                for one in self.whole.suspects
            ],
            "says": list(self.says),
        }


def answer(asked: DesignInputs, progress: Callable[[float], None] = lambda _: None) -> Designed:
    """The plan that was asked for.

    `progress` is told the share that is done.

    Raises:
        Invalid: it cannot be reached, and why.
    """
    wanted = asked.wanted
    try:
        task, whole = _settled(asked.task, wanted, asked.settling, progress)
    except OutOfReachError as error:
        field = "time_s" if wanted.time_s is not None else "target_u_deg"
        raise Invalid(str(error), [field]) from error
    design = ended(task, wanted.goals, whole)
    made = _plan_of(asked, task, whole)
    least_s = _limit_s(task, wanted, whole)
    says = _says(asked, task, design, whole)
    return Designed(made, design, whole, least_s, says, task.sweeping is not None, wanted.time_s is not None)


def _limit_s(task: DesignProblem, wanted: DesignRequest, design: Design) -> float:
    """The time that no plan for what is wanted is under; for a time, none that reaches as much in less."""
    if wanted.time_s is None:
        return limit_s(task, wanted.goals)
    reached = Goals(design.expanded_deg, design.bias_std_deg, design.scale_std)
    return limit_s(task, reached, must_show=False)


def _plan_of(asked: DesignInputs, task: DesignProblem, design: Design) -> Plan:
    """What is kept, with the design in it."""
    common = {
        **asked.plan.model_dump(),
        "settle_s": task.pace.settle_s,
        "dwell_s": design.dwell_s,
        "target_std_deg": None,
        "until": asked.wanted.until,
    }
    sweep, was_sweep = design.sweep, asked.plan.kind == "sweep"
    if sweep is None:
        of_dwells = {
            "kind": "calibration" if was_sweep else asked.plan.kind,
            "velocity_dps": None if was_sweep else asked.plan.velocity_dps,
            "elevations_deg": list(design.elevations_deg),
            "order": "given",
            "sweeps": 1,
            "jitter_deg": 0.0,
        }
        return _valid({**common, **of_dwells})
    turning = sweep.plan(task.seed).model_dump(exclude_unset=True)
    return _valid({**common, "elevations_deg": None, "order": "sweep", **turning})


def _valid(fields: dict[str, Any]) -> Plan:
    try:
        return Plan.model_validate(fields)
    except ValidationError as error:  # what is kept goes with no such plan
        raise Invalid(error.errors()[0]["msg"].removeprefix("Value error, "), ["plan"]) from error


def _settled(
    task: DesignProblem, wanted: DesignRequest, settling: Settling, progress: Callable[[float], None]
) -> tuple[DesignProblem, Design]:
    """The design that waits long enough for the filter to forget its own moves."""
    for done in range(SETTLED_AFTER):

        def told(share: float, done: int = done) -> None:
            progress((done + share) / SETTLED_AFTER)

        time_s = wanted.time_s
        design = quickest(task, wanted.goals, told) if time_s is None else within(task, time_s)
        if settling.gyro is None:
            return task, design
        pace, order = task.pace, _stops_deg(design)
        moves_s = [pace.travel_s(abs(after - before)) for before, after in pairwise((order[0], *order))]
        wanted_deg = wanted.goals.expanded_deg or 2.0 * task.precision.scatter_deg(design.dwell_s)
        needed_s = forgotten_s(order, moves_s, design.dwell_s, settling.gyro, SHARE * wanted_deg)
        if needed_s <= pace.settle_s:
            return task, design
        task = replace(task, pace=replace(pace, settle_s=needed_s))
    return task, design


def _stops_deg(design: Design) -> tuple[float, ...]:
    """Where it stops, in the order of visiting."""
    if design.sweep is None:
        return design.elevations_deg
    return tuple(pose.target_deg for pose in design.sweep.poses() if pose.stretch_deg is None)


def _why(made: Designed) -> str:
    data = "the data that this plan's uncertainty needs" if made.for_a_time else "the data that are needed"
    if made.may_sweep:
        return f"{data}, taken all of the time and where they say most"
    twice = made.whole.suspects and made.plan.until is None
    ways = "two ways through the range" if twice else "one way through the range"
    return f"{ways}, and dwells at its two ends alone: less time does not hold {data}"


def _says(asked: DesignInputs, task: DesignProblem, design: Design, whole: Design) -> tuple[str, ...]:
    precision = task.sweeping.precision if task.sweeping and whole.sweep else task.precision
    said = [f"{precision.said[0].upper()}{precision.said[1:]}.", *_how_it_moves(asked, task, whole)]
    if task.type_b is None:
        said.append("The rig has no `reference` in calrig.toml, so the expanded uncertainty is unknown.")
    if task.until:
        said.append(
            f"The run ends when it reaches the target: after about {len(design.elevations_deg)} of "
            f"{len(whole.elevations_deg)} poses if readings scatter as before, after "
            f"{whole.duration_s:.0f} s at most."
            + (" Detectable effects are stated for all poses." if task.trace else "")
        )
    shown = [one for one in whole.suspects if one.rms_deg < 1e6]
    if shown:
        least = max(shown, key=lambda one: one.rms_deg)
        said.append(
            f"An effect of {least.rms_deg:.2g}° RMS or more in calibrated readings is detected with a power "
            f"of about 80 %. Hardest to detect: {least.title}."
        )
        said += [f"{one.title}: detected by dwells only." for one in whole.suspects if one not in shown]
    elif not task.trace:
        said.append("Effects are not traced: errors between the two ends stay undetected.")
    return tuple(said)


def _how_it_moves(asked: DesignInputs, task: DesignProblem, whole: Design) -> list[str]:
    waits_s, settling = task.pace.settle_s, asked.settling
    because = "" if waits_s <= settling.least_s else "; the filter needs this time to forget the move"
    waits = f"Settling time after each move {waits_s:g} s: {settling.said}{because}."
    if whole.sweep is not None:
        return [
            f"{whole.sweep.passes} continuous traverses at {whole.sweep.velocity_dps:.3g}°/s. The run is "
            "refused if the motor's vibration biases the accelerometer.",
            waits.replace("each move", "each traverse"),
        ]
    return [waits] if asked.no_sweep is None else [waits, f"No continuous sweep: {asked.no_sweep}."]
