"""Counts of what runs did since the service began, for whoever watches it. Thread-safe, and cheap."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Counts:
    """What was counted: by rig, by rig and kind of fault, by rig and the status that runs ended with."""

    samples: Counter[str] = field(default_factory=Counter)
    poses: Counter[str] = field(default_factory=Counter)
    faults: Counter[tuple[str, str]] = field(default_factory=Counter)
    ended: Counter[tuple[str, str]] = field(default_factory=Counter)


class Meter:
    """The counts of a service; each run counts through a `RunMeter` of its rig."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = Counts()
        self._began_s = time.monotonic()

    @property
    def uptime_s(self) -> float:
        """How long there has been something to count."""
        return time.monotonic() - self._began_s

    def counts(self) -> Counts:
        """What was counted so far: a copy, of one instant."""
        with self._lock:
            now = self._counts
            return Counts(now.samples.copy(), now.poses.copy(), now.faults.copy(), now.ended.copy())

    def of_run(self, rig: str, faults_before: Mapping[str, int] | None = None) -> RunMeter:
        """A meter for one run on a rig; of one taken up again, `faults_before` were counted then."""
        return RunMeter(self._lock, self._counts, rig, Counter(faults_before))


@dataclass
class RunMeter:
    """What one run counts. A run's faults come as totals: the difference to the last ones is new."""

    _lock: threading.Lock
    _counts: Counts
    _rig: str
    _faults: Counter[str]

    def samples(self, number: int) -> None:
        """Samples came."""
        with self._lock:
            self._counts.samples[self._rig] += number

    def pose(self) -> None:
        """A pose was stored."""
        with self._lock:
            self._counts.poses[self._rig] += 1

    def faults(self, totals: Mapping[str, int]) -> None:
        """The run's faults so far, by kind."""
        with self._lock:
            for kind, total in totals.items():
                self._counts.faults[self._rig, kind] += max(0, total - self._faults[kind])
                self._faults[kind] = total

    def ended(self, status: str) -> None:
        """The run ended."""
        with self._lock:
            self._counts.ended[self._rig, status] += 1
