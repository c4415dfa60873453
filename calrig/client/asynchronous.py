"""The same for asyncio: each call in a thread of its own, and given up where its caller is cancelled."""

from __future__ import annotations

import asyncio
import ssl
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from contextvars import copy_context
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from calrig.client.client import Client
from calrig.client.documents import RunEvent, RunRecord
from calrig.client.run import Run, result_of
from calrig.client.transport import GIVEN_UP, Cancelled
from calrig.model.result import Result

P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")
_End = BaseException | None


class _Asynchronous:
    """Has what it does done by its synchronous twin."""

    def __init__(self, twin: Any) -> None:
        self._twin = twin


async def _in_thread(work: Callable[[], T]) -> T:
    """What it gives; where the caller is cancelled, long work is cancelled at the service as well."""
    given_up = threading.Event()
    context = copy_context()
    context.run(GIVEN_UP.set, given_up)
    try:
        return await asyncio.to_thread(context.run, work)
    except asyncio.CancelledError:
        given_up.set()
        raise


def _threaded(
    method: Callable[Concatenate[S, P], T],
) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    @wraps(method)
    async def call(self: _Asynchronous, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await _in_thread(lambda: method(self._twin, *args, **kwargs))

    return call


def _run_of(
    method: Callable[Concatenate[Client, P], Run],
) -> Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, AsyncRun]]:
    @wraps(method)
    async def call(self: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> AsyncRun:
        return AsyncRun(await _in_thread(lambda: method(self._twin, *args, **kwargs)))

    return call


class AsyncRun(_Asynchronous):
    """As `calrig.client.Run`, each call awaited; `await run.result()`, `async for event in run.events()`."""

    _twin: Run

    @property
    def id(self) -> str:
        """Its id."""
        return self._twin.id

    @property
    def unit(self) -> str:
        """The serial number of its unit."""
        return self._twin.unit

    @property
    def record(self) -> RunRecord:
        """The run as it was when it was last looked at."""
        return self._twin.record

    look = _threaded(Run.look)
    abort = _threaded(Run.abort)
    pause = _threaded(Run.pause)
    resume = _threaded(Run.resume)
    diagnose = _threaded(Run.diagnose)
    noise = _threaded(Run.noise)
    filters = _threaded(Run.filters)
    poses = _threaded(Run.poses)
    figure = _threaded(Run.figure)

    async def wait(self) -> RunRecord:
        """The run once it has ended, however."""
        async for _ in self.events():
            pass
        return await self.look()

    async def result(self) -> Result:
        """What came out, once the run has ended; RunFailed where it was not completed."""
        return result_of(await self.wait())

    async def events(self, after: int = 0) -> AsyncIterator[RunEvent]:
        """As `Run.events`. Who leaves early should close it (`contextlib.aclosing`)."""
        loop, queue = asyncio.get_running_loop(), asyncio.Queue[RunEvent | _End]()
        given_up = threading.Event()

        def tell(what: RunEvent | _End) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(queue.put_nowait, what)

        def follow() -> None:
            GIVEN_UP.set(given_up)
            try:
                for event in self._twin.events(after):
                    if given_up.is_set():
                        return
                    tell(event)
                tell(None)
            except (Exception, Cancelled) as error:  # noqa: BLE001 (raised again where it is awaited)
                tell(error)

        # A daemon: what waits for the next line of a quiet stream keeps no program from its end.
        threading.Thread(target=follow, name=f"events of {self.id}", daemon=True).start()
        try:
            while isinstance(heard := await queue.get(), RunEvent):
                yield heard
            if heard is not None:
                raise heard
        finally:
            given_up.set()


class AsyncClient(_Asynchronous):
    """As `calrig.Client`, each call awaited: `run = await AsyncClient("http://…").calibrate("AS-0042")`."""

    _twin: Client

    def __init__(
        self, server: str, certificates: ssl.SSLContext | None = None, *, token: str | None = None
    ) -> None:
        """Arguments as of `Client`."""
        super().__init__(Client(server, certificates, token=token))

    rigs = _threaded(Client.rigs)
    calibrate = _run_of(Client.calibrate)
    run = _run_of(Client.run)
    runs = _threaded(Client.runs)
    import_poses = _run_of(Client.import_poses)
    diagnose = _threaded(Client.diagnose)
    noise = _threaded(Client.noise)
    filters = _threaded(Client.filters)
    compare = _threaded(Client.compare)
    calibration = _threaded(Client.calibration)
    calibrations = _threaded(Client.calibrations)
    exported = _threaded(Client.exported)
    certificate = _threaded(Client.certificate)
    archive = _threaded(Client.archive)
    solve = _threaded(Client.solve)
    estimate = _threaded(Client.estimate)
    plan = _threaded(Client.plan)
