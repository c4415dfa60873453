"""Zaber rotary stages (driver `zaber`): the ASCII protocol through the maker's library, `calrig[zaber]`.

`axis` is the device's address in its chain; its first axis is turned. The library's open-custom connection
lets it use calrig's own port, so sockets and transcripts work. It numbers its requests and matches replies by
number, and gives each request a checksum; here only replies whose own holds are handed to it. Units are
native ones: how many there are in a turn the controller itself says (`limit.cycle.dist`), so no device
database has to be asked.
"""

import importlib
import re
import threading
from collections import Counter
from typing import Any, Self

from calrig.instruments import standstill
from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.device import OpenStage
from calrig.instruments.errors import Halted, InstrumentError, PortError, StageError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.stages.lines import LineWire, unanswered
from calrig.instruments.stages.zaber import BAUDRATE
from calrig.instruments.types import StageIdentity, StageStatus

REPLY_TIMEOUT_S = 0.5
ATTEMPTS = 4
LISTEN_S = 0.2
CLOSE_S = 2.0
UNITS_OF_SPEED = 1.6384
"""A speed of 1 is 1/1.6384 microsteps per second; an acceleration of 1 is 10⁴ times that, per second."""

REPLY = re.compile(r"@(\d{2} \d \d{2} (?:OK|RJ) (?:IDLE|BUSY) (?:--|[A-Z]{2}) .+):([0-9A-F]{2})")
STOP_REPLY = re.compile(r"@\d{2} 1 (?:OK|RJ) (?:IDLE|BUSY) (?:--|[A-Z]{2}) \S+")
"""The reply to a stop. It carries no number, since the driver does not wait for it."""
DAMAGED = "BADCOMMAND"
"""The refusal of what cannot be read: a NUL byte, for one, escapes the checksum."""
MOTION = re.compile(r"/\d+ \d+ \d+ (?:move|home)\b.*")

UNREFERENCED = ("WR", "WH")
FLAGS = {
    "FF": "critical system error",
    "FN": "stage not supported",
    "FZ": "stage inactive",
    "FH": "emergency stop: driver off",
    "FV": "supply voltage out of range: driver off",
    "FO": "driver off",
    "FC": "inrush current too high",
    "FM": "motor too hot",
    "FD": "driver off: motor power was cut, or it overheated",
    "FQ": "encoder error",
    "FI": "encoder index error",
    "FA": "analog encoder out of step",
    "FR": "overdrive limit exceeded",
    "FS": "stalled and stopped",
    "FB": "stream out of bounds",
    "FP": "path deviation",
    "FE": "limit sensor error",
    "FT": "excessive twist",
    "WL": "unexpected limit switch",
    "WV": "supply voltage out of range",
    "WT": "controller hot",
    "WS": "stalled, and recovered",
    "WM": "turned by force while it stood",
    "WP": "invalid calibration",
    "WR": "no reference position",
    "WH": "not homed",
    "NC": "turned by its knob",
    "NI": "motion interrupted",
    "NJ": "joystick being set up",
}
"""Warning flags of the Zaber ASCII protocol manual."""


class NoAnswer(StageError):  # noqa: N818 (what it is)
    """Nothing came in reply."""


