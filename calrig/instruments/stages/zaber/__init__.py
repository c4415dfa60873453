"""Zaber rotary stages."""

import re
from collections.abc import Sequence

from calrig.instruments.device import Identity, Probe, StageDevice, opened_by

BAUDRATE = 115200
REPLY = re.compile(r"@(\d{2}) 0 OK (?:IDLE|BUSY) (?:--|[A-Z]{2}) (\d+(?:\.\d+)*)(?::[0-9A-F]{2})?")


def _identity(lines: Sequence[str]) -> Identity:
    replies = [reply for line in lines if (reply := REPLY.fullmatch(line))]
    first = int(replies[0][1])
    versions = [reply[2] for reply in replies if int(reply[1]) == first and "." in reply[2]]
    others = sorted({int(reply[1]) for reply in replies} - {first})
    words = [f"firmware {versions[0]}"] if versions else []
    if others:
        words.append(f"and behind it addresses {', '.join(map(str, others))}")
    return Identity(", ".join([f"at address {first}", *words]), first)


DEVICE = StageDevice(
    driver="zaber",
    title="Zaber rotary stages, through the maker's library: `pip install 'calrig[zaber]'`",
    baudrate=BAUDRATE,
    opens=opened_by(f"{__name__}.driver"),
    probes=(
        Probe(
            BAUDRATE,
            0.3,
            b"ID\n/\n",
            harmless="asks every device whether it is there, after a line that ends what was half sent; "
            "GRBL drops the `/`, and an empty line is none",
        ),
    ),
    matches=lambda line: REPLY.fullmatch(line) is not None,
    identity=_identity,
    version_query=b"/get version\n",
)
