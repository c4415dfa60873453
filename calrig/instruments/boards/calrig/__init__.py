"""Boards that speak calrig's own packets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from calrig.instruments.boards.calrig.packets import IDENTITY, PacketDecoder
from calrig.instruments.device import BoardDevice, Identity, Probe

if TYPE_CHECKING:
    from calrig.instruments.boards.calrig.driver import CalrigBoard


def _open(url: str, *, baudrate: int | None) -> CalrigBoard:
    from calrig.instruments.boards.calrig.driver import CalrigBoard

    return CalrigBoard.open(url, baudrate=baudrate)


def _identities(heard: bytes) -> list[str]:
    packets = PacketDecoder().feed(heard)
    return [packet[1:].decode("utf-8", "replace") for packet in packets if packet[0] == IDENTITY]


def _document(text: str) -> dict[str, Any] | None:
    try:
        said = json.loads(text)
    except ValueError:
        return None  # its CRC holds, but it is no identity of the contract's
    return said if isinstance(said, dict) else None


def _matches(text: str) -> bool:
    return _document(text) is not None


def _identity(texts: Sequence[str]) -> Identity:
    said = _document(texts[0]) or {}
    unit = f"unit {said['serial']}" if said.get("serial") else "no serial number"
    parts = [unit, said.get("firmware"), said.get("chip")]
    return Identity(", ".join(str(part) for part in parts if part))


DEVICE = BoardDevice(
    driver="calrig",
    title="calrig's own sketch, or anything that speaks its packets",
    baudrate=115200,
    opens=_open,
    probes=(
        Probe(
            115200,
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
