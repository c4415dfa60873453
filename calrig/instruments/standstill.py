"""What is accepted of a controller whose words carry no checksum: only what it says twice, or says back.

A stop that is seen: a stage is told to stop until it says that it stands, twice at one angle.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from calrig.instruments.clock import Clock
from calrig.instruments.errors import InstrumentError, PortBlocked, StageError
from calrig.instruments.types import Stage

AGREE_DEG = 0.01
NEAR_DEG = 0.5
MOST_READS = 5
MOST_SENT = 5


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a command was refused, in words, and whether it may have been damaged on its way."""

    words: str
    perhaps_damaged: bool


def agree(one_deg: float, other_deg: float) -> bool:
    """Whether two angles are one."""
    return abs(one_deg - other_deg) <= AGREE_DEG


def position_deg(
    name: str, glimpse_deg: Callable[[], float], moves: Callable[[], bool], faults: Counter[str]
) -> float:
    """Where a standing stage says it is: two reads in a row that agree, three on a wire with faults.

    Raises:
        StageError: it stands and yet never says the same twice.
    """
    for _ in range(MOST_READS):
        reads = [glimpse_deg() for _ in range(3 if faults.total() else 2)]
        if agree(max(reads), min(reads)) or moves():
            return reads[-1]
    said = ", ".join(f"{read:g}" for read in reads)
    raise StageError(
        f"{name}: readings of its position in a row differ ({said}) though it stands: "
        "check the encoder and the serial cable"
    )


def setting(name: str, query: str, ask: Callable[[], float | None]) -> float | None:
    """A setting of the controller, twice alike in a row; None where it does not answer.

    Raises:
        StageError: it never says the same twice.
    """
    last = None
    for _ in range(MOST_READS):
        said = ask()
        if said is None or said == last:
            return said
        last = said
    raise StageError(f"{name} answers {query} otherwise each time: check the serial cable")


@dataclass(frozen=True, slots=True)
class Mover:
    """A controller that can be told to go to an angle.

    Attributes:
        name: who it is.
        faults: counts by kind.
        position_deg, moves, halt: as they say.
        target_deg: the target it says it has; None where it says none.
    """

    name: str
    faults: Counter[str]
    position_deg: Callable[[], float]
    moves: Callable[[], bool]
    halt: Callable[[], None]
    target_deg: Callable[[], float | None]

    def move(self, command: str, target_deg: float, send: Callable[[], Refusal | None]) -> None:
        """Sends a move and sees that the controller took its target; sends it again where it took none.

        Raises:
            StageError: it was refused, or taken for another and stopped.
        """
        stood_deg = self.position_deg()
        for _ in range(MOST_SENT):
            refusal = send()
            took_deg = self._took_deg(target_deg)
            if took_deg is None or (refusal is None and agree(took_deg, target_deg)):
                break
            moved = self.moves() or not agree(self.position_deg(), stood_deg)
            if moved and agree(took_deg, target_deg):
                return  # it goes where it was sent: what it said of a refusal was damaged
            if self._says_where_it_is(took_deg):
                break
            if moved:
                self.halt()
                raise StageError(
                    f"{self.name} took {command} for a move to {took_deg:g} and was stopped: "
                    "check the serial cable"
                )
            if refusal is not None and not refusal.perhaps_damaged:
                break
            self.faults["resent"] += 1
        else:
            if refusal is None:
                raise StageError(
                    f"{self.name} takes no notice of {command}: its target stays {took_deg:g}; "
                    "check the serial cable"
                )
        if refusal is not None:
            raise StageError(f"{self.name} refused {command}: {refusal.words}")

    def _says_where_it_is(self, took_deg: float) -> bool:
        """Whether what it gives for its target is its place on the way: then it tells no target at all."""
        return abs(took_deg - self.position_deg()) < NEAR_DEG and self.moves()

    def _took_deg(self, sent_deg: float) -> float | None:
        said_deg = self.target_deg()
        return said_deg if said_deg is None or agree(said_deg, sent_deg) else self.target_deg()


def velocity(
    name: str, velocity_dps: float, send: Callable[[], None], ask: Callable[[], float | None]
) -> None:
    """Sets a velocity and asks whether it was taken as it was sent; None where that is not known.

    Raises:
        StageError: it was not.
    """
    for _ in range(MOST_SENT):
        send()
        took_dps = ask()
        if took_dps is None or math.isclose(took_dps, velocity_dps, rel_tol=0.01):
            return
    raise StageError(f"{name} was told a velocity of {velocity_dps:g} and says it is {took_dps:g}")


LOOKS_APART_S = 0.05
"""Between two looks: a stage that says it stands, and creeps on at more than 0.2°/s, is found out."""
IN_MOTION = ("moving", "homing")
CUT = "cut its motor power"
"""What is left to do about a stage that is not known to stand."""


def confirm_standstill(stage: Stage, clock: Clock, timeout_s: float) -> None:
    """Halts a stage, and goes on sending stop until two looks in a row find it standing at one angle.

    One that stood when it was first seen is looked at once more, however late that was: opening its port may
    have reset its controller, which answers nothing until it has woken up. A look that is not answered says
    nothing of the stage, and the looks before and after it are compared.

    Raises:
        StageError: it still moves, whatever it says of itself, or does not answer, after timeout_s: only
            cutting its power is left.
        PortError: the port is gone.
    """
    deadline_s = clock.now_s() + timeout_s
    seen_deg: list[float] = []
    while True:
        failure: InstrumentError | None = None
        try:
            stage.halt()
            status = stage.status()
            said = f"it says {status.words}"
            if status.state in IN_MOTION:
                seen_deg = []
            else:
                seen_deg = [*seen_deg[-2:], stage.glimpse_deg()]
                if len(seen_deg) > 1 and agree(*seen_deg[-2:]):
                    return
                said += _unlike(seen_deg)
                if len(seen_deg) == 1:
                    clock.sleep(LOOKS_APART_S)
                    continue
        except (StageError, PortBlocked) as error:
            failure, said = error, str(error)
        if clock.now_s() > deadline_s:
            raise StageError(
                f"the stage is not known to stand {timeout_s:g} s after it was told to stop ({said}): {CUT}"
            ) from failure
        clock.sleep(LOOKS_APART_S)


def _unlike(seen_deg: list[float]) -> str:
    """What the last looks say where they differ.

    One report may have been damaged on the wire. So the stage is said to turn only where three in a row go
    the same way, and by no more than the smaller of the two steps.
    """
    if len(seen_deg) < 2:
        return ""
    steps_deg = [after - before for before, after in pairwise(seen_deg)]
    smaller_deg = min(steps_deg, key=abs)
    if len(steps_deg) == 2 and math.prod(steps_deg) > 0.0 and not agree(smaller_deg, 0.0):
        return f", and turned by {smaller_deg:.2f}° meanwhile"
    return f", and its reports differ ({', '.join(f'{angle_deg:.2f}°' for angle_deg in seen_deg)})"
