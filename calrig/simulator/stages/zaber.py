"""The stage's dialect: a Zaber controller's ASCII protocol, version 3 (Zaber ASCII protocol manual).

`/device axis id command:checksum` is answered by `@device axis id flag status warning data:checksum`. The
checksum makes the bytes from the address to itself sum to zero; id and checksum come back where they came.
"""

import re
from collections.abc import Callable

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageOptions
from calrig.simulator.stage import LineStage, Refused

FIRMWARE = "7.35"
MICROSTEPS_PER_DEG = 6400.0
NATIVE_VELOCITY = 1.6384
"""A speed counts 1/1.6384 microsteps per second; an acceleration 10⁴ times that, per second."""
MESSAGE = re.compile(r"/(?:(\d+)(?: (\d+)(?: (\d+|--))?)?)?\s*(.*?)(?::([0-9A-F]{2}))?")


class Zaber(LineStage):
    """A controller with one rotary axis, fed with bytes, answering in bytes; its alerts are off."""

    dropped = b"\r"
    longest_line = 80

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        super().__init__(options, bench, now)
        self._referenced = False
        self._flags: set[str] = set()
        self._ends: tuple[float, str] | None = None
        self._homing = False
        low, high = options.limits_deg
        self._settings = {
            "limit.min": round(low * MICROSTEPS_PER_DEG),
            "limit.max": round(high * MICROSTEPS_PER_DEG),
            "limit.cycle.dist": round(360 * MICROSTEPS_PER_DEG),
            "maxspeed": round(options.velocity_dps * MICROSTEPS_PER_DEG * NATIVE_VELOCITY),
            "accel": round(options.acceleration_dps2 * MICROSTEPS_PER_DEG * NATIVE_VELOCITY / 1e4),
        }

    def reset(self) -> None:
        """It is switched off and on."""
        with self._at_now() as now_s:
            self._stop(now_s)
            self._tail, self._ends, self._homing, self._referenced = b"", None, False, False
            self._flags.clear()

    def _replies(self, line: bytes) -> list[str]:
        reply = self._answer(line.decode("ascii", "replace"))
        return [reply] if reply else []

    def _answer(self, line: str) -> str:
        message = MESSAGE.fullmatch(line)
        if message is None:
            return ""
        device, axis, number, command, checksum = message.groups()
        body = line[1:].rpartition(":")[0]
        damaged = checksum is not None and _checksum(body) != checksum
        if damaged or int(device or 0) not in (0, self._options.axis):
            return ""
        with self._at_now() as now_s:
            flag, data = "OK", "0"
            try:
                data = self._obey(command.split(), now_s)
            except Refused as refusal:
                flag, data = "RJ", refusal.answer
            head = [f"{self._options.axis:02d}", axis or "0", *([number] if number else [])]
            reply = " ".join([*head, flag, "BUSY" if self._ends else "IDLE", self._warning(), data])
        return f"@{reply}:{_checksum(reply)}" if checksum else f"@{reply}"

    def _obey(self, words: list[str], now_s: float) -> str:
        match words:
            case []:
                return "0"
            case ["get", "pos"]:
                return str(round(self._reported_deg(now_s) * MICROSTEPS_PER_DEG))
            case ["get", "version"]:
                return self._options.firmware or FIRMWARE
            case ["get", name] if name in self._settings:
                return str(self._settings[name])
            case ["set", "maxspeed", text]:
                self._settings["maxspeed"] = _whole(text)
            case ["move", "abs", text]:
                self._move(now_s, _whole(text))
            case ["home"]:
                self._home(now_s)
            case ["stop"]:
                self._stop(now_s)
            case ["warnings", *clear]:
                flags = sorted(self._flags | ({"WR"} if not self._referenced else set()))
                if clear == ["clear"]:
                    self._flags = set()
                return " ".join([f"{len(flags):02d}", *flags])
            case _:
                raise Refused("BADCOMMAND")
        return "0"

    def _warning(self) -> str:
        flags = sorted(self._flags)
        return flags[0] if flags else "--" if self._referenced else "WR"

    def _move(self, now_s: float, target: int) -> None:
        if not self._settings["limit.min"] <= target <= self._settings["limit.max"]:
            raise Refused("BADDATA")
        self._flags.discard("FS")
        velocity = self._settings["maxspeed"] / NATIVE_VELOCITY / MICROSTEPS_PER_DEG
        arrival = self._bench.mechanics.move(
            now_s, target / MICROSTEPS_PER_DEG, velocity, self._options.acceleration_dps2
        )
        self._ends = arrival.at_s, "FS" if arrival.stalled else ""

    def _home(self, now_s: float) -> None:
        arrival = self._search_home(now_s)
        self._homing, self._referenced = True, False
        self._ends = arrival.at_s, "FS" if arrival.stalled else ""

    def _stop(self, now_s: float) -> None:
        if self._ends:
            self._ends = self._bench.mechanics.halt(now_s, self._options.acceleration_dps2), "NI"
            self._homing = False

    def _advance(self, now_s: float) -> None:
        if self._ends and now_s >= self._ends[0]:
            flag, self._ends = self._ends[1], None
            if flag:
                self._flags.add(flag)
            elif self._homing:
                self._referenced = True
            self._homing = False


STAGE = Zaber


def _whole(text: str) -> int:
    if not re.fullmatch(r"-?\d+", text):
        raise Refused("BADDATA")
    return int(text)


def _checksum(body: str) -> str:
    return f"{-sum(body.encode('ascii', 'replace')) & 0xFF:02X}"
