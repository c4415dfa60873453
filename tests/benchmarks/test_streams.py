"""A day's stream, a fast board, and many boards at once: what they cost, reported; what is lost, asserted.

`python -m pytest tests/benchmarks/test_streams.py`; it takes about five minutes. Shares are processor time of
this process over the stream's time, in % of one core; the boards, which would be hardware, count apart.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from statistics import median

import psutil
import pytest
from packet_stream import MPU, as_read, sample_blocks
from prepared_boards import prepared_boards

from calrig.estimation.kalman import KalmanFilter
from calrig.instruments.boards.calrig.driver import CalrigBoard, SampleStream
from calrig.instruments.boards.calrig.packets import PacketDecoder
from calrig.runs.acquisition import LOOK_S, Stream

A_DAY = 86_400 * 200
CUT_EVERY_S = 3.0
"""A pose takes about so long, and the samples before it are let go of then."""
FAST_HZ, USUAL_HZ = 1000, 200
MANY = 32
ROUNDS = 3


@pytest.fixture
def report(capsys):
    def write(text: str) -> None:
        with capsys.disabled():
            sys.stdout.write(f"\n{text}")

    return write


class BoardInMemory:
    """A board whose bytes are all there: what is taken has been decoded just now."""

    def __init__(self, pieces: list[bytes], rate_hz: int):
        self.faults: Counter[str] = Counter()
        self._pieces = iter(pieces)
        self._decoder, self._stream = PacketDecoder(self.faults), SampleStream(MPU, rate_hz, self.faults)

    def take(self, timeout_s: float):
        return self._stream.push(self._decoder.feed(next(self._pieces, b"")))


@pytest.mark.timeout(1200)
def test_a_day_of_stream_in_flat_memory(report):
    """17 million samples in the pieces that the driver reads. Aim: memory does not grow with the stream."""
    faults = Counter()
    decoder, stream = PacketDecoder(faults), SampleStream(MPU, USUAL_HZ, faults)
    process = psutil.Process()
    n_samples, decoding_s, first_mb, peak_mb = 0, 0.0, 0.0, []
    for packets in sample_blocks(A_DAY, USUAL_HZ):
        pieces = as_read(packets, USUAL_HZ)
        before_s = time.thread_time()
        for piece in pieces:
            n_samples += len(stream.push(decoder.feed(piece)))
        decoding_s += time.thread_time() - before_s
        rss_mb = process.memory_info().rss / 1e6
        first_mb = first_mb or rss_mb
        peak_mb.append(max(rss_mb - first_mb, peak_mb[-1] if peak_mb else 0.0))
    assert (n_samples, faults) == (A_DAY, Counter())
    report(
        f"a day, {n_samples / 1e6:.2f} million samples: peak memory +{peak_mb[len(peak_mb) // 10]:.1f} MB "
        f"after a tenth, +{peak_mb[-1]:.1f} MB at the end; "
        f"{decoding_s / n_samples * 1e6:.2f} s per million samples"
    )


def test_decode_and_filter_of_prepared_bytes_at_1_khz(report):
    """Aim: 5 % of a core."""
    seconds = 60
    blocks = sample_blocks(seconds * FAST_HZ, FAST_HZ)
    pieces = as_read([packet for block in blocks for packet in block], FAST_HZ)

    def once() -> float:
        stream = Stream(BoardInMemory(pieces, FAST_HZ), KalmanFilter())
        before_s, n_samples, cut_s = time.thread_time(), 0, 0.0
        while came := stream.pump(0.0):
            n_samples += came
            cut_s = _cut_when_due(stream, cut_s)
        assert n_samples == seconds * FAST_HZ
        return (time.thread_time() - before_s) / seconds

    shares = [once() for _ in range(ROUNDS)]
    report(f"one board at 1 kHz from memory, decode and filter: {_percent(shares)} of a core")


def test_one_live_board_at_1_khz(report):
    """Over a pseudo-terminal, in real time, the driver's thread and this one. Aim: 5 % of a core."""
    rounds = [_live(1, FAST_HZ, 10.0) for _ in range(ROUNDS)]
    report(f"one live board at 1 kHz: {_told(rounds)}")
    assert not any(lost for _, _, _, lost in rounds)


def test_32_live_boards_at_200_hz(report):
    """At once in one process, over pseudo-terminals, in real time. Aim: no sample lost on two cores."""
    rounds = [_live(MANY, USUAL_HZ, 20.0) for _ in range(ROUNDS)]
    report(f"{MANY} live boards at 200 Hz: {_told(rounds)}\n")
    assert not any(lost for _, _, _, lost in rounds)


def _live(n_boards: int, rate_hz: int, seconds: float) -> tuple[float, float, int, Counter[str]]:
    """Shares of a core of this process and of the boards', samples that came, and what was lost."""
    with prepared_boards(n_boards, rate_hz, 3 * seconds) as (process, ports), ExitStack() as open_boards:
        boards = [open_boards.enter_context(closing(CalrigBoard.open(port))) for port in ports]
        for board in boards:
            board.identify()
        enough = threading.Barrier(n_boards + 1)
        came = [0] * n_boards

        def follow(k: int) -> None:
            stream, cut_s = Stream(boards[k], KalmanFilter()), 0.0
            boards[k].start(rate_hz)
            enough.wait()
            while stream.clock_s < seconds:
                came[k] += stream.pump(LOOK_S)
                cut_s = _cut_when_due(stream, cut_s)

        threads = [threading.Thread(target=follow, args=(k,), daemon=True) for k in range(n_boards)]
        for thread in threads:
            thread.start()
        enough.wait()
        before, theirs_before, began_s = time.process_time(), _cpu_s(process), time.monotonic()
        for thread in threads:
            thread.join()
        took_s = time.monotonic() - began_s
        ours, theirs = (time.process_time() - before) / took_s, (_cpu_s(process) - theirs_before) / took_s
        return ours, theirs, sum(came), sum((board.faults for board in boards), Counter())


def _cut_when_due(stream: Stream, cut_s: float) -> float:
    if stream.clock_s - cut_s < CUT_EVERY_S:
        return cut_s
    stream.cut(stream.clock_s)
    return stream.clock_s


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return times.user + times.system


def _told(rounds: list[tuple[float, float, int, Counter[str]]]) -> str:
    ours, theirs, came, lost = zip(*rounds, strict=True)
    faults = dict(sum(lost, Counter()))
    return (
        f"{_percent(ours)} of a core (the boards {_percent(theirs)}); "
        f"{' '.join(map(str, came))} samples, lost or damaged: {faults or 'none'}"
    )


def _percent(shares) -> str:
    """The median, and all of them."""
    return f"{100 * median(shares):.2f} % ({', '.join(f'{100 * share:.2f}' for share in shares)})"