class Zaber:
    """One device on a port, in the stage's own degrees. Opening it moves nothing."""

    def __init__(self, port: Port, axis: int = 1) -> None:
        self.faults: Counter[str] = Counter()
        self._address = axis
        self._name = f"stage zaber at address {axis} on {port.name}"
        self._lines = LineWire(port, self.faults)
        self._now_s = port.clock.now_s
        self._maker = _library()
        self._asking = threading.RLock()
        self._per_deg: float | None = None
        self._homing = False
        self._port_error: InstrumentError | None = None
        self._closing = False
        self._last_reply = ""
        self._transport = self._maker.Transport.open()
        self._connection = self._maker.Connection.open_custom(self._transport)
        self._pumps = [threading.Thread(target=pump, daemon=True) for pump in (self._speak, self._hear)]
        for pump in self._pumps:
            pump.start()

    @classmethod
    def open(cls, url: str, *, axis: int = 1, baudrate: int | None = None) -> Self:
        """Opens the port (PortError); asks nothing yet.

        Raises:
            InstrumentError: the maker's library is not installed; says how to.
        """
        _library()
        return cls(open_port(url, baudrate=baudrate or BAUDRATE, timeout_s=0.02), axis)

    def identify(self) -> StageIdentity:
        """Asks who it is and what it allows, and clears flags of long ago.

        Raises:
            StageError: it does not answer, or is no rotary stage.
        """
        with self._asking:
            self._ask("warnings clear")
            per_deg = self._microsteps_per_deg()
            speed, acceleration = self._value("maxspeed"), self._value("accel")
            return StageIdentity(
                driver="zaber",
                firmware=str(self._ask("get version").data),
                limits_deg=(self._value("limit.min") / per_deg, self._value("limit.max") / per_deg),
                velocity_dps=speed / UNITS_OF_SPEED / per_deg,
                acceleration_dps2=acceleration * 1e4 / UNITS_OF_SPEED / per_deg,
            )

    def status(self) -> StageStatus:
        """State and flags in words (StageError if it does not answer)."""
        with self._asking:
            reply = self._ask("warnings")
            flags = str(reply.data).split()[1:]
            faults = [flag for flag in flags if flag.startswith("F")]
            words = f"{reply.status} ({flag_words(flags)})" if flags else str(reply.status)
            if reply.status == "BUSY":
                return StageStatus("homing" if self._homing else "moving", words)
            self._homing = False
            if faults:
                return StageStatus("disabled", words)
            if any(flag in UNREFERENCED for flag in flags):
                return StageStatus("not_referenced", words)
            return StageStatus("ready", words)

    def position_deg(self) -> float:
        """Return the position at rest: two reads in a row that agree, three on a link with faults.

        Raises:
            StageError: no reply, or the reads differ although the stage is at rest.
        """
        with self._asking:
            return standstill.position_deg(self._name, self.glimpse_deg, self._moves, self.faults)

    def glimpse_deg(self) -> float:
        """One read, unchecked: to show a stage on the move, never for a result."""
        with self._asking:
            return self._value("pos") / self._microsteps_per_deg()

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity of the moves that follow (StageError if refused)."""
        with self._asking:
            self._ask(f"set maxspeed {velocity_dps * self._microsteps_per_deg() * UNITS_OF_SPEED:.0f}")

    def home(self) -> None:
        """Begins to look for the reference; sent once (StageError if refused, Halted after a stop)."""
        with self._asking:
            self._homing = True
            try:
                self._ask("home", attempts=1, motion=True)
            except NoAnswer:
                if not self._moves():
                    raise

    def move(self, target_deg: float) -> None:
        """Begins a move (StageError if refused, Halted after a stop)."""
        with self._asking:
            self._ask(f"move abs {target_deg * self._microsteps_per_deg():.0f}", motion=True)

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted."""
        self._lines.halt(f"/{self._address} 1 stop\n".encode("ascii"))

    def close(self) -> None:
        """Closes the port; never raises."""
        with self._asking:
            self._closing = True
            # The library waits for itself, and has been seen to wait for ever.
            closing = threading.Thread(target=self._connection.close, daemon=True)
            closing.start()
            for thread in (closing, *self._pumps):
                thread.join(CLOSE_S)
            self._lines.close()

    def _moves(self) -> bool:
        return str(self._ask("").status) == "BUSY"

    def _microsteps_per_deg(self) -> float:
        if self._per_deg is None:
            turn = self._value("limit.cycle.dist")
            if turn <= 0:
                raise StageError(f"{self._name} is no rotary stage: its limit.cycle.dist is {turn:g}")
            self._per_deg = turn / 360
        return self._per_deg

    def _value(self, setting: str) -> float:
        data = str(self._ask(f"get {setting}").data)
        try:
            return float(data)
        except ValueError:
            raise StageError(f"{self._name}: {setting} is {data!r}, which is no number") from None

    def _ask(self, command: str, *, attempts: int = ATTEMPTS, motion: bool = False) -> Any:
        """What the device answers; a command may be sent again unless `attempts` is 1."""
        errors = self._maker.exceptions
        refusal = ""
        for _ in range(1 if self._lines.halted else attempts):  # a stop goes first
            raise_if_cancelled()
            if self._port_error:  # the library may wait for an answer all the same
                raise self._port_error
            if motion:
                self._lines.refuse_if_halted(command, self._name)
            try:
                timeout_ms = round(REPLY_TIMEOUT_S * 1000)
                return self._connection.generic_command(command, self._address, 1, True, timeout_ms)
            except errors.RequestTimeoutException:
                self.faults["no_reply"] += 1
            except errors.CommandFailedException as error:
                if error.details.response_data == DAMAGED and attempts > 1:
                    refusal = f"refused {command}: {error.message}"
                    self.faults["resent"] += 1
                    continue
                raise StageError(f"{self._name} refused {command}: {error.message}") from error
            except errors.MotionLibException as error:
                if self._port_error:
                    raise self._port_error from error
                raise StageError(f"{self._name}: {error.message}") from error
        if self._port_error:
            raise self._port_error
        if refusal:
            raise StageError(f"{self._name} {refusal}")
        if motion:
            self._lines.refuse_if_halted(command, self._name)
        check = "power, cable, address and baud rate"
        raise NoAnswer(unanswered(self._name, command or "at all", self.faults, check))

    def _speak(self) -> None:
        """From the library to the port, until the connection is closed."""
        errors = self._maker.exceptions
        while True:
            try:
                message = self._transport.read()
            except errors.MotionLibException:
                return
            data = f"{message}\n".encode("ascii")
            try:
                if MOTION.fullmatch(message):
                    self._lines.send_motion(data, self._name)
                else:
                    self._lines.send(data)
            except Halted:
                continue  # the caller gets Halted once its time is up
            except PortError as error:
                self._fail(error)

    def _hear(self) -> None:
        """From the port to the library, sound replies only."""
        errors = self._maker.exceptions
        while not self._closing:
            try:
                line = self._lines.line(self._now_s() + LISTEN_S)
                if line is not None and self._is_sound(line):
                    self._transport.write(line)
            except PortError as error:
                self._fail(error)
                return
            except errors.MotionLibException:
                return

    def _is_sound(self, line: str) -> bool:
        reply = REPLY.fullmatch(line)
        if reply and -sum(reply[1].encode("ascii", "replace")) & 0xFF == int(reply[2], 16):
            again, self._last_reply = line == self._last_reply, line
            if again:
                self.faults["late_reply"] += 1  # its number tells that it came twice
            return not again
        if STOP_REPLY.fullmatch(line):
            return False
        self.faults["crc" if reply else "unparsed"] += 1
        return False

    def _fail(self, error: PortError) -> None:
        self._port_error = error
        self._transport.close_with_error(str(error))


def _library() -> Any:
    """The maker's `zaber_motion.ascii`, with its exceptions (InstrumentError where it is not installed)."""
    try:
        maker: Any = importlib.import_module("zaber_motion.ascii")
        maker.exceptions = importlib.import_module("zaber_motion.exceptions")
    except ImportError as error:
        raise InstrumentError(
            f"driver 'zaber' needs the maker's library: run `pip install 'calrig[zaber]'` ({error})"
        ) from error
    return maker


def flag_words(flags: list[str]) -> str:
    """The flags with what they mean."""
    return ", ".join(f"{flag} {FLAGS.get(flag, 'a flag this driver does not know')}" for flag in flags)


OPENS: OpenStage = Zaber.open
