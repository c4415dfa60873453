"""Standstill and position of a stage whose replies carry no checksum: accepted only when reported twice.

`confirm_standstill` repeats the stop until two consecutive reports show the stage at rest at one angle.
"""

import math
from collections import Counter
from collections.abc import Callable
from itertools import pairwise

from calrig.instruments.clock import Clock
from calrig.instruments.errors import InstrumentError, PortBlocked, StageError
from calrig.instruments.types import Stage

AGREE_DEG = 0.01
MOST_READS = 5


def agree(one_deg: float, other_deg: float) -> bool:
    """Whether two angles are one."""
    return abs(one_deg - other_deg) <= AGREE_DEG


def position_deg(
    name: str, glimpse_deg: Callable[[], float], moves: Callable[[], bool], faults: Counter[str]
) -> float:
    """Return the position at rest: two reads in a row that agree, three on a link with faults.

    Raises:
        StageError: the reads differ although the stage is at rest.
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


LOOKS_APART_S = 0.05
"""Between two reports: it reveals a stage that reports standstill and creeps at more than 0.2°/s."""
IN_MOTION = ("moving", "homing")
CUT = "cut its motor power"
"""What to do about a stage without confirmed standstill."""


def confirm_standstill(stage: Stage, clock: Clock, timeout_s: float) -> None:
    """Halt a stage, and repeat the stop until two consecutive reports show it at rest at one angle.

    A stage at rest in its first report gets one more report, however late that was: opening its port may
    have reset its controller, which answers nothing until it has booted. A query without a reply says
    nothing about the stage; the reports before and after it are compared.

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
    """Describe how the last reports differ.

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
