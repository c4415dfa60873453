"""The stage's dialect: a Newport ESP301.

Its source is the manual (user's manual, section 3) as `../shared/stages.md` next to the repository gives
it. No conversation with a real one was recorded: what the manual leaves open is this module's guess.
"""

import re
from collections import deque
from collections.abc import Callable

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageOptions
from calrig.simulator.stage import LineStage, Refused

FIRMWARE = "ESP301 Version 3.0.1 simulated"
STAGE_NAME = "URS75BCC, SN S0001"
MOST_ERRORS = 10
COMMAND = re.compile(r"(\d{0,2})([A-Z]{2})(\?|[-+]?[\d.]+|)")
UNKNOWN, AXIS_OUT_OF_RANGE, PARAMETER_MISSING = 6, 9, 38
PARAMETER, FOLLOWING, POSITIVE, NEGATIVE, TOO_FAST, MOTOR_OFF, HOMING_ABORTED = 1, 3, 4, 5, 10, 13, 20
TEXTS = {
    0: "NO ERROR DETECTED",
    UNKNOWN: "COMMAND DOES NOT EXIST",
    AXIS_OUT_OF_RANGE: "AXIS NUMBER OUT OF RANGE",
    PARAMETER_MISSING: "COMMAND PARAMETER MISSING",
}
AXIS_TEXTS = {
    PARAMETER: "PARAMETER OUT OF RANGE",
    FOLLOWING: "FOLLOWING ERROR THRESHOLD EXCEEDED",
    POSITIVE: "POSITIVE HARDWARE LIMIT DETECTED",
    NEGATIVE: "NEGATIVE HARDWARE LIMIT DETECTED",
    TOO_FAST: "MAXIMUM VELOCITY EXCEEDED",
    MOTOR_OFF: "MOTOR NOT ENABLED",
    HOMING_ABORTED: "HOMING ABORTED",
}


