"""Newport SMC100."""

import re
from collections.abc import Sequence

from calrig.instruments.device import Identity, Probe, StageDevice, opened_by

BAUDRATE = 57600
LIMIT = re.compile(r"1SL\s*[-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?")
VERSION = re.compile(r"1VE\s*(\S.*)")


def _identity(lines: Sequence[str]) -> Identity:
    versions = [reply[1].strip() for line in lines if (reply := VERSION.fullmatch(line))]
    return Identity(versions[0] if versions else "at address 1", 1)


DEVICE = StageDevice(
    driver="smc100",
    title="Newport SMC100",
    baudrate=BAUDRATE,
    opens=opened_by(f"{__name__}.driver"),
    probes=(
        Probe(
            BAUDRATE,
            0.5,
            b"1SL?\r\n1SL?\r\n",
            harmless="asks for its lower limit, the second time with nothing before it; others know no SL",
        ),
    ),
    matches=lambda line: bool(LIMIT.fullmatch(line) or VERSION.fullmatch(line)),
    identity=_identity,
    version_query=b"1VE\r\n",
)
