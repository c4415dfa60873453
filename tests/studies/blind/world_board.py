"""Runs of the worlds, judged: each is diagnosed blind, held against its truth and against an oracle."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calrig.calibration.diagnosis.tracing import BOOTSTRAPS, diagnose, document
from calrig.calibration.regression.responses import responses_of

from . import oracles
from .board import suspects, words
from .physics import Truth
from .worlds import WORLDS

RESOLVED = 0.75
"""Of a resolution, 1/arc: waves closer than that are one."""


@dataclass(frozen=True)
class WorldJudgement:
    """One run of a world.

    Attributes:
        said: in short.
        found: whether as many effects as there are.
        held: whether each has an effect whose name or set holds it.
        alone: whether each was named, and nothing else said.
        wrong_name: whether an effect is named that is none of them.
        set_excess: names in the sets, an effect, less those in the oracle's; None where one was not held.
        held_out_ratio: error of held-out poses over the oracle's; None where it was not asked for.
        processor_s: that the diagnosis took.
    """

    said: str
    found: bool
    held: bool
    alone: bool
    wrong_name: bool
    set_excess: float | None
    held_out_ratio: float | None
    processor_s: float


class WorldTask(NamedTuple):
    """One run of a world, for a worker."""

    world: str
    cell: str
    seed: int
    cross_fit: bool
    bootstraps: int = BOOTSTRAPS


def judge_world(task: WorldTask) -> WorldJudgement:
    """Measures, diagnoses and judges one run."""
    world = WORLDS[task.world]
    run = world.run(task.cell, task.seed)
    began_s = time.process_time()
    diagnosis = diagnose([run.poses], seed=task.seed, bootstraps=task.bootstraps, cross_fit=task.cross_fit)
    took_s = time.process_time() - began_s
    said = document(diagnosis, [str(task.seed)])
    effects = said["effects"]
    arc_deg = float(np.ptp([pose.theta_deg for pose in run.poses]))
    of_truth = [_holding(truth, effects, arc_deg) for truth in run.truths]
    true = [effect for effect in effects if any(_is(truth, effect, arc_deg) for truth in run.truths)]
    held = all(effect is not None for effect in of_truth)
    excess = ratio = None
    if held and run.truths:
        sizes = [len(suspects(effect)) for effect in of_truth if effect is not None]
        excess = float(np.mean(sizes)) - _oracle_set_size(task, len(sizes))
    if task.cross_fit and run.truths:
        after = said["final"]["held_out_rms_deg"]
        ratio = after / oracles.held_out_rms_deg(diagnosis.findings, run.truths)
    return WorldJudgement(
        said="; ".join(map(words, effects)) or "nothing",
        found=len(effects) >= max(len(run.truths), 1),
        held=held,
        alone=len(effects) == len(run.truths) == len(true) and all(e["verdict"] == "named" for e in effects),
        wrong_name=any(e["verdict"] == "named" and e not in true for e in effects),
        set_excess=excess,
        held_out_ratio=ratio,
        processor_s=took_s,
    )


def judge_world_task(task: WorldTask) -> tuple[WorldTask, WorldJudgement]:
    """The judgement with its task."""
    return task, judge_world(task)


def _oracle_set_size(task: WorldTask, causes: int) -> float:
    """Mean over the causes, each by itself in the same noise: whatever hides it is known to the oracle."""
    sizes = []
    for k in range(causes):
        run = WORLDS[task.world].run(task.cell, task.seed, only=k)
        sizes.append(oracles.set_size(responses_of([run.poses]), run.noise))
    return float(np.mean(sizes))


def _holding(truth: Truth, effects: Iterable[dict[str, Any]], arc_deg: float) -> dict[str, Any] | None:
    """The effect that is the truth, else the one whose set holds it; of a wave at its own period."""
    effects = list(effects)
    named = next((effect for effect in effects if _is(truth, effect, arc_deg)), None)
    if named is not None:
        return named
    return next((e for e in effects if truth.cause.name in e["confusable_with"]), None)


def _is(truth: Truth, effect: Mapping[str, Any], arc_deg: float) -> bool:
    cause = truth.cause
    if effect["name"] != cause.name:
        return False
    if cause.name == "unnamed":
        return bool(effect["covariate"] == cause.covariate)
    period = effect["parameters"].get("period_deg")
    if cause.period_deg is None or period is None:
        return True
    return abs(1.0 / period["value"] - 1.0 / cause.period_deg) < RESOLVED / arc_deg
