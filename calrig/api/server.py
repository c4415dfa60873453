"""The HTTP server under the application: it says when it is ready, and ends without being waited for."""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI

from calrig.api.connections import ACCEPTED_AT_ONCE, PatientProtocol
from calrig.api.context import context_of

WAITING = 2048
"""Connections that may wait to be taken: one beyond them would try again a second later."""
DRAIN_S = 1
"""How long answers under way may take once the service was told to stop."""
SWITCH_S = 0.0005
"""How long one thread may compute while others wait: a stop passes through several on its way."""


class Server(uvicorn.Server):
    """Uvicorn, which says when it is ready and ends open event streams before it waits for them."""

    def __init__(self, app: FastAPI, on_ready: Callable[[], None] = lambda: None) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=PatientProtocol,
                proxy_headers=False,  # the application sees to them, and to whose they are
                log_config=None,  # as calrig.logs says
                log_level="warning",
                access_log=False,
                timeout_graceful_shutdown=DRAIN_S,
                backlog=ACCEPTED_AT_ONCE,
                ws="none",
            )
        )
        context = context_of(app)
        self._streams, self._service = context.streams, context.service
        self._on_ready = on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Starts, then says so."""
        sys.setswitchinterval(SWITCH_S)
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(WAITING)  # asyncio takes as many at once as may wait: those are two numbers
        self._on_ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Ends streams and runs at once, and stops as uvicorn does: no stage moves while answers drain."""
        self._streams.close()
        closing = asyncio.create_task(asyncio.to_thread(self._service.close))
        await super().shutdown(sockets)
        await closing