class Esp301(LineStage):
    """A controller with one stage, fed with bytes, answering in bytes."""

    line_end = b"\r"
    dropped = b"\n"

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        super().__init__(options, bench, now)
        self._errors: deque[tuple[int, float]] = deque(maxlen=MOST_ERRORS)
        self._motor_is_on = True
        self._velocity_dps = options.velocity_dps
        self._setpoint_deg = 0.0
        self._ends: tuple[float, int] | None = None
        self._zero_deg = 0.0  # where it counts from: its home, or where it was switched on
        low, high = options.limits_deg
        self._queries: dict[str, Callable[[float], str]] = {
            "TP": lambda now_s: f"{self._reported_deg(now_s) - self._zero_deg + 0.0:.4f}",
            "MD": lambda _: str(int(self._ends is None)),
            "MO": lambda _: str(int(self._motor_is_on)),
            "PA": lambda _: f"{self._setpoint_deg:.4f}",
            "VA": lambda _: f"{self._velocity_dps:.4f}",
            "AC": lambda _: f"{options.acceleration_dps2:.4f}",
            "SL": lambda _: f"{low:.4f}",
            "SR": lambda _: f"{high:.4f}",
            "ID": lambda _: STAGE_NAME,
        }
        self._commands: dict[str, Callable[[float, str], None]] = {
            "PA": lambda now_s, text: self._move(now_s, _number(text)),
            "PR": lambda now_s, text: self._move(now_s, self._setpoint_deg + _number(text)),
            "VA": lambda _, text: self._set_velocity(_number(text)),
            "OR": lambda now_s, _: self._home(now_s),
            "ST": lambda now_s, _: self._halt(now_s),
            "MO": lambda *_: self._switch_motor(on=True),
            "MF": lambda *_: self._switch_motor(on=False),
        }

    def reset(self) -> None:
        """It is switched off and on: it counts from here, wherever here is, and does not say so."""
        with self._at_now() as now_s:
            self._halt(now_s)
            self._tail, self._ends, self._motor_is_on = b"", None, True
            self._errors.clear()
            self._velocity_dps, self._setpoint_deg = self._options.velocity_dps, 0.0
            self._zero_deg += self._position(now_s)

    def _replies(self, line: bytes) -> list[str]:
        parts = line.decode("ascii", "replace").split(";")
        with self._at_now() as now_s:
            replies = [self._answer(part.strip(), now_s) for part in parts]
        return [reply for reply in replies if reply is not None]

    def _answer(self, text: str, now_s: float) -> str | None:
        try:
            return self._obey(text.upper(), now_s) if text else None
        except Refused as refusal:
            self._errors.append((refusal.answer, now_s))
            return None

    def _obey(self, text: str, now_s: float) -> str | None:
        command = COMMAND.fullmatch(text)
        if command is None:
            raise Refused(UNKNOWN)
        axis, code, parameter = command.groups()
        if code in ("TE", "TB", "VE"):
            return self._about_itself(code)
        if code == "AB":
            self._halt(now_s)
            return None
        handled = code in self._queries if parameter == "?" else code in self._commands or code == "TP"
        if not handled:
            raise Refused(UNKNOWN)
        if axis != str(self._options.axis) and not (code == "ST" and axis == ""):
            raise Refused(AXIS_OUT_OF_RANGE)
        if parameter == "?" or code == "TP":
            return self._queries[code](now_s)
        self._commands[code](now_s, parameter)
        return None

    def _about_itself(self, code: str) -> str:
        if code == "VE":
            return self._options.firmware or FIRMWARE
        error, at_s = self._errors.popleft() if self._errors else (0, self._now())
        if code == "TE":
            return str(error)
        text = AXIS_TEXTS[error % 100] if error >= 100 else TEXTS[error]
        return f"{error}, {at_s * 1000:.0f}, {text}"

    def _axis_error(self, number: int) -> Refused:
        return Refused(100 * self._options.axis + number)

    def _move(self, now_s: float, target_deg: float) -> None:
        if not self._motor_is_on:
            raise self._axis_error(MOTOR_OFF)
        low, high = self._options.limits_deg
        if not low <= target_deg <= high:
            raise self._axis_error(POSITIVE if target_deg > high else NEGATIVE)
        arrival = self._bench.mechanics.move(
            now_s, target_deg + self._zero_deg, self._velocity_dps, self._options.acceleration_dps2
        )
        self._setpoint_deg = target_deg
        self._ends = arrival.at_s, FOLLOWING if arrival.stalled else 0

    def _home(self, now_s: float) -> None:
        if not self._motor_is_on:
            raise self._axis_error(MOTOR_OFF)
        arrival = self._search_home(now_s)
        self._setpoint_deg = self._zero_deg = 0.0
        self._ends = arrival.at_s, HOMING_ABORTED if arrival.stalled else 0

    def _halt(self, now_s: float) -> None:
        if self._ends:
            rest_s = self._bench.mechanics.halt(now_s, self._options.acceleration_dps2)
            self._setpoint_deg = self._position(rest_s)
            self._ends = rest_s, 0

    def _switch_motor(self, *, on: bool) -> None:
        if not on and self._ends:
            self._halt(self._now())
        self._motor_is_on = on

    def _set_velocity(self, velocity_dps: float) -> None:
        if velocity_dps > self._options.velocity_dps:
            raise self._axis_error(TOO_FAST)
        if velocity_dps <= 0:
            raise self._axis_error(PARAMETER)
        self._velocity_dps = velocity_dps

    def _advance(self, now_s: float) -> None:
        if self._ends and now_s >= self._ends[0]:
            (at_s, error), self._ends = self._ends, None
            if error:
                self._errors.append((100 * self._options.axis + error, at_s))
                self._motor_is_on = False

    def _position(self, now_s: float) -> float:
        return self._encoder_deg(now_s) - self._zero_deg + 0.0


STAGE = Esp301


def _number(text: str) -> float:
    if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)", text):
        raise Refused(PARAMETER_MISSING)
    return float(text)
