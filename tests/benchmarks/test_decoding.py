"""Packets decoded per second: calrig's decoder beside cobs.decode and struct, one packet after the other.

Run with `pytest tests/benchmarks/test_decoding.py --benchmark-group-by=group`; both take the same second of
4000 samples, in pieces of 25 ms as the driver reads them.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections import Counter

import pytest
from cobs import cobs

from calrig.instruments.boards.calrig.driver import SampleStream
from calrig.instruments.boards.calrig.packets import PacketDecoder
from calrig.instruments.types import BoardIdentity

RATE_HZ = 4000
PIECE = 25 * 100
IDENTITY = BoardIdentity("calrig", "1.0", "", "MPU-6050", 2, 250, 8000)


def _packet(k):
    registers = (k % 1000 + 1, 20, 16384, -512, k % 7, 0, 0)
    body = struct.pack("<BHI7h", 2, k % 65536, 250 * k, *registers)
    return cobs.encode(body + struct.pack("<H", crc_hqx(body, 0xFFFF))) + b"\0"


@pytest.fixture(scope="module")
def pieces():
    stream = b"".join(_packet(k) for k in range(RATE_HZ))
    return [stream[at : at + PIECE] for at in range(0, len(stream), PIECE)]


@pytest.mark.benchmark(group="4000 packets")
def test_calrigs_decoder(benchmark, pieces):
    def decode():
        faults = Counter()
        packets, stream = PacketDecoder(faults), SampleStream(IDENTITY, RATE_HZ, faults)
        n = sum(len(stream.push(packets.feed(piece))) for piece in pieces)
        return n, faults

    assert benchmark(decode) == (RATE_HZ, Counter())
    if benchmark.enabled:
        benchmark.extra_info["packets_per_s"] = RATE_HZ / benchmark.stats["mean"]


@pytest.mark.benchmark(group="4000 packets")
def test_a_packet_at_a_time(benchmark, pieces):
    """The peer: as one would write it first, with the same checks of CRC and seq."""

    def decode():
        out, tail, before = [], b"", -1
        for piece in pieces:
            *frames, tail = (tail + piece).split(b"\0")
            for frame in frames:
                packet = cobs.decode(frame)
                (crc,) = struct.unpack("<H", packet[-2:])
                assert crc == crc_hqx(packet[:-2], 0xFFFF)
                _, seq, t_us, ax, ay, az, temp, gx, gy, gz = struct.unpack("<BHI7h", packet[:-2])
                assert seq == (before + 1) % 65536
                before = seq
                accel = [raw * 2 / 32768 for raw in (ax, ay, az)]
                gyro = [raw * 250 / 32768 for raw in (gx, gy, gz)]
                out.append((t_us * 1e-6, accel, gyro, temp / 340 + 36.53))
        return len(out)

    assert benchmark(decode) == RATE_HZ
    if benchmark.enabled:
        benchmark.extra_info["packets_per_s"] = RATE_HZ / benchmark.stats["mean"]
