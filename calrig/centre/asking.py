"""Asking a bench for something while a person waits, and saying so where it cannot be told."""

from __future__ import annotations

from calrig.analysis.errors import Conflict, Unknown
from calrig.instruments.clock import WALL, Clock
from calrig.store import Store
from calrig.store.bench_commands import Kind
from calrig.store.benches import Bench

ANSWER_S = 3.0
"""How long an answer is waited for."""
LOOK_S = 0.5
"""How often it is looked for though nobody said that it has come."""
CUT = {"stop", "abort"}


class Asking:
    """Commands of one process and the answers to them. Thread-safe."""

    def __init__(self, store: Store, clock: Clock = WALL) -> None:
        self._store, self._clock = store, clock
        self._answered: set[str] = set()
        self._told = clock.condition()

    def heard(self, command: str) -> None:
        """An answer has come, to whoever's command."""
        with self._told:
            self._answered.add(command)
            self._told.notify_all()

    def ask(self, bench: Bench, kind: Kind, *, rig: str | None = None, run_uid: str | None = None) -> None:
        """Has a bench do something; returns once it has said that it is done.

        Raises:
            Unknown: the bench knows no such run or rig.
            Conflict: it says why not; or it cannot be told, or does not say what came of it.
        """
        command = self._store.ask_bench(bench.name, kind, rig=rig, run_uid=run_uid)
        give_up_s = self._clock.now_s() + ANSWER_S
        answer = self._store.answer_of(command)
        while answer is None and (left_s := give_up_s - self._clock.now_s()) > 0:
            with self._told:
                self._told.wait_for(lambda: str(command) in self._answered, min(LOOK_S, left_s))
                self._answered.clear()
            answer = self._store.answer_of(command)
        if answer is None and self._store.withdraw_command(command):
            raise Conflict(f"bench {bench.name} {seen(bench)} and cannot be told{_advice(kind)}")
        answer = answer or self._store.answer_of(command)
        if answer is None:
            what = "that the stage stands" if kind in CUT else "what came of it"
            raise Conflict(f"bench {bench.name} has the {kind} and has not said {what}{_advice(kind)}")
        if answer.get("status") != 200:
            said = str(answer.get("detail") or f"bench {bench.name} did not say why")
            raise Unknown(said) if answer.get("status") == 404 else Conflict(said)


def seen(bench: Bench) -> str:
    """When a bench was last seen, in words."""
    if bench.seen_ago_s is None:
        return "has never been seen"
    return f"was last seen {bench.seen_ago_s:.0f} s ago"


def _advice(kind: Kind) -> str:
    return ": go there, or cut its motor power" if kind in CUT else ": ask again once it is there"
