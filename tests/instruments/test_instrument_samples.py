from __future__ import annotations

import itertools
import random
import struct
from collections import Counter

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from packet_stream import BLOCK, MPU, sample_blocks

from calrig.instruments.boards.calrig.driver import SampleStream
from calrig.instruments.boards.calrig.packets import PacketDecoder
from calrig.instruments.types import BoardIdentity, Samples

RATE_HZ = 200
PERIOD_US = 5000


def body(seq, t_us, registers):
    return struct.pack("<BHI7h", 2, seq % 2**16, t_us % 2**32, *registers)


def living(k):
    """Registers that differ from sample to sample."""
    return (k % 1000 + 1, 20, 16384, -512, k % 7, 0, 0)


def samples_of(bodies, rate_hz=RATE_HZ):
    faults = Counter()
    return SampleStream(MPU, rate_hz, faults).push(bodies), faults


def one_by_one(records):
    """Oracle: the rules of the contract applied to one sample after the other, in plain Python."""
    faults, out = Counter(), []
    seq, t_us, motion, time_us = -1, None, None, -PERIOD_US
    for raw_seq, raw_t, registers in records:
        step = (raw_seq - seq) % 2**16
        if step == 0 or step >= 2**15:
            faults["repeated"] += 1
            continue
        faults["sequence_gap"] += step - 1
        expected = step * PERIOD_US
        clock = expected if t_us is None else (raw_t - t_us) % 2**32
        jumped = clock == 0 or abs(clock - expected) > max(expected / 2, 50_000)
        seq, t_us = seq + step, raw_t
        time_us += expected if jumped else clock
        is_frozen = motion == registers[:3] + registers[4:] or not any(registers)
        motion = registers[:3] + registers[4:]
        faults["clock_jump"] += jumped
        faults["frozen"] += is_frozen
        if not jumped and not is_frozen:
            out.append((time_us / 1e6, registers))
    return out, +faults


@st.composite
def records(draw):
    """Samples with gaps, doubles, jumps of the clock and frozen registers, near both wraps."""
    seq, t_us = 0, draw(st.sampled_from([0, 2**32 - 20_000]))
    out = []
    for k in range(draw(st.integers(1, 40))):
        what = draw(
            st.sampled_from(["good"] * 6 + ["gap", "double", "old", "jump", "stuck", "frozen", "zero"])
        )
        if what == "gap":
            lost = draw(st.integers(1, 30_000))
            seq, t_us = seq + lost, t_us + lost * PERIOD_US
        t_us += draw(st.integers(-1_000_000_000, 1_000_000_000)) if what == "jump" else 0
        t_us -= PERIOD_US if what == "stuck" else 0
        registers = {"frozen": out[-1][2] if out else living(k), "zero": (0,) * 7}.get(what, living(k))
        out.append((seq % 2**16, t_us % 2**32, registers))
        if what in ("double", "old"):
            out.append(out[-1 if what == "double" else draw(st.integers(0, len(out) - 1))])
        seq, t_us = seq + 1, t_us + PERIOD_US + draw(st.integers(-2000, 2000))
    return out


def test_registers_are_read_at_full_scale():
    block, _ = samples_of([body(0, 0, (16384, -32768, 32767, -512, 131, -32768, 16384))])
    np.testing.assert_allclose(block.accel_g, [[1.0, -2.0, 2 * 32767 / 32768]], rtol=1e-15)
    np.testing.assert_allclose(block.gyro_dps, [[131 * 250 / 32768, -250.0, 125.0]], rtol=1e-15)
    np.testing.assert_allclose(block.temperature_c, [-512 / 340 + 36.53], rtol=1e-15)


def test_other_ranges_scale_with_them():
    wide = BoardIdentity("calrig", "1.0", "", "MPU-6050", 16, 2000, 1000)
    block = SampleStream(wide, RATE_HZ, Counter()).push([body(0, 0, (16384, 1, 1, 0, 16384, 1, 1))])
    assert block.accel_g[0, 0] == 8.0
    assert block.gyro_dps[0, 0] == 1000.0


def test_a_filtered_sample_is_a_sample_too():
    filtered = body(0, 0, living(0)).replace(b"\x02", b"\x05", 1) + b"\x10\x27"
    block, faults = samples_of([filtered, body(1, PERIOD_US, living(1))])
    assert len(block) == 2
    assert not faults


