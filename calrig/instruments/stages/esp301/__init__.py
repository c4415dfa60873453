"""Newport ESP301."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from calrig.instruments.device import Identity, Probe, StageDevice

if TYPE_CHECKING:
    from calrig.instruments.stages.esp301.driver import Esp301

BAUDRATE = 19200
VERSION = re.compile(r"ESP30\d\b.*")


def _open(url: str, *, axis: int, baudrate: int | None) -> Esp301:
    from calrig.instruments.stages.esp301.driver import Esp301

    return Esp301.open(url, axis=axis, baudrate=baudrate)


DEVICE = StageDevice(
    driver="esp301",
    title="Newport ESP301",
    baudrate=BAUDRATE,
    opens=_open,
    probes=(
        Probe(
            BAUDRATE,
            0.5,
            b"VE?\rVE?\r",
            harmless="asks for its version, the second time with nothing before it; others know no VE?",
        ),
    ),
    matches=lambda line: VERSION.fullmatch(line) is not None,
    identity=lambda lines: Identity(lines[0].strip()),
    version_query=b"",
)
