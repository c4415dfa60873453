"""Counts of what runs did since the service began, for whoever watches it. Thread-safe, and cheap."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

from prometheus_client import CollectorRegistry, Counter, Gauge


class Meter:
    """The counters of a service, in a registry of its own; each run counts through a `RunMeter` of its rig.

    Args:
        rigs: their names. What is counted by rig begins with 0, for a rate needs a beginning.

    Attributes:
        registry: what the service's metrics are written out from.
    """

    def __init__(self, rigs: Iterable[str] = ()) -> None:
        registry = self.registry = CollectorRegistry()
        self.samples = Counter(
            "calrig_samples", "Valid samples taken from boards.", ["rig"], registry=registry
        )
        self.poses = Counter("calrig_poses", "Poses measured and stored.", ["rig"], registry=registry)
        self.faults = Counter(
            "calrig_faults",
            "Faults seen on the wires and in samples.",
            ["rig", "kind"],
            registry=registry,
        )
        self.ended = Counter("calrig_runs_ended", "Runs that ended.", ["rig", "status"], registry=registry)
        began_s = time.monotonic()
        uptime = Gauge("calrig_uptime_seconds", "Time since the service began.", registry=registry)
        uptime.set_function(lambda: time.monotonic() - began_s)
        for rig in rigs:
            self.samples.labels(rig)
            self.poses.labels(rig)

    def of_run(self, rig: str, faults_before: Mapping[str, int] | None = None) -> RunMeter:
        """A meter for one run on a rig; of a resumed one, `faults_before` were counted before."""
        return RunMeter(self, rig, faults_before or {})


class RunMeter:
    """What one run counts. Used by the run's own thread only."""

    def __init__(self, meter: Meter, rig: str, faults_before: Mapping[str, int]) -> None:
        self._meter = meter
        self._rig = rig
        self._faults = dict(faults_before)

    def samples(self, number: int) -> None:
        """Samples came."""
        self._meter.samples.labels(self._rig).inc(number)

    def pose(self) -> None:
        """A pose was stored."""
        self._meter.poses.labels(self._rig).inc()

    def faults(self, totals: Mapping[str, int]) -> None:
        """The run's faults so far, by kind: the difference to the last totals is new."""
        for kind, total in totals.items():
            self._meter.faults.labels(self._rig, kind).inc(max(0, total - self._faults.get(kind, 0)))
            self._faults[kind] = total

    def ended(self, status: str) -> None:
        """The run ended."""
        self._meter.ended.labels(self._rig, status).inc()
