"""A decoder of the board's packets, written from CONTRACT 3.1 with the public libraries alone."""

from __future__ import annotations

import binascii
import struct
from typing import NamedTuple

from cobs import cobs


class Packet(NamedTuple):
    kind: int
    payload: bytes

    @property
    def text(self) -> str:
        return self.payload.decode()

    @property
    def sample(self) -> tuple[int, ...]:
        return struct.unpack("<HI7h", self.payload)


def decode(stream: bytes) -> list[Packet]:
    *frames, rest = stream.split(b"\0")
    assert rest == b""
    bodies = [cobs.decode(frame) for frame in frames]
    for body in bodies:
        assert binascii.crc_hqx(body[:-2], 0xFFFF) == int.from_bytes(body[-2:], "little")
    return [Packet(body[0], body[1:-2]) for body in bodies]
