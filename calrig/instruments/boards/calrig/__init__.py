"""Boards that speak calrig's own packets."""

from collections.abc import Sequence

from calrig.instruments.boards.calrig.packets import BAUDRATE, IDENTITY, PacketDecoder
from calrig.instruments.device import BoardDevice, Identity, Probe, opened_by


def _identities(heard: bytes) -> list[str]:
    packets = PacketDecoder().feed(heard)
    return [packet[1:].decode("utf-8", "replace") for packet in packets if packet[0] == IDENTITY]


def _matches(text: str) -> bool:
    from calrig.instruments.boards.calrig.words import identity_document

    try:
        identity_document(text)
    except ValueError:
        return False  # its CRC holds, but it is no identity of the contract's
    return True


def _identity(texts: Sequence[str]) -> Identity:
    from calrig.instruments.boards.calrig.words import read_identity

    try:
        board = read_identity(texts[0])
    except ValueError as error:
        return Identity(f"an identity that cannot be used ({error})")
    unit = f"unit {board.serial}" if board.serial else "no serial number"
    return Identity(", ".join(part for part in (unit, board.firmware, board.chip) if part))


DEVICE = BoardDevice(
    driver="calrig",
    title="calrig's own sketch, or anything that speaks its packets",
    baudrate=BAUDRATE,
    opens=opened_by(f"{__name__}.driver"),
    may_stay_open=True,
    probes=(
        Probe(
            BAUDRATE,
            0.5,
            b"ID\nID\n",
            harmless="asks who it is, the second time with nothing before it; to GRBL it is a letter without "
            "its number (error:2, nothing is done), a sketch heeds nothing or begins to measure",
        ),
    ),
    matches=_matches,
    identity=_identity,
    version_query=b"",
    messages=_identities,
)
