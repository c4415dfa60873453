"""A stage and a clock that stand where a test puts them."""

from __future__ import annotations

from collections import Counter

from calrig.instruments.types import StageIdentity, StageStatus


class ScriptedStage:
    """A stage that is wherever a test puts it."""

    def __init__(self, limits_deg=(-180.0, 180.0)):
        self.faults = Counter()
        self.state = "ready"
        self.at_deg = 0.0
        self.sent = []
        self.identity = StageIdentity("scripted", None, limits_deg, 10.0, 40.0)

    def identify(self):
        return self.identity

    def status(self):
        return StageStatus(self.state, self.state.upper())

    def position_deg(self):
        return self.at_deg

    glimpse_deg = position_deg

    def set_velocity(self, velocity_dps):
        self.sent.append(("VA", velocity_dps))

    def home(self):
        self.sent.append("OR")

    def move(self, target_deg):
        self.sent.append(("PA", target_deg))

    def halt(self):
        self.sent.append("ST")

    def close(self):
        self.sent.append("closed")


class Clock:
    def __init__(self):
        self.at_s = 1000.0

    def now_s(self):
        return self.at_s

    def sleep(self, duration_s):
        self.at_s += duration_s
