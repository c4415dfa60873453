"""Newport ESP301."""

import re

from calrig.instruments.device import Identity, Probe, StageDevice, opened_by

BAUDRATE = 19200
VERSION = re.compile(r"ESP30\d\b.*")


DEVICE = StageDevice(
    driver="esp301",
    title="Newport ESP301",
    baudrate=BAUDRATE,
    opens=opened_by(f"{__name__}.driver"),
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
