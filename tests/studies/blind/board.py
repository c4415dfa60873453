"""Runs, judged: each run is diagnosed blind and held against its truth, each cell becomes rates."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from calrig.calibration.diagnosis.tracing import BOOTSTRAPS, diagnose, document

from . import oracles
from .cells import CELLS, Cell
from .peers import PEERS, library
from .physics import Run, Truth

STANDARD_ERRORS = 3.0


@dataclass(frozen=True)
class Judgement:
    """One run. Whether each thing held; None where it does not apply."""

    said: str
    found: bool
    alone: bool | None = None
    held: bool | None = None
    set_size: int | None = None
    oracle_set_size: int | None = None
    origin: bool | None = None
    both: bool | None = None
    nothing_else: bool | None = None
    covariate: bool | None = None
    no_name: bool | None = None
    parameters: bool | None = None
    held_out_ratio: float | None = None
    wrong_name: bool = False
    peers: dict[str, bool] = field(default_factory=dict)


def judge(
    name: str, seed: int, *, bootstraps: int = BOOTSTRAPS, cross_fit: bool = True, peers: bool = True
) -> Judgement:
    """Measures, diagnoses and judges the run of a seed in a cell."""
    cell = CELLS[name]
    run = cell.run(seed)
    diagnosis = diagnose([run.poses], seed=seed, bootstraps=bootstraps, cross_fit=cross_fit)
    said = document(diagnosis, [str(seed)])
    effects = said["effects"]
    true_names = {truth.cause.name for truth in run.truths}
    facts: dict[str, Any] = {
        "said": "; ".join(words(effect) for effect in effects) or "nothing",
        "found": bool(effects),
        "wrong_name": any(e["verdict"] == "named" and e["name"] not in true_names for e in effects),
    }
    if cross_fit and run.truths:
        after = said["final"]["held_out_rms_deg"]
        facts["held_out_ratio"] = after / oracles.held_out_rms_deg(diagnosis.findings, run.truths)
    if cell.kind in ("one", "limit") and effects:
        facts |= _of_one(run.truths[0], effects)
        facts["oracle_set_size"] = oracles.set_size(diagnosis.findings.responses, run.noise)
    if cell.kind == "two":
        facts["both"] = all(any(t.cause.name in suspects(e) for e in effects) for t in run.truths)
        facts["nothing_else"] = all(suspects(e) & true_names for e in effects) and len(effects) <= len(
            run.truths
        )
    if cell.kind == "unnamed":
        facts["covariate"] = any(
            "unnamed" in (e["name"], *e["confusable_with"])
            and e["covariate"] == run.truths[0].cause.covariate
            for e in effects
        )
        facts["no_name"] = all(e["verdict"] != "named" for e in effects)
    if cell.kind != "unnamed" and effects:
        facts["parameters"] = _parameters_hold(run.truths, effects)
    if peers:
        facts["peers"] = _peers(cell, run, true_names)
    return Judgement(**facts)


class Task(NamedTuple):
    """One run of the board, for a worker."""

    cell: str
    seed: int
    cross_fit: bool
    peers: bool


def judge_task(task: Task) -> tuple[str, int, Judgement]:
    """The judgement with the task's cell and seed."""
    return task.cell, task.seed, judge(task.cell, task.seed, cross_fit=task.cross_fit, peers=task.peers)


def _of_one(truth: Truth, effects: list[dict[str, Any]]) -> dict[str, Any]:
    first = effects[0]
    right = truth.cause.name
    return {
        "alone": len(effects) == 1 and first["verdict"] == "named" and first["name"] == right,
        "held": any(right in suspects(effect) for effect in effects),
        "set_size": len(suspects(first)),
        "origin": first["origin"] == truth.cause.origin,
    }


def suspects(effect: dict[str, Any]) -> set[str]:
    """The names that an effect may be."""
    return {effect["name"], *effect["confusable_with"]}


def words(effect: dict[str, Any]) -> str:
    """An effect and what it may be as well, in short."""
    names = [effect["name"], *effect["confusable_with"]]
    covariate = f" {effect['covariate']}" if effect["name"] == "unnamed" else ""
    return "{" + ", ".join(names) + covariate + "}"


def _parameters_hold(truths: list[Truth], effects: list[dict[str, Any]]) -> bool | None:
    """Whether each parameter stated of a right name lies within three standard errors of the truth."""
    held = []
    for effect in effects:
        truth = next((t for t in truths if t.cause.name == effect["name"]), None)
        if truth is None:
            continue
        for name, true in truth.parameters.items():
            stated = effect["parameters"].get(name)
            if stated is not None and stated["std"]:
                held.append(abs(stated["value"] - true) <= STANDARD_ERRORS * stated["std"])
    return all(held) if held else None


def _peers(cell: Cell, run: Run, true_names: set[str]) -> dict[str, bool]:
    """Of noise alone, whether a peer says something; else whether it names what is there and nothing else."""
    residual, columns = library(run.poses)
    if "unnamed" in true_names:
        true_names = {f"unnamed {run.truths[0].cause.covariate}"}
    kept = {name: peer(residual, columns) for name, peer in PEERS.items()}
    return {name: bool(names) if cell.kind == "null" else names == true_names for name, names in kept.items()}


@dataclass(frozen=True)
class Rate:
    """How many of how many."""

    hits: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """95 %: Wilson, Journal of the American Statistical Association 22, 1927."""
        if not self.of:
            return 0.0, 1.0
        z, p = 1.959964, self.hits / self.of
        middle = (p + z * z / (2 * self.of)) / (1 + z * z / self.of)
        half = z / (1 + z * z / self.of) * math.sqrt(p * (1 - p) / self.of + z * z / (4 * self.of**2))
        return max(middle - half, 0.0), min(middle + half, 1.0)

    def __str__(self) -> str:
        if not self.of:
            return ""
        low, high = self.interval
        return f"{100 * self.hits / self.of:.1f} % ({100 * low:.1f}–{100 * high:.1f})"


def rate(judgements: Iterable[Judgement], what: str) -> Rate:
    """Of the runs to which it applies, in how many it held."""
    values = [value for j in judgements if (value := getattr(j, what)) is not None]
    return Rate(sum(values), len(values))


def peer_rate(judgements: Iterable[Judgement], peer: str) -> Rate:
    """The same of a peer."""
    values = [j.peers[peer] for j in judgements if peer in j.peers]
    return Rate(sum(values), len(values))


def mean(judgements: Iterable[Judgement], what: str) -> float | None:
    values = [value for j in judgements if (value := getattr(j, what)) is not None]
    return float(np.mean(values)) if values else None


def median(judgements: Iterable[Judgement], what: str) -> float | None:
    values = [value for j in judgements if (value := getattr(j, what)) is not None]
    return float(np.median(values)) if values else None
