"""The board's packets (CONTRACT 3.1): type, payload, CRC-16/CCITT-FALSE, COBS, one zero byte."""

from __future__ import annotations

import binascii

import numpy as np
from cobs import cobs  # type: ignore[import-untyped]

from calrig.simulator.imu import Counts
from calrig.simulator.trajectory import FloatArray

IDENTITY, SAMPLE, ERROR, ACKNOWLEDGE = 0x01, 0x02, 0x03, 0x04
MICROSECONDS = 1e6
SEQUENCE_LENGTH = 1 << 16
CLOCK_LENGTH_US = 1 << 32

_SAMPLE_LAYOUT = np.dtype([("type", "u1"), ("seq", "<u2"), ("t_us", "<u4"), ("counts", "<i2", (7,))])


def packet(kind: int, payload: bytes) -> bytes:
    """One packet as it goes over the wire."""
    return _framed(bytes([kind]) + payload)


def sample_packets(first_seq: int, times_s: FloatArray, counts: Counts) -> list[bytes]:
    """One packet a sample.

    Args:
        first_seq: number of the first sample since `START`; wraps at 16 bits on the wire.
        times_s: (n,) the board's clock; wraps at 32 bits of microseconds.
        counts: (n, 7) ax ay az temp gx gy gz.
    """
    rows = np.empty(len(times_s), dtype=_SAMPLE_LAYOUT)
    rows["type"] = SAMPLE
    rows["seq"] = (first_seq + np.arange(len(times_s))) % SEQUENCE_LENGTH
    rows["t_us"] = np.rint(times_s * MICROSECONDS).astype(np.int64) % CLOCK_LENGTH_US
    rows["counts"] = counts
    block, size = rows.tobytes(), _SAMPLE_LAYOUT.itemsize
    return [_framed(block[start : start + size]) for start in range(0, len(block), size)]


def _framed(body: bytes) -> bytes:
    crc = binascii.crc_hqx(body, 0xFFFF)  # polynomial 0x1021: CRC-16/CCITT-FALSE
    encoded: bytes = cobs.encode(body + crc.to_bytes(2, "little"))
    return encoded + b"\0"
