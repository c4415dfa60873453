"""Pool of a few processes for background tasks, with a bounded queue and an error message for each failure.

`concurrent.futures` cannot end a running task, and its pool breaks when a process dies. Here each process
carries out one task at a time; cancelling a task ends its process and starts another.
"""

import asyncio
import os
import pickle
import sys
from asyncio.subprocess import PIPE, Process
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Protocol, TypeVar

from calrig.processes import child
from calrig.processes.threads import ONE_THREAD

T = TypeVar("T")

MOST_WAITING = 16
"""Pieces of one user that wait for a process; more are refused at once, and nobody else's with them."""
MOST_WAITING_ALL = 256
"""Of all users: a bound of the memory that waiting pieces take."""
LONGEST_S = 300.0
MOST_BYTES = 4_000_000_000
"""Of one process; less on a machine where all of them together would take more than half the memory."""
BUFFER_BYTES = 1_000_000
ENDS_S = 5.0
"""How long a process may take to end once its pipe is closed."""


class WorkError(Exception):
    """A piece of heavy work has no outcome; the message says why, and what to do."""


class WorkRefused(WorkError):  # noqa: N818 (read as words: raise WorkRefused)
    """Too much is waiting: the same will be done later."""


class WorkTooLarge(WorkError):  # noqa: N818
    """It took more memory or time than a piece may."""


class WorkLost(WorkError):  # noqa: N818
    """Its process was ended by something outside of calrig; another one takes its place."""


class Turns:
    """Slots that keys take in turn (round robin), each key's own requests in their order.

    Of those that wait, the key served longest ago goes next. Used in one event loop.

    Args:
        slots: how many are taken at once.

    Attributes:
        in_hand: how many requests of each key have a slot or wait for one.
    """

    def __init__(self, slots: int) -> None:
        self.in_hand: Counter[str] = Counter()
        self._free = slots
        self._waiting: dict[str, deque[asyncio.Future[None]]] = {}
        """By key; the key that goes next is first."""

    @asynccontextmanager
    async def slot(self, key: str) -> AsyncIterator[None]:
        """Hold a slot for the block, once it is the key's turn."""
        self.in_hand[key] += 1
        try:
            await self._take(key)
            try:
                yield
            finally:
                self._pass_on()
        finally:
            self.in_hand[key] -= 1
            if not self.in_hand[key]:
                del self.in_hand[key]

    async def _take(self, key: str) -> None:
        if self._free:
            self._free -= 1
            return
        turn = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(key, deque()).append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if not turn.cancelled():  # the slot came just before
                self._pass_on()
            raise

    def _pass_on(self) -> None:
        while self._waiting:
            key = next(iter(self._waiting))
            turns = self._waiting.pop(key)
            turn = turns.popleft()
            if turns:
                self._waiting[key] = turns  # behind the other keys
            if not turn.done():  # who waited may have left
                turn.set_result(None)
                return
        self._free += 1


