"""The tables of `calrig/docs/validation/plans.md`: `python -m tests.studies.plans [TABLE] [--runs N]`.

`suspects` diagnoses 20 runs of each cell, a second of processor time each; `rigs` and `found` carry plans out
on simulated rigs over their ports, three minutes and a quarter of an hour; `times` and `coverage` take half a
minute.
"""

from __future__ import annotations

import argparse
import sys
from itertools import product

import numpy as np

from calrig.calibration.plan_design.design import limit_s, quickest
from calrig.calibration.plan_design.design_problem import Goals
from calrig.calibration.plan_design.layout import layout
from calrig.calibration.plan_design.smallest_effects import imagined_dwells, suspects
from calrig.calibration.uncertainty.budget import Reference
from calrig.plan import Plan
from calrig.runs.plan_designs import Designed
from tests.studies.blind import causes
from tests.studies.blind.layout import Layout, timeline

from . import coverage, rig_runs, trial

REFERENCES = {"a map of 0.003°": Reference(0.003, "harmonic", "normal"), "0.29°, ± 0.5°": Reference(0.29)}
RUNS = 500
BIAS_GOAL = 0.25
"""Standard error of a bias, in scatters of a reading."""


def times() -> None:
    """Stage time of the fixed plan and of designed ones, and what 500 runs of each state and cover."""
    _say("| reference | plan | poses | stage time, s | of the fixed | × limit | U stated, ° | inside |")
    _say("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for words, reference in REFERENCES.items():
        fixed = trial.fixed()
        fixed_s, known = trial.stage_time_s(fixed), trial.kept(fixed, reference, RUNS)
        _row(words, "fixed", 52, fixed_s, 1.0, None, known)
        for name, goals in _goals(reference, fixed).items():
            for trace, sweeping in ((True, True), (True, False), (False, True), (False, False)):
                task = trial.task(reference, trace=trace, sweeping=sweeping)
                design = quickest(task, goals)
                if sweeping and design.sweep is None:
                    continue  # the same follows
                said = f"{name}{', traced' if trace else ''}{', turning' if sweeping else ''}"
                over = design.duration_s / limit_s(task, goals)
                _row(
                    words,
                    said,
                    len(design.elevations_deg),
                    design.duration_s,
                    fixed_s / design.duration_s,
                    over,
                    trial.kept(trial.laid_out(design.elevations_deg, design.dwell_s), reference, RUNS),
                )


def _goals(reference: Reference, fixed: Layout) -> dict[str, Goals]:
    expanded_deg, alike = trial.expected_deg(fixed, reference), trial.standard_errors(fixed)
    return {
        "equal U": Goals(expanded_deg),
        "equal U, bias and scale": Goals(expanded_deg, *alike),
        "three times U": Goals(3.0 * expanded_deg),
    }


def _row(
    words: str, plan: str, n: int, taken_s: float, ratio: float, over: float | None, known: trial.Kept
) -> None:
    limit = "–" if over is None else f"{over:.2f}"
    _say(
        f"| {words} | {plan} | {n} | {taken_s:.0f} | 1/{ratio:.2f} | {limit} "
        f"| {known.stated_deg:.4f} | {100 * known.covered:.1f} % |",
    )


def covered(runs: int, seed: int) -> None:
    """What is inside of what runs state that end as soon as they are good enough."""
    _say("| plan | noise within dwells | target U | ended early | poses | U | bias | scale |")
    _say("| --- | --- | --- | --- | --- | --- | --- | --- |")
    dwells, wanted = (1.0, 0.7, 0.3), (3.0, 2.5, 2.2, 2.0, 1.8)
    plans = (
        ("28 poses, designed", coverage.designed(28), dwells, wanted),
        ("52 poses, fixed", Plan(), dwells, wanted),
        ("65 poses, sweep", coverage.turning(4), (1.0, 0.5), wanted[:-1]),
    )
    for name, plan, shares, targets in plans:
        for share, target in product(shares, targets):
            c = coverage.covered(plan, target, share, runs, seed=seed)
            _say(f"| {name} | {share:g} s | {target:g} s | {_counted(c)} |")
    _say("\n| correlation | goal | ended early | poses | U | bias | scale |")
    _say("| --- | --- | --- | --- | --- | --- | --- |")
    for correlation, (goal, of_bias) in product((0.0, 0.3, 0.6), (("U 2.5 s", False), ("bias", True))):
        times = BIAS_GOAL if of_bias else 2.5
        c = coverage.covered(Plan(), times, 0.5, runs, seed, correlation=correlation, of_bias=of_bias)
        _say(f"| {correlation:g} | {goal} | {_counted(c)} |")


def _counted(c: coverage.Covered) -> str:
    inside = " | ".join(f"{100 * one:.1f} %" for one in (c.elevation, c.bias, c.scale))
    return f"{100 * c.early:.0f} % | {c.poses:.0f} | {inside}"


def found(runs: int) -> None:
    """In how many runs with an effect of the size that is promised four times in five it is found."""
    _say("| plan | backlash | slip of the mount | drift in time |")
    _say("| --- | --- | --- | --- |")
    for name, plan in _plans():
        scatter_deg = trial.PRECISION.scatter_deg(plan.dwell_s)
        said = suspects(imagined_dwells(plan.target_deg.tolist(), plan.dwell_s, trial.PACE), scatter_deg)
        size = {one.name: one.value or 0.0 for one in said}
        drawn = {
            "backlash": causes.backlash(size["backlash"]),
            "mount_slip": causes.slip(size["mount_slip"]),
            "time_drift": causes.drift(size["time_drift"] * timeline(plan).duration_s),
        }
        cells = [f"{trial.found(plan, draw, effect, runs)} of {runs}" for effect, draw in drawn.items()]
        _say(f"| {name} | {' | '.join(cells)} |")


def _plans() -> list[tuple[str, Layout]]:
    made = [("fixed, 52 poses", trial.fixed())]
    for n in (36, 28):
        order = layout((-60.0, 60.0), n, 2, 0.0, np.random.default_rng(1))
        made.append((f"designed, {n} poses", trial.laid_out(order, 2.0)))
    turning = _turning()
    elevations_deg = [pose.target_deg for pose in turning.poses((-90.0, 90.0))]
    stood = trial.laid_out(elevations_deg, turning.dwell_s)
    return [*made, (f"turning, {len(elevations_deg)} poses, stood at", stood)]


def _turning() -> Plan:
    """The traced design of turns for the uncertainty of the fixed plan."""
    reference = REFERENCES["a map of 0.003°"]
    task = trial.task(reference, trace=True, sweeping=True)
    sweep = quickest(task, Goals(trial.expected_deg(trial.fixed(), reference))).sweep
    assert sweep is not None
    return sweep.plan(task.seed).model_copy(update={"settle_s": trial.SETTLE_S})


def rigs(runs: int) -> None:
    """What plans come to on simulated rigs in use, for what the fixed plan is expected to reach there."""
    _say(
        "| plan | poses | s said | s taken | of the fixed | U said, ° | U | bias std said | stated | scale |"
    )
    _say("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for seed in range(runs):
        with rig_runs.bench(seed) as there:
            there.run(Plan())  # which homes the stage: all that follow begin as on a rig in use
            fixed = there.run(Plan())
            _rig_row("fixed", None, fixed, fixed)
            for name in ("equal U", "equal U, bias and scale", "three times U"):
                for sweep in (True, False):
                    alike = there.reached_by(trial.fixed())  # by the noise of the run before, as the design
                    u_deg = alike.expanded_deg or 0.0
                    goals = {"equal U": Goals(u_deg), "three times U": Goals(3.0 * u_deg)}.get(name, alike)
                    made = there.designed(goals, sweep=sweep)
                    _rig_row(f"{name}{', turning' if sweep else ''}", made, there.run(made.plan), fixed)


def _rig_row(name: str, made: Designed | None, run: rig_runs.Carried, fixed: rig_runs.Carried) -> None:
    said = ("–", "–", "–")
    if made is not None:
        of = made.design
        said = f"{of.duration_s:.1f}", f"{of.expanded_deg or 0.0:.4f}", f"{of.bias_std_deg:.4f}"
    found = run.result
    _say(
        f"| {name} | {len(run.poses)} | {said[0]} | {run.took_s:.1f} | 1/{fixed.took_s / run.took_s:.2f} "
        f"| {said[1]} | {found.over_range.expanded_uncertainty_deg:.4f} "
        f"| {said[2]} | {found.bias_std_deg:.4f} | {found.scale_std:.1e} |"
    )


def found_on_rigs(runs: int) -> None:
    """In how many runs an effect is found of the size that the fixed plan finds four times in five."""
    fixed = trial.fixed()
    scatter_deg = trial.PRECISION.scatter_deg(fixed.dwell_s)
    shown = suspects(imagined_dwells(fixed.target_deg.tolist(), fixed.dwell_s, trial.PACE), scatter_deg)
    size = {one.name: one.value or 0.0 for one in shown}
    turning = _turning()
    _say("| plan | backlash | slip of the mount |")
    _say("| --- | --- | --- |")
    for name, plan in (
        ("fixed, 52 poses", Plan()),
        (f"turning, {len(turning.poses((-90.0, 90.0)))} poses", turning),
    ):
        times = [
            sum(rig_runs.finds(plan, seed, effect, size[effect]) for seed in range(runs))
            for effect in ("backlash", "mount_slip")
        ]
        _say(f"| {name} | {' | '.join(f'{n} of {runs}' for n in times)} |")


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """The tables asked for, or all."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.plans", description=__doc__)
    parser.add_argument("table", nargs="?", choices=("times", "coverage", "suspects", "rigs", "found"))
    parser.add_argument("--runs", type=int)
    parser.add_argument("--seed", type=int, default=1, help="of the noise of `coverage`")
    given = parser.parse_args()
    if given.table in (None, "times"):
        times()
    if given.table in (None, "coverage"):
        covered(given.runs or 2000, given.seed)
    if given.table in (None, "suspects"):
        found(given.runs or 20)
    if given.table in (None, "rigs"):
        rigs(given.runs or 1)
    if given.table in (None, "found"):
        found_on_rigs(given.runs or 20)


main()
