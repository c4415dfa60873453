"""Boards that speak the packet protocol of CONTRACT 3.1 (driver `calrig`).

`Mark` tells samples measured after a request from older ones, however late they arrive. `SampleStream` turns
sample packets into samples with a continuous time, and counts and drops damaged ones. `CalrigBoard` is the
driver.
"""

import contextlib
import itertools
from collections import Counter, deque
from collections.abc import Callable
from typing import Self

import numpy as np
import numpy.typing as npt

from calrig.instruments.boards.calrig.packets import ACKNOWLEDGE, BAUDRATE, IDENTITY, SAMPLES, PacketDecoder
from calrig.instruments.boards.calrig.words import USELESS, read_identity, text_of, why_none, why_useless
from calrig.instruments.boards.reader import ReadBoard
from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.device import OpenBoard
from calrig.instruments.errors import BoardError, PortError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.types import GAP_PERIODS, BoardIdentity, Samples

ASK_AGAIN_S = 0.5
ATTEMPTS = 3
LOST_S = 5.0
"""An answer that has not come by then will not."""


class Mark:
    """The sign that was asked for last.

    `ask` asks for one; `now_s` is the port's clock.
    """

    def __init__(self, ask: Callable[[], None], now_s: Callable[[], float]) -> None:
        self._ask_board = ask
        self._now_s = now_s
        self._open: deque[tuple[int, float]] = deque()  # askings without an answer: number, when
        self._asked = self._heard = self._wanted = 0
        self._tries = 0
        self._gives_none = False

    def begin(self) -> None:
        """Asks for a sign."""
        self._wanted, self._tries = self._asked + 1, 0
        self._ask()

    def came(self) -> bool:
        """Whether it has come; where not, it is asked for again. A board that never gave one is given up."""
        if self._gives_none or self._heard >= self._wanted:
            return True
        if not self._open or self._now_s() - self._open[-1][1] > ASK_AGAIN_S:
            if self._tries >= ATTEMPTS and self._heard == 0:
                self._gives_none = True
            else:
                self._ask()
        return self._gives_none

    def heard(self) -> bool:
        """An identity came while the board streamed: whether it may be an answer, and no reset.

        It may be that to the first asking that is still open: those after it are taken to be on their way.
        """
        self._forget_the_lost()
        if not self._open:
            return False
        self._heard, _ = self._open.popleft()
        return True

    def _ask(self) -> None:
        if not self._gives_none:
            self._forget_the_lost()
            self._asked += 1
            self._tries += 1
            self._open.append((self._asked, self._now_s()))
            self._ask_board()

    def _forget_the_lost(self) -> None:
        while self._open and self._now_s() - self._open[0][1] > LOST_S:
            self._open.popleft()


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
        """Continue after a reset: the board's seq and clock at 0, elapsed_s (host's clock) after the last.

        How long that was by the board's clock is not known, so that it always counts as a gap.
        """
        self._before = None
        gap_us = max(elapsed_s * 1e6, (GAP_PERIODS + 1) * self._period_us)
        self._time_us += round(gap_us - self._period_us)

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
        for k, seq in enumerate(rows[1:, SEQ].tolist(), start=1):  # each compared with the last accepted one
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


READ_EVERY_S = 0.04
READ_TIMEOUT_S = 0.002
"""All bytes there are, 25 times a second: waking for each sample would cost several times as much."""
BACKLOG_BYTES = 2000
"""A read this large may be half of a terminal's 4 kB buffer: more waits behind it and grows old."""
IDENTIFY_S = 5.0
ANSWER_S = 1.0
LATE_S = 0.12
"""Longer than reading and a system at rest let samples wait: then something on their way does."""
RESTART_S = 1.0
"""So long after it fell silent, and again, a board is restarted: the sign of its reset may be lost."""
SILENCE_S = 4.0
"""Longer than the 3 s that a board may take from a reset to its identity."""
USELESS_S = 2.0


