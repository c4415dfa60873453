"""A stop that is seen: a stage is told to stop until it says that it stands, twice at one angle."""

from __future__ import annotations

from calrig.instruments.clock import Clock
from calrig.instruments.errors import InstrumentError, PortBlocked, StageError
from calrig.instruments.readback import agree
from calrig.instruments.types import Stage

LOOKS_APART_S = 0.05
"""Between two looks: a stage that says it stands, and creeps on at more than 0.2°/s, is found out."""
IN_MOTION = ("moving", "homing")


def stop_until_it_stands(stage: Stage, clock: Clock, timeout_s: float) -> None:
    """Halts a stage, and goes on sending stop until two looks in a row find it standing at one angle.

    One that stood when it was first seen is looked at once more, however late that was: opening its port may
    have reset its controller, which answers nothing until it has woken up.

    Raises:
        StageError: it still moves, whatever it says of itself, or does not answer, after timeout_s: only
            cutting its power is left.
        PortError: the port is gone.
    """
    deadline_s = clock.now_s() + timeout_s
    before_deg: float | None = None
    while True:
        failure: InstrumentError | None = None
        try:
            stage.halt()
            status, here_deg = stage.status(), stage.glimpse_deg()
        except (StageError, PortBlocked) as error:
            failure, before_deg, said = error, None, str(error)
        else:
            said = f"it says {status.words}"
            if status.state in IN_MOTION:
                before_deg = None
            elif before_deg is None:
                before_deg = here_deg
                clock.sleep(LOOKS_APART_S)
                continue
            elif agree(before_deg, here_deg):
                return
            else:
                said += f", and turned by {here_deg - before_deg:.2g}° meanwhile"
                before_deg = here_deg
        if clock.now_s() > deadline_s:
            raise StageError(
                f"the stage is not known to stand {timeout_s:g} s after it was told to stop ({said}): "
                "cut its motor power"
            ) from failure
        clock.sleep(LOOKS_APART_S)
