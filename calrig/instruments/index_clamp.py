"""A motorised dividing head with a protocol of four words (driver `index`); lines end CR LF.

It turns a unit in its clamp. Most rigs have none: hands do that.

`ID` is answered with its name. `CLAMP 120.000 x` is answered with `OK` once the unit is clamped at that angle
with that axis along the stage's, or with `ERR` and the reason.
"""

from collections import Counter
from typing import Self

from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.stages.lines import MOST_QUOTED, LineWire

BAUDRATE = 115_200
WAKES_S = 3.0
"""An Arduino boots when its port is opened, and takes no commands while it boots."""
ASKED_AGAIN_S = 0.5
TURNS_S = 60.0


class ClampError(InstrumentError):
    """The clamp does not answer, or could not turn the unit."""


class IndexClamp:
    """One dividing head on a port. Opening it turns nothing."""

    def __init__(self, port: Port) -> None:
        self.faults: Counter[str] = Counter()
        self._name = f"clamp index on {port.name}"
        self._lines = LineWire(port, self.faults)
        self._now_s = port.clock.now_s

    @classmethod
    def open(cls, url: str, *, baudrate: int | None = None) -> Self:
        """Opens the port (PortError); asks nothing yet."""
        return cls(open_port(url, baudrate=baudrate or BAUDRATE, timeout_s=0.02))

    def identify(self) -> str:
        """Who it is (ClampError where it says nothing)."""
        give_up_s, misread = self._now_s() + WAKES_S, None
        while self._now_s() < give_up_s:
            raise_if_cancelled()
            self._lines.old_lines()
            self._lines.send(b"ID\r\n")
            answer = self._lines.line(self._now_s() + ASKED_AGAIN_S)
            if answer is not None and answer.startswith("INDEX"):
                return answer
            misread = answer or misread
        if misread is not None:
            raise ClampError(
                f"{self._name} answers ID with {misread[:MOST_QUOTED]!r} instead of INDEX…: check that its "
                "port is the clamp's"
            )
        raise ClampError(f"{self._name} does not answer ID: check its power, cable and baud rate")

    def turn_to(self, mount_deg: float, axis: str) -> None:
        """Clamps the unit at an angle, with that axis of it along the stage's; returns once it sits.

        Raises:
            ClampError: it refuses, or does not say in time that the unit sits.
        """
        command = f"CLAMP {mount_deg:.3f} {axis}"
        self._lines.old_lines()
        self._lines.send(f"{command}\r\n".encode("ascii"))
        answer = self._lines.line(self._now_s() + TURNS_S)
        if answer is None:
            raise ClampError(f"{self._name} has not said within {TURNS_S:g} s what became of {command}")
        if answer != "OK":
            raise ClampError(f"{self._name} refused {command}: {answer.removeprefix('ERR').strip()}")

    def close(self) -> None:
        """Closes the port; never raises."""
        self._lines.close()


CLAMPS = {"index": IndexClamp}