class CalrigBoard(ReadBoard):
    """One board on a port. A thread reads from the first moment; `take` must be called while it streams.

    A board that resets in the middle (it sends its identity again) is started again, counted as
    `board_reset`, and so is one that falls silent, counted as `restarted`; its time then goes on by the
    host's clock, over a gap that always shows.
    """

    def __init__(self, port: Port) -> None:
        super().__init__(port, "calrig")
        self._decoder = PacketDecoder(self.faults)
        self._identity: BoardIdentity | None = None
        self._stream: SampleStream | None = None
        self._start_line: str | None = None  # what it acknowledged; None again once STOP was sent
        self._streaming = False  # whether samples are accepted: from the acknowledge of START to that of STOP
        self._period_s = 0.0
        self._asked = ""
        self._answer: tuple[int, str] | None = None
        self._last_words = ""
        self._n_bytes = 0
        self._heard_at = self._valid_at = self._timed_at = self._restarted_at = self._clock.now_s()
        self._mark = Mark(lambda: self._send("ID"), self._clock.now_s)
        self._may_be_late = False  # whether samples were ever held up on their way since `start`
        self._is_reset = self._awaits_start = False
        self._faults_then: Counter[str] = Counter()
        self._reading.start()

    @classmethod
    def open(cls, url: str, *, baudrate: int | None = None) -> Self:
        """Opens the port (PortError), which resets most boards."""
        return cls(open_port(url, baudrate=baudrate or BAUDRATE, timeout_s=READ_TIMEOUT_S))

    def identify(self) -> BoardIdentity:
        """Asks twice a second until the board answers; faults are counted from here on.

        Raises:
            BoardError: no identity in 5 s, or one that cannot be used.
            PortError: the port went away.
        """
        with self._news:
            self._identity = None
            self._send("STOP")  # a process before this one may have left it streaming
            deadline = self._clock.now_s() + IDENTIFY_S
            while self._identity is None and self._clock.now_s() < deadline:
                self._send("ID")
                self._news.wait_for(lambda: self._identity or self._failure, ASK_AGAIN_S)
                self._raise_failure()
            if self._identity is None:
                why = why_none(self._last_words, self._n_bytes, self._decoder.overlong)
                raise BoardError(f"{self._name} sent no identity in {IDENTIFY_S:g} s: {why}")
            self.faults.clear()
            self._last_words = ""
            return self._identity

    def start(self, rate_hz: int) -> None:
        """Starts streaming and waits for the acknowledge.

        Raises:
            BoardError: not identified, the rate is above the board's, or it refused in its own words.
        """
        if (identity := self._identity) is None:
            raise BoardError(f"{self._name} must be identified before it is started")
        if identity.max_rate_hz is not None and rate_hz > identity.max_rate_hz:
            raise BoardError(f"{self._name} samples at {identity.max_rate_hz} Hz at most, not {rate_hz} Hz")
        with self._news:
            self._streaming, self._start_line = False, None
            self._blocks.clear()
            self._stream = SampleStream(identity, rate_hz, self.faults)
            self._period_s = 1 / rate_hz
            asked_s = self._clock.now_s()
            self._command(f"START {rate_hz}")
            self._may_be_late = self._clock.now_s() - asked_s > LATE_S

    def mark(self) -> None:
        """Asks for a sign in the stream: what comes after it was measured after this call.

        Only where the way was ever slow: the answer takes a full line's time from the samples.
        """
        with self._news:
            if self._may_be_late:
                self._mark.begin()

    @property
    def marked(self) -> bool:
        """Whether the sign has come, or the board gives none; blocks not taken yet may be older than it."""
        with self._news:
            return self._mark.came()

    def stop(self) -> None:
        """Stops streaming (BoardError if the board does not acknowledge); what came before can be taken."""
        with self._news:
            self._start_line = None
            self._command("STOP")

    def close(self) -> None:
        """Stop a streaming board and close the port; never raises."""
        if self._start_line is not None:
            with contextlib.suppress(PortError), self._news:
                self._start_line = None
                self._send("STOP")
        super().close()

    def _send(self, line: str) -> None:
        raise_if_cancelled()
        self._port.write(f"{line}\n".encode("ascii"))

    def _command(self, line: str) -> None:
        """Sends a line until it is acknowledged: each may be repeated, and refused because it was damaged."""
        self._asked, answer = line, None
        for _ in range(ATTEMPTS):
            self._raise_failure()
            self._answer = None
            self._send(line)
            self._news.wait_for(lambda: self._answer or self._failure, ANSWER_S)
            answer = self._answer or answer
            if answer is not None and answer[0] == ACKNOWLEDGE:
                break
        self._asked = ""
        self._raise_failure()
        if answer is None:
            raise BoardError(
                f"{self._name} did not acknowledge {line} in {ATTEMPTS * ANSWER_S:g} s: reset the board"
            )
        if answer[0] != ACKNOWLEDGE:
            raise BoardError(f"{self._name} refused {line}: {answer[1]}")

    def _listen(self) -> None:
        data = b""
        while not self._closing.wait(READ_EVERY_S if len(data) < BACKLOG_BYTES else 0.0):
            data = self._port.read(65536)
            if data:
                self._digest(data)

    def _digest(self, data: bytes) -> None:
        with self._news:
            packets = self._decoder.feed(data)
            now = self._clock.now_s()
            if now - self._heard_at > max(LATE_S, 3 * self._period_s) or len(data) > BACKLOG_BYTES:
                self._may_be_late |= self._streaming
            self._heard_at = now
            self._n_bytes += len(data)
            for are_samples, group in itertools.groupby(packets, lambda packet: packet[0] in SAMPLES):
                if are_samples:
                    self._keep(list(group))
                else:
                    for packet in group:
                        self._listen_to(packet[0], packet[1:])
            self._news.notify_all()

    def _keep(self, packets: list[bytes]) -> None:
        if self._stream is None or not self._streaming:
            return  # of a START before this one
        self._is_reset = False
        block = self._stream.push(packets)
        if len(block):
            self._blocks.append(block)
            self._valid_at = self._timed_at = self._heard_at
            self._faults_then = self.faults.copy()

    def _listen_to(self, kind: int, payload: bytes) -> None:
        if kind == IDENTITY:
            self._meet(payload.decode("utf-8", "replace"))
        elif kind == ACKNOWLEDGE:
            self._follow(payload.decode("utf-8", "replace"))
        else:
            self._last_words = text = text_of(payload)
            if self._start_line is not None:
                self.faults["board_error"] += 1
            elif self._asked.startswith("START"):
                self._answer = kind, text

    def _follow(self, line: str) -> None:
        if line == "STOP":
            self._streaming = False
        elif self._stream is not None and line in (self._asked, self._start_line):
            if line == self._start_line:  # after a reset, or late, to a START that was sent twice
                self._stream.restart(self._heard_at - self._timed_at)
            else:
                self._valid_at = self._heard_at
            self._start_line, self._streaming, self._awaits_start = line, True, False
            self._timed_at, self._faults_then = self._heard_at, self.faults.copy()
        if line == self._asked:
            self._answer = ACKNOWLEDGE, line

    def _meet(self, text: str) -> None:
        try:
            identity = read_identity(text)
        except ValueError as error:
            raise BoardError(
                f"{self._name} sent an identity that cannot be used ({error}): does it carry calrig's sketch?"
            ) from error
        if self._start_line is None:
            self._identity = self._identity or identity
        elif identity != self._identity:
            raise BoardError(
                f"{self._name} was exchanged while it streamed: it now says it is {identity.serial!r}, "
                f"{identity.chip}, ±{identity.accel_range_g} g, ±{identity.gyro_range_dps} °/s"
            )
        elif self._mark.heard():
            self._is_reset = True  # perhaps: that it is going on shows at its next sample
        else:
            self._is_reset = True
            self._start_again()

    def _start_again(self) -> None:
        """Restart a board that was reset or may have been: it is silent, or did not acknowledge."""
        self.faults["board_reset" if self._is_reset else "restarted"] += 1
        self._streaming &= not self._is_reset  # what is only late is still to be taken
        self._is_reset, self._awaits_start = False, True
        self._restarted_at = self._clock.now_s()
        self._send(str(self._start_line))

    def _check_health(self) -> None:
        if self._start_line is None or self._stream is None:
            return
        now = self._clock.now_s()
        silent_s = now - (self._restarted_at if self._awaits_start else self._heard_at)
        if silent_s > max(ASK_AGAIN_S if self._is_reset else RESTART_S, 3 * self._period_s):
            self._start_again()
        since = self.faults - self._faults_then
        went_on = self._period_s * max(since[kind] for kind in USELESS) > USELESS_S / 2  # not just the last
        useless_s = now - self._valid_at
        if useless_s <= max(USELESS_S if went_on else SILENCE_S, 3 * self._period_s):
            return
        why = why_useless(since, went_on=went_on, reads_zero=self._stream.reads_zero)
        words = f"; its last words were {self._last_words!r}" if self._last_words else ""
        raise BoardError(f"{self._name} has sent no usable sample for {useless_s:.1f} s: {why}{words}")


OPENS: OpenBoard = CalrigBoard.open
