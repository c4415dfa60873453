"""A bench's own page: it shows everything, starts and stops runs, and leaves the rest to the centre.

What is changed in a bench's spool beside its runs would never reach the centre, which alone amends runs,
issues calibrations and knows people.
"""

from __future__ import annotations

import re

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from calrig.api.lingering import CLOSE
from calrig.api.origin_check import HARMLESS

OF_THE_BENCH = re.compile(
    r"/api/(login|logout|runs|runs/[^/]+/(abort|pause|resume)|rigs/scan|rigs/[^/]+/(stop|clamp)|plans/(estimate|design))"
)
"""What a bench does for itself."""
AT_THE_CENTRE = "this is a bench: it starts, stops and shows runs; anything else is changed at its centre"


class BenchPage:
    """ASGI middleware that answers 409 to what only the centre may do."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes on what looks, and what a bench does for itself."""
        asks = scope["type"] == "http" and scope["method"] not in HARMLESS
        if asks and OF_THE_BENCH.fullmatch(scope["path"]) is None:
            refused = JSONResponse({"detail": AT_THE_CENTRE}, 409, CLOSE)
            await refused(scope, receive, send)
            return
        await self.app(scope, receive, send)
