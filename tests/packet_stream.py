"""What a board of driver `calrig` sends, of any length, made by the simulator's own encoder."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.instruments.boards.calrig.driver import READ_EVERY_S
from calrig.instruments.types import BoardIdentity
from calrig.simulator.board import sample_packets

MPU = BoardIdentity("calrig", "1.0", "", "MPU-6050", 2, 250, 1000)
BLOCK = 10_000
ONE_G = 16384


def sample_blocks(n_samples: int, rate_hz: int) -> Iterator[list[bytes]]:
    """Blocks of 10 000 samples, a packet each.

    The registers are those of a board that lies still; seq and clock go on from block to block, wrapping as
    they do on the wire.
    """
    counts = np.rint(np.random.default_rng(0).normal(0.0, 30.0, (BLOCK, 7))).astype(np.int16)
    counts[:, 2] += ONE_G
    for first in range(0, n_samples, BLOCK):
        times_s = np.arange(first, min(first + BLOCK, n_samples)) / rate_hz
        yield sample_packets(first, times_s, counts[: len(times_s)])


def as_read(packets: list[bytes], rate_hz: int) -> list[bytes]:
    """The packets in the pieces in which the driver reads them: 25 a second."""
    size = max(round(rate_hz * READ_EVERY_S), 1)
    return [b"".join(packets[at : at + size]) for at in range(0, len(packets), size)]
