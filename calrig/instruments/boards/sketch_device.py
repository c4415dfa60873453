"""The device that a board with somebody's sketch is, made of the sketch's record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from calrig.instruments.boards.sketch import Sketch
from calrig.instruments.device import BoardDevice, Identity, Probe

if TYPE_CHECKING:
    from calrig.instruments.boards.sketch_board import SketchBoard


def board_device(sketch: Sketch) -> BoardDevice:
    """The device that a board with this sketch is. It speaks unasked, and is asked nothing."""

    def opens(url: str, *, baudrate: int | None) -> SketchBoard:
        from calrig.instruments.boards.sketch_board import SketchBoard

        return SketchBoard.open(url, sketch=sketch, baudrate=baudrate)

    def identity(_: Sequence[str]) -> Identity:
        return Identity(sketch.source)

    return BoardDevice(
        driver=sketch.driver,
        title=sketch.source,
        baudrate=sketch.baudrate,
        opens=opens,
        may_stay_open=not sketch.zeroes_at_reset,
        probes=(Probe(sketch.baudrate, sketch.heard_within_s),),
        matches=sketch.prints,
        identity=identity,
        version_query=b"",
    )