def test_time_is_the_boards_clock_since_start_across_both_wraps():
    n = 70_000
    start_us = 2**32 - 30_000 * PERIOD_US
    block, faults = samples_of([body(k, start_us + k * PERIOD_US, living(k)) for k in range(n)])
    np.testing.assert_allclose(block.time_s, np.arange(n) * 0.005, atol=1e-9)
    assert not faults


def test_samples_lost_before_the_first_are_a_gap():
    block, faults = samples_of([body(3, 777, living(0))])
    assert block.time_s[0] == pytest.approx(0.015)
    assert faults == {"sequence_gap": 3}


@given(records(), st.integers(1, 10))
def test_a_stream_is_what_the_rules_make_of_it_sample_by_sample(stream, blocks):
    faults = Counter()
    decoder = SampleStream(MPU, RATE_HZ, faults)
    bodies = [body(*record) for record in stream]
    cut = [len(bodies) * k // blocks for k in range(blocks + 1)]
    block = Samples.join([decoder.push(bodies[a:b]) for a, b in itertools.pairwise(cut)])
    expected, expected_faults = one_by_one(stream)
    assert faults == expected_faults
    np.testing.assert_allclose(block.time_s, [time_s for time_s, _ in expected], atol=1e-9)
    assert [round(x * 16384) for x in block.accel_g[:, 0]] == [registers[0] for _, registers in expected]
    assert (np.diff(block.time_s) > 0).all()


def test_a_sample_from_long_ago_is_repeated_however_the_stream_is_cut():
    """Two long gaps, then the first sample once more: its seq lies ahead of the last the nearer way round."""
    stream = [(seq % 2**16, seq * PERIOD_US % 2**32, living(k)) for k, seq in enumerate((0, 30_000, 60_000))]
    stream.insert(2, stream[0])
    bodies = [body(*record) for record in stream]
    for cut in range(len(bodies) + 1):
        faults = Counter()
        decoder = SampleStream(MPU, RATE_HZ, faults)
        taken = Samples.join([decoder.push(part) for part in (bodies[:cut], bodies[cut:])])
        assert len(taken) == 3
        assert faults == {"sequence_gap": 2 * 29_999, "repeated": 1}


@pytest.mark.parametrize("jump_us", [-PERIOD_US, 60_000, -60_000, 500_000, -500_000, 2**31])
def test_a_clock_jump_costs_one_sample_and_time_goes_on(jump_us):
    stream = [body(k, k * PERIOD_US + (jump_us if k >= 5 else 0), living(k)) for k in range(10)]
    block, faults = samples_of(stream)
    np.testing.assert_allclose(block.time_s, [k * 0.005 for k in range(10) if k != 5], atol=1e-9)
    assert faults == {"clock_jump": 1}


def test_a_chip_that_rounds_the_rate_and_a_late_sketch_are_no_jump():
    rng = random.Random(1)
    stream = [body(k, k * 3000 + rng.randint(-300, 300), living(k)) for k in range(500)]
    block, faults = samples_of(stream, rate_hz=300)
    assert len(block) == 500
    assert not faults


def test_after_a_restart_time_goes_on_by_what_has_passed():
    faults = Counter()
    decoder = SampleStream(MPU, RATE_HZ, faults)
    before = decoder.push([body(k, 90_000 + k * PERIOD_US, living(k)) for k in range(10)])
    decoder.restart(elapsed_s=2.5)
    after = decoder.push([body(k, k * PERIOD_US, living(k)) for k in range(10)])
    assert after.time_s[0] == pytest.approx(before.time_s[-1] + 2.5)
    np.testing.assert_allclose(np.diff(after.time_s), 0.005, atol=1e-9)
    assert not faults


def test_a_restart_without_time_passing_still_leaves_time_increasing():
    decoder = SampleStream(MPU, RATE_HZ, Counter())
    before = decoder.push([body(0, 0, living(0))])
    decoder.restart(elapsed_s=0.0)
    assert decoder.push([body(0, 0, living(0))]).time_s[0] > before.time_s[0]


def test_nothing_gives_nothing():
    block, faults = samples_of([])
    assert len(block) == 0
    assert not faults


def test_seqs_are_counted_across_their_wrap_when_some_are_lost_there_and_one_is_late():
    """65534 is late and 65535 is lost, on a board that has sent 65533 samples before."""
    seqs = [*range(65534), 65536, 65534, 65537]
    block, faults = samples_of([body(k, k * PERIOD_US, living(k)) for k in seqs])
    assert faults == {"sequence_gap": 2, "repeated": 1}
    np.testing.assert_allclose(block.time_s[-3:], [65533 * 0.005, 65536 * 0.005, 65537 * 0.005], atol=1e-9)


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
