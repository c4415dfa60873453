"""The tables of `calrig/docs/plans.md`: `python -m tests.plans [times|coverage|suspects] [--runs N]`.

`suspects` diagnoses 20 runs of each cell, a second of processor time each; the others take half a minute.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from calrig.calibration.plan_design.design import quickest
from calrig.calibration.plan_design.goals import Goals
from calrig.calibration.plan_design.layout import layout
from calrig.calibration.plan_design.limit import limit_s
from calrig.calibration.plan_design.suspects import imagined_dwells, suspects
from calrig.calibration.uncertainty import Reference
from calrig.plan import Plan
from tests.blind import causes
from tests.blind.layout import Layout, timeline

from . import coverage, trial

REFERENCES = {"a map of 0.003°": Reference(0.003, "harmonic", "normal"), "0.29°, ± 0.5°": Reference(0.29)}
RUNS = 500


def times() -> None:
    """Stage time of the fixed plan and of designed ones, and what 500 runs of each state and cover."""
    _say("| reference | plan | poses | stage time, s | of the fixed | × limit | U stated, ° | inside |")
    _say("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for words, reference in REFERENCES.items():
        fixed = trial.fixed()
        fixed_s, known = trial.stage_time_s(fixed), trial.kept(fixed, reference, RUNS)
        _row(words, "fixed", 52, fixed_s, 1.0, None, known)
        for name, goals in _goals(known, fixed).items():
            for trace in (True, False):
                task = trial.task(reference, trace=trace)
                design = quickest(task, goals)
                said = f"{name}{', traced' if trace else ''}"
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


def _goals(known: trial.Kept, fixed: Layout) -> dict[str, Goals]:
    alike = trial.standard_errors(fixed)
    return {
        "equal U": Goals(known.stated_deg),
        "equal U, bias and scale": Goals(known.stated_deg, *alike),
        "three times U": Goals(3.0 * known.stated_deg),
    }


def _row(
    words: str, plan: str, n: int, taken_s: float, ratio: float, over: float | None, known: trial.Kept
) -> None:
    limit = "–" if over is None else f"{over:.2f}"
    _say(
        f"| {words} | {plan} | {n} | {taken_s:.0f} | 1/{ratio:.2f} | {limit} "
        f"| {known.stated_deg:.4f} | {100 * known.covered:.1f} % |",
    )


def covered(runs: int) -> None:
    """What is inside of what runs state that end as soon as they are good enough."""
    _say("| plan | dwell shows | U wanted | ended early | poses | U | bias | scale |")
    _say("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, plan in (("28 designed", coverage.designed(28)), ("52 fixed", Plan())):
        for share in (1.0, 0.7, 0.3):
            for wanted in (4.0, 3.0, 2.5, 2.2, 2.0, 1.8):
                c = coverage.covered(plan, wanted, share, runs, seed=1)
                inside = " | ".join(f"{100 * one:.1f} %" for one in (c.elevation, c.bias, c.scale))
                stopped = f"{100 * c.early:.0f} % | {c.poses:.0f}"
                _say(f"| {name} | {share:g} s | {wanted:g} s | {stopped} | {inside} |")


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
    return made


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """The tables asked for, or all."""
    parser = argparse.ArgumentParser(prog="python -m tests.plans", description=__doc__)
    parser.add_argument("table", nargs="?", choices=("times", "coverage", "suspects"))
    parser.add_argument("--runs", type=int)
    given = parser.parse_args()
    if given.table in (None, "times"):
        times()
    if given.table in (None, "coverage"):
        covered(given.runs or 2000)
    if given.table in (None, "suspects"):
        found(given.runs or 20)


main()
