"""Who is next in a list of units: worked out from its turns and what became of their runs, nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from calrig.store import Run
from calrig.store.batches import Turn
from calrig.store.records import TERMINAL

Failed = Literal["end", "follow_up"]
"""What becomes of a unit that failed: another turn at the end of the list, or the run that tells why."""
Word = Literal["pass", "fail", "done"]
TRIES = 2
"""Turns that a unit which fails has in a list, follow-ups not counted."""
POOR = ("fail", "conditional_fail")
OVER = ("done", "failed", "removed")


@dataclass(frozen=True, slots=True)
class Settled:
    """A list as it stands now.

    Attributes:
        turns: every turn; one whose run measured nothing waits again.
        written: those of `turns` that the store has otherwise, and for good.
        on: the turn of each rig: under way, else the one to be mounted; None where the list has none left.
        then: the turn that is kept for each rig after that.
    """

    turns: list[Turn]
    written: list[Turn]
    on: dict[str, Turn | None]
    then: dict[str, Turn | None]

    @property
    def is_finished(self) -> bool:
        """Whether every unit has had all its turns."""
        return all(turn.state in OVER for turn in self.turns)


def settled(turns: Sequence[Turn], runs: Mapping[str, Run], rigs: Sequence[str], failed: Failed) -> Settled:
    """How a list stands.

    Args:
        turns: as stored, by position.
        runs: of the turns that have one, by id.
        rigs: that the list is for.
        failed: what becomes of units that failed.
    """
    now, more = [], []
    for turn in turns:
        run = runs.get(turn.run_id or "")
        ended = _ended(turn, run) if turn.state == "running" and run is not None else turn
        now.append(ended)
        if ended.state == "failed" and turn.state == "running" and run is not None:
            more.append((turn, run))
    tries = Counter(turn.unit for turn in now if turn.state == "failed")
    for turn, run in sorted(more, key=lambda one: str(one[1].finished_at)):
        position = len(now)
        if failed == "follow_up" and run.status == "completed" and run.follows is None:
            now.append(Turn(position, turn.unit, "follow_up", turn.rig, run.id))
        elif (failed == "end" or run.status == "failed") and not run.follows and tries[turn.unit] < TRIES:
            now.append(Turn(position, turn.unit, why="it failed before in this list"))
    stored = dict(enumerate(turns))
    written = [
        t for t in now if t.position >= len(turns) or (t != stored[t.position] and t.state != "waiting")
    ]
    on = _on(now, rigs)
    taken = {turn.position for turn in on.values() if turn is not None}
    return Settled(now, written, on, _kept([t for t in now if t.position not in taken], rigs))


def word_of(run: Run) -> Word | None:
    """What a run came to, in one word; None where it has not ended or nothing was measured.

    A conditional pass is no more than `done`, nor is what is undecided.
    """
    if run.status == "failed" and run.progress["poses_done"]:
        return "fail"
    if run.status != "completed":
        return None
    answer = None if run.verdict is None else run.verdict.answer
    return "fail" if answer in POOR else "pass" if answer == "pass" else "done"


def _ended(turn: Turn, run: Run) -> Turn:
    word = word_of(run)
    if word is not None:
        return replace(turn, state="failed" if word == "fail" else "done", why=run.error)
    if (
        run.status in TERMINAL or run.status == "interrupted"
    ):  # nothing came of it: the unit stays where it is
        return replace(turn, state="waiting", why=run.error or f"its run was {run.status}")
    return turn


def _on(turns: Sequence[Turn], rigs: Sequence[str]) -> dict[str, Turn | None]:
    """Each rig's turn: under way, come to nothing before, a follow-up, kept for it, else the next.

    A rig that is left without any has what is kept for another one that has something else before it.
    """
    on: dict[str, Turn | None] = {}
    for rig in rigs:
        mine = [
            turn for turn in turns if turn.rig == rig and turn.state in ("running", "waiting", "follow_up")
        ]
        on[rig] = min(mine, key=_urgency, default=None)
    on = _filled(on, turns)
    taken = {turn.position for turn in on.values() if turn is not None}
    return _filled(on, [replace(turn, rig=None) for turn in turns if turn.position not in taken])


def _kept(turns: Sequence[Turn], rigs: Sequence[str]) -> dict[str, Turn | None]:
    kept: dict[str, Turn | None] = {
        rig: next((turn for turn in turns if turn.rig == rig and turn.state == "waiting"), None)
        for rig in rigs
    }
    return _filled(kept, turns)


def _filled(places: dict[str, Turn | None], turns: Sequence[Turn]) -> dict[str, Turn | None]:
    """Rigs without a turn get those that are kept for nobody, in order."""
    free = (turn for turn in turns if turn.state == "waiting" and turn.rig is None)
    return {rig: turn if turn is not None else next(free, None) for rig, turn in places.items()}


def _urgency(turn: Turn) -> tuple[int, int]:
    rank = {"running": 0, "follow_up": 2}.get(turn.state, 1 if turn.run_id is not None else 3)
    return rank, turn.position
