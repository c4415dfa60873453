"""`calrig serve` as a process of its own, on rigs that go on when it dies."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import httpx

from calrig.settings import RigSettings

START_S = 60.0
HERE: dict[str, str] = {}
"""The program that a trial tries: what `of_program` gives of another one comes in its place."""
T = TypeVar("T")


def of_program(folder: Path) -> dict[str, str]:
    """Environment in which `python -m calrig` is the one that lies in a folder."""
    return {"PYTHONPATH": str(folder), "PYTHONSAFEPATH": "1"}


def configured(folder: Path, rigs: list[RigSettings]) -> Path:
    """A calrig.toml with these rigs, by their ports alone."""
    stanzas = [
        f"[[rig]]\nname = {json.dumps(rig.name)}\nlimits_deg = {list(rig.limits_deg)}\n"
        f"stage = {{ driver = {json.dumps(rig.stage.driver)}, port = {json.dumps(rig.stage.port)} }}\n"
        f"imu = {{ driver = {json.dumps(rig.imu.driver)}, port = {json.dumps(rig.imu.port)} }}\n"
        for rig in rigs
        if rig.stage is not None and rig.imu is not None
    ]
    path = folder / "calrig.toml"
    path.write_text("\n".join(stanzas), encoding="utf-8")
    return path


class Served:
    """A service that answers at `client`; `kill` ends it as a power cut would, `terminate` in order.

    Where there is a token, the client shows it. A centre's store is `db`, and its log lies beside `store`.
    """

    def __init__(
        self,
        config: Path,
        store: Path,
        token: str = "",
        db: str | None = None,
        program: dict[str, str] = HERE,
    ) -> None:
        command = [sys.executable, "-m", "calrig", "serve", "--port", "0"]
        self._log = store.with_suffix(".log").open("ab")
        self.process = subprocess.Popen(
            [*command, "--config", str(config), "--db", db or str(store)],
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, **program, **({"CALRIG_TOKEN": token} if token else {})},
        )
        too_late = threading.Timer(START_S, self.process.kill)
        too_late.start()
        assert self.process.stdout is not None
        said = self.process.stdout.readline()
        too_late.cancel()
        url = re.search(r"http://\S+?:\d+", said)
        if url is None:
            self.kill()
            raise RuntimeError(f"the service did not start: {Path(self._log.name).read_text()[-2000:]}")
        shown = {"Authorization": f"Bearer {token}"} if token else {}
        self.client = httpx.Client(base_url=url[0], timeout=20.0, headers=shown)

    def get(self, path: str) -> Any:
        """The answer's JSON."""
        return self.client.get(path).raise_for_status().json()

    def kill(self) -> None:
        """Ends it at once, whatever it does."""
        self._end(signal.SIGKILL)

    def terminate(self) -> float:
        """Asks it to end; returns after how many seconds it had."""
        began_s = time.monotonic()
        self._end(signal.SIGTERM)
        return time.monotonic() - began_s

    def _end(self, number: int) -> None:
        self.process.send_signal(number)
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self._log.close()


def until(look: Callable[[], T | None], deadline_s: float) -> T | None:
    """Looks again and again until there is something; None at the deadline."""
    give_up_s = time.monotonic() + deadline_s
    while time.monotonic() < give_up_s:
        if (found := look()) is not None:
            return found
        threading.Event().wait(0.02)
    return None
