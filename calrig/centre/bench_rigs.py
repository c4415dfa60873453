"""The rigs of a centre: those that its benches say they have, and how they stood when they last said so."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.issuing import Releases
from calrig.runs.look import Look
from calrig.runs.rig_states import RigState
from calrig.runs.said_rigs import look_of, settings_of
from calrig.settings import RigSettings
from calrig.store import Store
from calrig.store.benches import Bench

log = logging.getLogger(__name__)

OFFLINE_S = 10.0
"""A bench says every two seconds that it is there."""


@dataclass(frozen=True, slots=True)
class BenchRig:
    """A rig, the bench that has it, and what that says of it."""

    bench: Bench
    settings: RigSettings
    said: dict[str, Any]

    @property
    def is_offline(self) -> bool:
        """Whether its bench has not been seen lately."""
        return self.bench.seen_ago_s is None or self.bench.seen_ago_s > OFFLINE_S

    @property
    def seen(self) -> Look | None:
        """What the last look at its board gave; None where nobody looks, or that is not known."""
        try:
            return None if self.is_offline else look_of(self.said)
        except ValidationError:
            return None

    def state(self, run_id: str | None) -> RigState:
        """As `GET /api/rigs` shows it; `run_id` is the unfinished run that the centre knows on it."""
        said_run = self.said.get("run_id") if self.said.get("state") == "busy" else None
        on_it = run_id or (said_run if isinstance(said_run, str) else None)
        return RigState(
            name=self.settings.name,
            stage=str(self.said.get("stage") or ""),
            imu=str(self.said.get("imu") or ""),
            simulated=bool(self.said.get("simulated")),
            state=self._state(is_busy=on_it is not None),
            run_id=on_it,
            bench=self.bench.name,
            hall=self.bench.hall,
            last_seen_at=self.bench.last_seen_at,
        )

    def _state(self, *, is_busy: bool) -> str:
        if self.is_offline:
            return "offline"
        if is_busy:
            return "busy"
        return "unreachable" if self.said.get("state") == "unreachable" else "idle"


class BenchRigs:
    """Looked up anew each time: benches come and go, and other processes hear of it no later."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._unreadable: set[str] = set()

    def all(self) -> list[BenchRig]:
        """Every rig, by its bench's name and then as that has it configured."""
        return [rig for bench in self._store.benches() for rig in self._of(bench)]

    def states(self) -> list[RigState]:
        """How each stands."""
        busy = self._store.busy_rigs()
        return [rig.state(busy.get((rig.bench.name, rig.settings.name))) for rig in self.all()]

    def looks(self) -> dict[str, Look]:
        """What was seen of the units on rigs that are looked at, by name."""
        return {rig.settings.name: seen for rig in self.all() if (seen := rig.seen) is not None}

    def known(self, name: str | None) -> BenchRig:
        """The rig of a name; the first one without.

        Raises:
            Unknown: no bench has such a rig.
            Conflict: several have.
        """
        rigs = self.all()
        found = rigs[:1] if name is None else [rig for rig in rigs if rig.settings.name == name]
        if not found:
            known = ", ".join(sorted({rig.settings.name for rig in rigs})) or "none, for no bench has joined"
            raise Unknown(f"no bench has a rig {name!r}; there are: {known}")
        if len(found) > 1:
            benches = ", ".join(rig.bench.name for rig in found)
            raise Conflict(f"benches {benches} each have a rig {name!r}: give their rigs names of their own")
        return found[0]

    def releases(self) -> Releases:
        """Who puts drafts in force, as the benches' configurations say."""
        return Releases.of([rig.settings for rig in self.all()])

    def _of(self, bench: Bench) -> list[BenchRig]:
        said = bench.said.get("rigs", [])
        try:
            return [BenchRig(bench, settings_of(one), one) for one in said]
        except (ValidationError, TypeError, KeyError, AttributeError) as error:
            if bench.name not in self._unreadable:
                log.error("what bench %s says of its rigs cannot be read: %s", bench.name, error)
            self._unreadable.add(bench.name)
            return []
