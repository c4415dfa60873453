"""What a service is kept busy with while somebody wants to stop a stage; each load in its own process.

Every function takes the service's address and what it needs, and goes on until its process is told to end.
"""

from __future__ import annotations

import asyncio
import os
import random
import threading
import tty
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

PAUSE_S = 1.0
"""Between an answer and the next question of the same client."""
SLOW_BYTES = 900


@dataclass(frozen=True)
class Target:
    """A service, and what somebody who knows its token can ask of it.

    Attributes:
        host: its address.
        port: its port.
        token: its token.
        imported: ids of runs of a hundred poses.
        running: id of a run that goes on.
    """

    host: str
    port: int
    token: str
    imported: tuple[str, ...]
    running: str

    def request(self, line: str, body: bytes = b"", *more: str, token: str | None = None) -> bytes:
        """A request that closes its connection, as it goes over the wire."""
        head = [f"{line} HTTP/1.1", f"Host: {self.host}:{self.port}", "Connection: close", *more]
        head.append(f"Authorization: Bearer {token or self.token}")
        return "\r\n".join([*head, f"Content-Length: {len(body)}", "", ""]).encode() + body

    async def ask(self, request: bytes) -> str:
        """The status of the answer, or how the connection ended without one; all of it is read."""
        try:
            reader, writer = await asyncio.open_connection(self.host, self.port)
        except OSError:
            return "not connected"
        answer = b""
        try:
            writer.write(request)
            while piece := await reader.read(65536):
                answer = answer or piece
        except OSError:
            return "cut off"
        finally:
            writer.close()
        return answer.split(b" ", 2)[1].decode() if answer else "cut off"


Heard = Counter[str]
Client = Callable[[Target, Heard, int], Coroutine[Any, Any, None]]


async def _again_and_again(target: Target, heard: Heard, request: bytes, pause_s: float = PAUSE_S) -> None:
    while True:
        heard[await target.ask(request)] += 1
        await asyncio.sleep(pause_s)


async def diagnosis(target: Target, heard: Heard, k: int) -> None:
    """Has a run of a hundred poses diagnosed."""
    run_id = target.imported[k % len(target.imported)]
    line = f"POST /api/runs/{run_id}/diagnosis"
    await _again_and_again(target, heard, target.request(line, b"{}", "Content-Type: application/json"))


async def large_import(target: Target, heard: Heard, k: int) -> None:
    """Imports a hundred thousand poses."""
    body = form(poses(100_000, seed=1), f"LARGE-{k}")
    kind = "Content-Type: multipart/form-data; boundary=x-calrig-x"
    await _again_and_again(target, heard, target.request("POST /api/imports", body, kind))


async def stranger(target: Target, heard: Heard, k: int) -> None:
    """Begins a body, to the login or where a token is asked for, and sends a byte of it a second."""
    path = "/api/login" if k % 2 else "/api/runs"
    head = f"POST {path} HTTP/1.1\r\nHost: {target.host}:{target.port}\r\nContent-Type: application/json\r\n"
    while True:
        with suppress(OSError):
            _, writer = await asyncio.open_connection(target.host, target.port)
            try:
                writer.write(f"{head}Content-Length: {SLOW_BYTES}\r\n\r\n".encode())
                for _ in range(SLOW_BYTES):
                    writer.write(b"{")
                    await writer.drain()
                    await asyncio.sleep(1.0)
            finally:
                writer.close()
        heard["cut off"] += 1
        await asyncio.sleep(0.1)


async def guesser(target: Target, heard: Heard, k: int) -> None:
    """Guesses tokens, or holds on to a connection as a slow stranger: twelve in four hundred and fifty."""
    if k >= GUESSERS:
        await stranger(target, heard, k)
    wrong = target.request("GET /api/rigs", token=f"a wrong one, number {k}".replace(" ", "-"))
    await _again_and_again(target, heard, wrong, pause_s=0.05)


GUESSERS = 12


async def scan(target: Target, heard: Heard, k: int) -> None:
    """Has the ports scanned."""
    await _again_and_again(target, heard, target.request("POST /api/rigs/scan"))


async def neighbour(target: Target, heard: Heard, k: int) -> None:
    """Stops the stage that answers nothing."""
    await _again_and_again(target, heard, target.request("POST /api/rigs/mute/stop"))


async def listener(target: Target, heard: Heard, k: int) -> None:
    """Takes the events of the run that goes on."""
    request = target.request(f"GET /api/runs/{target.running}/events")
    await _again_and_again(target, heard, request)


@cache
def poses(number: int, seed: int) -> bytes:
    """Poses of somebody's own, as a file."""
    rng = random.Random(seed)
    rows = (
        f"{t:.3f},{t + rng.gauss(0.8, 0.03):.4f}\n" for t in (rng.uniform(-60, 60) for _ in range(number))
    )
    return b"target_deg,reading_deg\n" + "".join(rows).encode()


def form(file: bytes, unit: str) -> bytes:
    """What a browser makes of a file to import."""
    part = "--x-calrig-x\r\nContent-Disposition: form-data; name="
    return (
        f'{part}"unit"\r\n\r\n{unit}\r\n{part}"file"; filename="poses.csv"\r\n\r\n'.encode()
        + file
        + b"\r\n--x-calrig-x--\r\n"
    )


def _clients(connection: Connection, client: Client, number: int, target: Target) -> None:
    """So many clients in this process, until the other end asks what they heard."""
    heard: Heard = Counter()

    async def until_told() -> None:
        told = asyncio.Event()
        asyncio.get_running_loop().add_reader(connection.fileno(), told.set)
        async with asyncio.TaskGroup() as crowd:
            clients = [crowd.create_task(client(target, heard, k)) for k in range(number)]
            await asyncio.sleep(0)  # each has begun
            connection.send(None)
            await told.wait()
            for one in clients:
                one.cancel()

    asyncio.run(until_told())
    connection.send(dict(heard))


@contextmanager
def loaded(client: Client, number: int, target: Target) -> Iterator[Callable[[], dict[str, int]]]:
    """The clients at work; what is given ends them and tells what they heard, by status."""
    spawn = get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=_clients, args=(theirs, client, number, target), daemon=True)
    process.start()
    ours.recv()
    heard: dict[str, int] = {}

    def end() -> dict[str, int]:
        ours.send(None)
        heard.update(ours.recv() if ours.poll(20.0) else {"clients hang": number})
        return heard

    try:
        yield end
    finally:
        process.kill()
        process.join()


@contextmanager
def mute_terminal() -> Iterator[str]:
    """The name of a port behind which somebody listens and says nothing."""
    near, far = os.openpty()
    tty.setraw(far)

    def listen() -> None:
        with suppress(OSError):
            while os.read(near, 65536):
                pass

    threading.Thread(target=listen, daemon=True).start()
    try:
        yield os.ttyname(far)
    finally:
        os.close(far)  # which ends the reading
