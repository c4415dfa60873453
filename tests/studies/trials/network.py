"""A TCP connection to a server's socket that can be cut as a cable is, or stay open and pass nothing on."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from pathlib import Path

HALVED_BYTES = 2000
"""Clients send so much at once only where they deliver a parcel."""


class Cable:
    """Forwards a port of this machine to a Unix socket, in a thread of its own.

    Attributes:
        port: what clients connect to.
    """

    def __init__(self, socket: Path) -> None:
        self._socket, self._whole = str(socket), True
        self._open: set[asyncio.StreamWriter] = set()
        self._stranded: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._passes, self._halves = asyncio.Event(), False
        self._passes.set()
        self._is_halved = threading.Event()
        threading.Thread(target=self._loop.run_forever, name="cable", daemon=True).start()
        start = asyncio.start_server(self._forward, "127.0.0.1", 0)
        self._server = asyncio.run_coroutine_threadsafe(start, self._loop).result()
        self.port = int(self._server.sockets[0].getsockname()[1])

    def cut(self) -> None:
        """Ends every connection, and lets no new one through."""
        asyncio.run_coroutine_threadsafe(self._end_all(), self._loop).result()

    def swallow(self) -> None:
        """Leaves every connection open, takes new ones and passes nothing on, either way, until mended.

        What was sent meanwhile then arrives late.
        """
        self._loop.call_soon_threadsafe(self._passes.clear)

    def strand(self) -> None:
        """Passes nothing on in the connections that are open, for ever; new ones are whole."""
        self._loop.call_soon_threadsafe(lambda: self._stranded.update(self._open))

    def halve(self, within_s: float) -> bool:
        """Passes half of the next parcel on, and then nothing more, as `swallow`; once mended it is cut.

        Returns whether there was one within that time.
        """
        self._is_halved.clear()
        self._halves = True
        self._is_halved.wait(within_s)
        self._halves = False
        return self._is_halved.is_set()

    def mend(self) -> None:
        """Lets connections through again."""
        self._whole = True
        self._loop.call_soon_threadsafe(self._passes.set)

    def close(self) -> None:
        """Cuts it for good."""
        self.cut()
        self._loop.call_soon_threadsafe(self._server.close)
        self._loop.call_soon_threadsafe(self._loop.stop)

    async def _end_all(self) -> None:
        self._whole = False
        for writer in list(self._open):
            writer.transport.abort()
        await asyncio.sleep(0.1)  # what forwarded them ends before the loop may

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self._whole:
            writer.transport.abort()
            return
        try:
            there = await asyncio.open_unix_connection(self._socket)
        except OSError:
            writer.transport.abort()
            return
        ends = {writer, there[1]}
        self._open |= ends
        try:
            up, down = self._copy(reader, there[1], is_up=True), self._copy(there[0], writer, is_up=False)
            await asyncio.gather(up, down)
        finally:
            self._open -= ends
            self._stranded -= ends
            for end in ends:
                end.transport.abort()

    async def _copy(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, is_up: bool) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                if writer in self._stranded:
                    continue
                await self._passes.wait()
                is_half = is_up and self._halves and len(data) >= HALVED_BYTES
                writer.write(data[: len(data) // 2] if is_half else data)
                await writer.drain()
                if is_half:
                    self._halves = False
                    self._passes.clear()
                    self._is_halved.set()
                    await self._passes.wait()
                    break
        if writer not in self._stranded:
            writer.transport.abort()
