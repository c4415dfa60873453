"""Sample packets of a `calrig` board to samples with a continuous time, damage counted and left out."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt

from calrig.instruments.types import BoardIdentity, Samples

RECORD = np.dtype([("type", "u1"), ("seq", "<u2"), ("t_us", "<u4"), ("registers", "<i2", 7)])
"""CONTRACT 3.1, type 0x02; a filtered sample (0x05) begins alike."""
SEQ, T_US, ACCEL, TEMPERATURE, GYRO = 0, 1, slice(2, 5), 5, slice(6, 9)
REGISTERS = slice(2, 9)
FULL_SCALE = 32768
IntArray = npt.NDArray[np.int64]
JUMP_FRACTION = 0.5
JUMP_US = 50_000


class SampleStream:
    """Samples of one board from `START` on; feed it each block of sample packets in the order they came.

    A sample enters only if its seq is ahead of all before it (else `repeated`; seqs passed over count as
    `sequence_gap`), its six motion registers differ from the sample before (else `frozen`; all seven at 0 is
    what a sensor that is not there gives), and the board's clock advanced as the seq says (else
    `clock_jump`). A clock may be off by half of what is expected, for a chip's rate divider rounds 300 Hz to
    333 or 250, or by 50 ms, which a sketch may be late; it may not stand still. After a jump time goes on by
    the nominal period and then by the clock again, so time_s stays continuous.

    Args:
        identity: the board's ranges.
        rate_hz: the rate it was started with.
        faults: counts by kind.
    """

    def __init__(self, identity: BoardIdentity, rate_hz: int, faults: Counter[str]) -> None:
        if identity.accel_range_g is None or identity.gyro_range_dps is None:
            raise ValueError("a board's ranges must be known to read its registers")
        self._g = np.float64(identity.accel_range_g / FULL_SCALE)
        self._dps = np.float64(identity.gyro_range_dps / FULL_SCALE)
        self._period_us = 1e6 / rate_hz
        self._faults = faults
        self._before: IntArray | None = None
        self._time_us = -round(self._period_us)

    @property
    def reads_zero(self) -> bool:
        """Whether the last sample's registers were all 0: nothing answers the board on its bus."""
        return self._before is not None and not self._before[REGISTERS].any()

    def restart(self, elapsed_s: float) -> None:
        """The board begins again at seq 0, its clock anew, elapsed_s after the last sample."""
        self._before = None
        self._time_us += max(round(elapsed_s * 1e6 - self._period_us), 0)

    def push(self, packets: list[bytes]) -> Samples:
        """The valid samples among some packets of type 0x02 and 0x05."""
        records = np.frombuffer(b"".join([packet[: RECORD.itemsize] for packet in packets]), RECORD)
        if not len(records):
            return Samples.empty()
        rows = np.empty((len(records) + 1, 9), np.int64)
        rows[1:, SEQ], rows[1:, T_US], rows[1:, REGISTERS] = (
            records["seq"],
            records["t_us"],
            records["registers"],
        )
        rows[0] = self._imagined_before(rows[1]) if self._before is None else self._before
        rows, seq_steps = self._in_sequence(rows)
        advance_us, jumped = self._clock_steps(rows, seq_steps)
        time_us: IntArray = self._time_us + np.cumsum(advance_us)
        frozen = self._frozen(rows)
        self._before, rows = rows[-1], rows[1:]
        if len(time_us):
            self._time_us = int(time_us[-1])
        bad = frozen | jumped
        if bad.any():
            time_us, rows = time_us[~bad], rows[~bad]
        return Samples(
            time_s=time_us * np.float64(1e-6),
            accel_g=rows[:, ACCEL] * self._g,
            gyro_dps=rows[:, GYRO] * self._dps,
            temperature_c=rows[:, TEMPERATURE] / 340 + 36.53,
            angle_deg=np.full(len(rows), np.nan),
        )

    def _imagined_before(self, first: IntArray) -> IntArray:
        """The sample before seq 0, so that the first block is treated like any other."""
        before = np.zeros_like(first)
        before[SEQ] = -1
        before[T_US] = first[T_US] - round((int(first[SEQ]) + 1) * self._period_us)
        return before

    def _in_sequence(self, rows: IntArray) -> tuple[IntArray, IntArray]:
        """The rows ahead of all before them, the first included, and the steps between their seqs."""
        steps = (np.diff(rows[:, SEQ]) + 2**15) % 2**16 - 2**15  # the nearer way round
        if (steps == 1).all():
            return rows, steps
        ahead = np.ones(len(rows), dtype=bool)
        last = int(rows[0, SEQ])
        for k, seq in enumerate(rows[1:, SEQ].tolist(), start=1):  # each held against the last that counted
            ahead[k] = (seq - last + 2**15) % 2**16 - 2**15 > 0
            last = seq if ahead[k] else last
        steps = (np.diff(rows[ahead, SEQ]) + 2**15) % 2**16 - 2**15
        self._count("repeated", len(rows) - int(ahead.sum()))
        self._count("sequence_gap", int((steps - 1).sum()))
        return rows[ahead], steps

    def _clock_steps(self, rows: IntArray, seq_steps: IntArray) -> tuple[IntArray, npt.NDArray[np.bool_]]:
        """How far time goes on at each row in µs, and where the clock jumped or stood still."""
        clock_us = np.diff(rows[:, T_US]) % 2**32
        expected_us = seq_steps * self._period_us
        allowed_us = np.maximum(JUMP_FRACTION * expected_us, JUMP_US)
        jumped = (np.abs(clock_us - expected_us) > allowed_us) | (clock_us == 0)
        if jumped.any():
            self._count("clock_jump", int(jumped.sum()))
            clock_us[jumped] = np.rint(expected_us[jumped])
        return clock_us, jumped

    def _frozen(self, rows: IntArray) -> npt.NDArray[np.bool_]:
        same = rows[1:] == rows[:-1]
        hangs = same[:, ACCEL].all(axis=1) & same[:, GYRO].all(axis=1)
        frozen: npt.NDArray[np.bool_] = hangs | ~rows[1:, REGISTERS].any(axis=1)
        self._count("frozen", int(frozen.sum()))
        return frozen

    def _count(self, kind: str, number: int) -> None:
        if number:
            self._faults[kind] += number
