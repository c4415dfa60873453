"""A driver's port whose far end is in this process: a scripted controller, or a simulated one, and damage."""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import stage_of

Damage = Callable[[bytes], bytes]
READ_S = 0.001
EMPTY_READ_S = 0.02
POLLS = 1000


class ReadClock:
    """Time that goes on as a port is read, for drivers that ask for nothing but the time."""

    def __init__(self):
        self.at_s = 0.0

    def now_s(self) -> float:
        return self.at_s

    def sleep(self, duration_s: float) -> None:
        self.at_s += duration_s


class InProcessPort:
    """Hands what is written to `device.receive`; each answer passes the next of `damages`, if any."""

    def __init__(self, device, name: str = "test-port", clock=None):
        self.name = name
        self.clock = clock or ReadClock()
        self.device = device
        self.sent = b""
        self.damages: list[str] = []
        self.closed = False
        self._arrived = b""
        self._held = b""

    def write(self, data: bytes) -> None:
        self.sent += data
        self._deliver(self.device.receive(data))

    def waiting(self) -> int:
        self._deliver(self.device.emit())
        return len(self._arrived)

    def read_some(self) -> bytes:
        for _ in range(round(EMPTY_READ_S / READ_S)):
            waits = self.waiting()
            self.clock.sleep(READ_S)
            if waits:
                break
        data, self._arrived = self._arrived, b""
        return data

    def push(self, data: bytes) -> None:
        """Something that the controller says unasked."""
        self._arrived += data

    def lose_what_is_said(self) -> None:
        """What the controller has said up to now never arrives."""
        self.device.emit()
        self._arrived = self._held = b""

    def close(self) -> None:
        self.closed = True

    def _deliver(self, answer: bytes) -> None:
        if not answer:
            return
        held, self._held = self._held, b""
        self._arrived += held
        kind = self.damages.pop(0) if self.damages else "sound"
        if kind == "late":
            self._held = answer
        else:
            self._arrived += DAMAGES[kind](answer)


DAMAGES: dict[str, Damage] = {
    "sound": lambda answer: answer,
    "lost": lambda answer: b"",
    "cut": lambda answer: answer[: len(answer) // 2],
    "headless": lambda answer: answer[len(answer) // 2 :],
    "merged": lambda answer: answer.replace(b"\r", b"").replace(b"\n", b""),
    "doubled": lambda answer: answer + answer,
    "corrupt": lambda answer: answer[:1] + b"\xfe" + answer[2:],
    "nul": lambda answer: b"\0" + answer,
    "noisy": lambda answer: b"\xf7\x80\r\n" + answer,
}
KINDS = [*DAMAGES, "late"]


def simulated(driver: str, clock=None, **options) -> InProcessPort:
    """A simulated controller on a perfect stage, two hundred times faster than its port."""
    settings = SimulatorSettings.from_options({"preset": "ideal", **options})
    stage = settings.stage.model_copy(update={"driver": driver})
    clock = clock or ReadClock()
    device = stage_of(driver)(stage, Bench(settings), lambda: 200 * clock.now_s())
    return InProcessPort(device, f"simulated-{driver}-{id(device)}", clock)


def until_it_stands(stage) -> str:
    """Polls until a stage is neither moving nor homing; its state then."""
    for _ in range(POLLS):
        state = stage.status().state
        if state not in {"moving", "homing"}:
            return state
    raise AssertionError("it moves on and on")


def homed(stage):
    """The stage, homed."""
    stage.identify()
    stage.home()
    assert until_it_stands(stage) == "ready"
    return stage


def moved_to(stage, target_deg: float):
    """The stage, standing at a target."""
    stage.move(target_deg)
    for _ in range(POLLS):
        if until_it_stands(stage) != "ready" or abs(stage.position_deg() - target_deg) <= 0.01:
            return stage
    raise AssertionError(f"it does not come to {target_deg}°")