class Processes:
    """Carries out functions in processes of their own, which start when they are needed.

    Used in one event loop. A process that has nothing to do waits for the next piece.

    Args:
        slots: how many at once; without it as many as there are cores, less the one that holds the ports.
        most_bytes: of memory, each.
        longest_s: how long a piece may run; that it waits does not count.
    """

    def __init__(
        self, slots: int | None = None, *, most_bytes: int | None = None, longest_s: float = LONGEST_S
    ) -> None:
        self.slots = slots or max(1, (os.cpu_count() or 1) - 1)
        machine_bytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        self._most_bytes = most_bytes or min(MOST_BYTES, machine_bytes // (2 * self.slots))
        self._longest_s = longest_s
        self._turns = Turns(self.slots)
        self._idle: list[Process] = []

    async def run(
        self,
        function: Callable[..., T],
        *,
        user: str = "",
        longest_s: float | None = None,
        begun: Callable[[], None] = lambda: None,
        progress: Callable[[float], None] | None = None,
    ) -> T:
        """What the function gives, or raises what it raises; cancelled, its process is ended.

        Args:
            function: of a module, or a `partial` of one; it, its arguments and what it gives are pickled.
            user: whose share it takes: the pieces of several wait in turn.
            longest_s: how long it may run, if not as long as any piece.
            begun: is called when its turn has come.
            progress: is called with the share that is done, which the function tells by calling what it is
                given as `progress`; without it, it is given nothing.

        Raises:
            WorkRefused: as many of the user's pieces as may wait are waiting.
            WorkTooLarge: it took too much memory or time.
            WorkLost: its process was killed.
        """
        self.require_room(user)
        async with self._turns.slot(user):
            begun()
            asked = function, progress is not None
            piece = await asyncio.to_thread(pickle.dumps, asked, pickle.HIGHEST_PROTOCOL)
            reply = await self._carried_out(piece, progress or (lambda _: None), longest_s or self._longest_s)
            error, given = await asyncio.to_thread(pickle.loads, reply)  # from our own child
        if isinstance(error, MemoryError):
            raise WorkTooLarge(
                f"it took more than {self._most_bytes / 1e6:.0f} MB of memory and was ended: take fewer "
                "poses or samples"
            ) from error
        if error is not None:
            raise error
        return given  # type: ignore[no-any-return]

    def require_room(self, user: str = "") -> None:
        """Raise WorkRefused if as many as may wait are waiting: asked before a piece is made."""
        in_hand = self._turns.in_hand
        for whose, n, most in (
            ("one user", in_hand[user], MOST_WAITING),
            ("all users", in_hand.total(), MOST_WAITING_ALL),
        ):
            if n >= self.slots + most:
                raise WorkRefused(
                    f"{n} diagnoses, imports and studies of {whose} are in hand or waiting: try again later"
                )

    async def close(self) -> None:
        """Ends the processes that wait; those that work end with who waits for them."""
        while self._idle:
            await _end(self._idle.pop())

    async def _carried_out(self, piece: bytes, progress: Callable[[float], None], longest_s: float) -> bytes:
        process = await self._process()
        try:
            async with asyncio.timeout(longest_s):
                reply = await _asked(process, piece, progress)
        except TimeoutError as error:
            await _end(process)
            raise WorkTooLarge(
                f"it took longer than {longest_s:g} s and was ended: take fewer poses or samples"
            ) from error
        except (asyncio.IncompleteReadError, ConnectionError) as error:
            await _see_off(process)
            raise WorkLost(
                f"its process ended (status {process.returncode}), perhaps for want of memory: try again, "
                "with fewer poses or samples"
            ) from error
        except BaseException:  # whoever waited has left
            await _end(process)
            raise
        self._idle.append(process)
        return reply

    async def _process(self) -> Process:
        """One that has nothing to do."""
        while self._idle:
            process = self._idle.pop()
            if not _out(process).at_eof():
                return process
            await _see_off(process)
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", child.__name__, str(self._most_bytes), str(os.getpid())),
            stdin=PIPE,
            stdout=PIPE,
            limit=BUFFER_BYTES,
            env={
                **os.environ,
                **dict.fromkeys(ONE_THREAD, "1"),
                "PYTHONSAFEPATH": "1",  # else `-m` would look into the working directory first
                "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),  # noqa: PTH109
            },
        )


class OffloadedCall(Protocol):
    """How a thread has a function carried out in another process, and waits for it."""

    def __call__(self, function: Callable[[], T], /) -> T:
        """What it gives, or raises what it raises or a WorkError."""


def run_in_subprocess(function: Callable[[], T]) -> T:
    """As `Processes.run`, for a thread that has no event loop: in a process for this piece alone."""

    async def run() -> T:
        processes = Processes(1)
        try:
            return await processes.run(function)
        finally:
            await processes.close()

    return asyncio.run(run())


async def _asked(process: Process, piece: bytes, progress: Callable[[float], None]) -> bytes:
    assert process.stdin is not None  # noqa: S101 (a pipe)
    process.stdin.write(len(piece).to_bytes(child.HEAD_BYTES))
    process.stdin.write(piece)
    await process.stdin.drain()
    while True:
        kind = await _out(process).readexactly(1)
        head = await _out(process).readexactly(child.HEAD_BYTES)
        content = await _out(process).readexactly(int.from_bytes(head))
        if kind == child.REPLY:
            return content
        progress(*child.FRACTION.unpack(content))


def _out(process: Process) -> asyncio.StreamReader:
    assert process.stdout is not None  # noqa: S101 (a pipe)
    return process.stdout


async def _see_off(process: Process) -> None:
    """Waits for one that is ending by itself: to kill it before that would take its own status away."""
    with suppress(TimeoutError):
        async with asyncio.timeout(ENDS_S):
            await process.wait()
    await _end(process)


async def _end(process: Process) -> None:
    with suppress(ProcessLookupError):
        process.kill()
    await process.wait()
