"""What was found on the ports, as it goes into `calrig.toml`."""

from __future__ import annotations

import json
from collections.abc import Container, Iterable, Sequence
from itertools import count

from calrig.instruments.drivers import BOARDS
from calrig.instruments.ports import USB
from calrig.instruments.scan import Found

CHECK = "# before the first run: check limits_deg, and on the stage itself zero_deg and sign"
NO_BOARD = '# imu = { driver = "calrig", port = "…" }   # no board was found'


def stanza(found: Sequence[Found], taken: Container[str] = ()) -> str:
    """A `[[rig]]` for each stage found, ready to be pasted; "" where there is none.

    One stage and one board are taken for a pair. Otherwise each board stands in each rig as a comment, of
    which one is to be chosen.

    Args:
        found: what `scan` gave.
        taken: names that rigs already have.
    """
    stages = [one for one in found if one.kind == "stage"]
    boards = [_imu(one, found) for one in found if one.kind == "board"]
    if len(stages) > 1 or len(boards) > 1:
        boards = [f"# {line}   # its board? then take the # away" for line in boards]
    names = (name for n in count(1) if (name := f"bench-{n}") not in taken)
    return "\n".join(
        "\n".join(
            [
                "[[rig]]",
                f'name = "{next(names)}"',
                "limits_deg = [-90.0, 90.0]",
                _stage(stage, found),
                *(boards or [NO_BOARD]),
                CHECK,
                "",
            ]
        )
        for stage in stages
    )


def _stage(stage: Found, all_found: Iterable[Found]) -> str:
    axis = 1 if stage.axis is None else stage.axis
    turn = f"axis = {axis}, zero_deg = 0.0, sign = 1, ratio = 1.0"
    return f"stage = {{ {_device(stage, all_found)}, {turn} }}"


def _imu(board: Found, all_found: Iterable[Found]) -> str:
    device = BOARDS.get(board.driver or "")
    usual = (None, device and device.baudrate)
    rate = "" if board.baudrate in usual else f", baudrate = {board.baudrate}"
    return f"imu = {{ {_device(board, all_found)}{rate} }}"


def _device(one: Found, all_found: Iterable[Found]) -> str:
    sharing = [other for other in all_found if other.usb_serial == one.usb_serial]
    bound = one.usb_serial is not None and len(sharing) == 1  # some adapters all have the same number
    port = f"{USB}{one.usb_serial}" if bound else one.port
    return f'driver = "{one.driver}", port = {json.dumps(port, ensure_ascii=False)}'
