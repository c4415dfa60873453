"""Recorded conversations with real firmware, and the simulated controller put in the firmware's place."""

from __future__ import annotations

from simulated_devices import as_heard
from wire_recordings import recording, settings_of

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import stage_of

BEGINNING_S = 10.0
POLL_S = 0.001
IN_A_ROW_S = 0.0005
BEFORE_S = 2.0
"""After each thing that a client before the recording had sent."""
OWN_BAUD, WRONG_BAUD = 115200, 9600
AT_WRONG_BAUD_S = (2.0, 5.6)
"""In the one recording whose host changes its rate; the end of a line goes out when it comes back."""


class Recording:
    """One conversation, by its name: what the host sent, what came, and what was done by other means."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.settings = settings_of(name)
        self.entries = recording(name)

    @property
    def is_old(self) -> bool:
        return self.name.startswith("grbl09j")

    @property
    def changes_baud(self) -> bool:
        return self.name == "grbl11h-wrong-baud"

    def done(self) -> list[tuple[float, str, str]]:
        """What was sent and done, with writes in a row at one time in one."""
        done: list[tuple[float, str, str]] = []
        for at_s, kind, text in self.entries:
            if kind == "to" and done and done[-1][1] == "to" and at_s - done[-1][0] < IN_A_ROW_S:
                done[-1] = (done[-1][0], kind, done[-1][2] + text)
            elif kind != "from":
                done.append((at_s, kind, text))
        return done

    def came(self) -> list[tuple[float, str]]:
        """Whole lines that came, without their ends."""
        lines, begun = [], ""
        begin_s, end_s = AT_WRONG_BAUD_S
        for at_s, kind, text in self.entries:
            if kind == "from" and not (self.changes_baud and begin_s < at_s < end_s):
                begun += text
                *whole, begun = begun.split("\n")
                lines += [(at_s, line.removesuffix("\r")) for line in whole]
        return lines


class Replay:
    """A simulated controller that is sent what a recording's host sent, when it was sent."""

    def __init__(self, recording: Recording, before: tuple[bytes, ...] = (), **stage) -> None:
        self.recording = recording
        self.now_s = BEGINNING_S - (BEFORE_S * len(before))
        options = {
            "driver": "grbl",
            "firmware": "0.9j" if recording.is_old else "1.1h",
            "settings": recording.settings,
            "homing": False,
            "g54_deg": 0.0,
            "boot_s": 1.5,
            **stage,
        }
        settings = SimulatorSettings.from_options(
            {"preset": "ideal", "stage": options, "mechanics": {"power_up_deg": 0.0}}
        )
        self.device = stage_of("grbl")(settings.stage, Bench(settings), lambda: self.now_s)
        self.said: list[tuple[float, str]] = []
        self._begun = ""
        for data in before:
            self.device.receive(data)
            self._pass(self.now_s - BEGINNING_S + BEFORE_S)
        if before or "reset line" in recording.entries[0]:
            self.said.clear()

    def lines(self) -> list[tuple[float, str]]:
        """Plays it to its end; every line that came, and when."""
        for at_s, kind, text in self.recording.done():
            self._until(at_s)
            if kind == "event":
                self._do(text)
            else:
                self._hear(self.device.receive(self._as_sent(at_s, text)))
        self._until(self.recording.entries[-1][0] + 0.02)
        return self.said

    def _as_sent(self, at_s: float, text: str) -> bytes:
        data = text.encode("latin-1")
        begin_s, end_s = AT_WRONG_BAUD_S
        if self.recording.changes_baud and begin_s < at_s < end_s:
            return as_heard(data, WRONG_BAUD, OWN_BAUD)
        return data

    def _do(self, event: str) -> None:
        if event == "reset line":
            self.device.reset()
            self._begun = ""
        else:
            assert event.startswith("X limit switch")
            self.device.set_limit_switch(closed=event.endswith("closes"))

    def _until(self, at_s: float) -> None:
        changes_back = self.recording.changes_baud and self.now_s - BEGINNING_S < AT_WRONG_BAUD_S[1] <= at_s
        if changes_back:
            self._pass(AT_WRONG_BAUD_S[1])
            self._hear(self.device.receive(b"\n"))
        self._pass(at_s)

    def _pass(self, at_s: float) -> None:
        while self.now_s < BEGINNING_S + at_s:
            self.now_s = min(self.now_s + POLL_S, BEGINNING_S + at_s)
            self._hear(self.device.emit())

    def _hear(self, data: bytes) -> None:
        self._begun += data.decode("latin-1")
        *whole, self._begun = self._begun.split("\n")
        self.said += [(self.now_s - BEGINNING_S, line.removesuffix("\r")) for line in whole]
