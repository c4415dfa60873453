"""The worlds as one table of Markdown, and what was said in each cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from .board import Rate
from .world_board import WorldJudgement
from .worlds import HARD, NULLS

Judged = Mapping[tuple[str, str], list[WorldJudgement]]
HEADER = (
    "world",
    "runs",
    "found",
    "name or set holds it",
    "named, alone",
    "wrong name",
    "set, beyond the oracle's",
    "held-out RMS over the oracle's",
    "false alarms, white · AR(1) 0.6",
)


def markdown(judged: Judged) -> str:
    """One row a world, its cells together, then the hard ones: counts, of how many."""
    rows = [HEADER, ("---",) * len(HEADER)]
    for world in dict.fromkeys(world for world, _ in judged):
        effects = [
            j
            for (w, cell), js in judged.items()
            if w == world and cell not in NULLS and (w, cell) not in HARD
            for j in js
        ]
        nulls = [
            Rate(sum(j.said != "nothing" for j in js), len(js))
            for (w, cell), js in judged.items()
            if w == world and cell in NULLS
        ]
        rows.append((world, *_rates(effects), " · ".join(f"{null.hits} of {null.of}" for null in nulls)))
    hard = [at for at in judged if at in HARD]
    rows += [(f"{', '.join(at)}: {HARD[at]}", *_rates(judged[at]), "") for at in hard]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _rates(effects: list[WorldJudgement]) -> tuple[str, ...]:
    def count(what: str) -> str:
        return str(sum(getattr(j, what) for j in effects))

    counts = (count(what) for what in ("found", "held", "alone", "wrong_name"))
    return (
        str(len(effects)),
        *counts,
        _mean(j.set_excess for j in effects),
        _median(j.held_out_ratio for j in effects),
    )


def _mean(values: Iterable[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):+.2f}" if known else ""


def _median(values: Iterable[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.median(known):.3f}" if known else ""


def by_cell(judged: Judged) -> str:
    """A line a cell: its counts, and what was said, the commonest first."""
    lines = []
    for (world, cell), js in judged.items():
        said = ", ".join(f"{words} ×{times}" for words, times in Counter(j.said for j in js).most_common(6))
        found, held, wrong = (sum(getattr(j, what) for j in js) for what in ("found", "held", "wrong_name"))
        counts = f"{len(js)} runs, found {found}, held {held}, wrong {wrong}"
        took_s = np.mean([j.processor_s for j in js])
        lines.append(f"{world}, {cell}: {counts}, {took_s:.1f} s: {said}\n")
    return "".join(lines)
