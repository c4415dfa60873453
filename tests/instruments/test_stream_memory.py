"""However long a board streams, decoding keeps nothing of it."""

from __future__ import annotations

from collections import Counter

import psutil
import pytest
from packet_stream import BLOCK, MPU, sample_blocks

from calrig.instruments.boards.calrig.driver import SampleStream
from calrig.instruments.boards.calrig.packets import PacketDecoder

RATE_HZ = 200
N_SAMPLES = 500_000
PIECE = 200
MOST_GROWTH_MB = 20.0
"""The packets' own bytes objects alone would take 27 MB, the samples 36 MB."""


def test_decoding_half_a_million_samples_keeps_none_of_them():
    """The clock wraps once in that many, seq seven times."""
    faults = Counter()
    decoder, stream = PacketDecoder(faults), SampleStream(MPU, RATE_HZ, faults)
    process = psutil.Process()
    rss_mb, n_samples = [], 0
    for packets in sample_blocks(N_SAMPLES, RATE_HZ):
        for at in range(0, BLOCK, PIECE):
            samples = stream.push(decoder.feed(b"".join(packets[at : at + PIECE])))
            n_samples += len(samples)
        rss_mb.append(process.memory_info().rss / 1e6)
    assert (n_samples, faults) == (N_SAMPLES, Counter())
    assert samples.time_s[-1] == pytest.approx((N_SAMPLES - 1) / RATE_HZ, abs=1e-9)
    assert max(rss_mb) - rss_mb[0] < MOST_GROWTH_MB
