"""Starts a simulated rig as a separate process, so that the service knows it by its ports alone."""

import json
import subprocess
import sys
import threading
from collections.abc import Mapping
from typing import Any, Self

from calrig.simulator.config import SimulatorSettings

START_TIMEOUT_S = 20.0
STOP_TIMEOUT_S = 5.0


class LaunchError(Exception):
    """The simulator's process did not start; says why."""


class SimulatedProcess:
    """A running simulator; stops with `stop`, with `with`, or when this process dies in whatever way.

    Attributes:
        stage_port, imu_port: what `serial.serial_for_url` opens.
        stage_driver, imu_driver: of calrig, that understand them.
        clamp: `driver` and `port` of what turns the unit in its clamp; None where hands do that.
        time_scale: seconds of its clocks for one on the wall.
    """

    def __init__(
        self,
        process: subprocess.Popen[str],
        stage: Mapping[str, str],
        imu: Mapping[str, str],
        clamp: Mapping[str, str] | None,
        time_scale: float,
    ) -> None:
        self.stage_port, self.stage_driver = stage["port"], stage["driver"]
        self.imu_port, self.imu_driver = imu["port"], imu["driver"]
        self.clamp = clamp
        self.time_scale = time_scale
        self._process = process

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def stop(self) -> None:
        """Ends the process; may be called twice."""
        _end(self._process)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def launch(options: Mapping[str, Any]) -> SimulatedProcess:
    """Starts the rig that a `simulated` table describes, in a process that no Ctrl-C of this one reaches.

    Raises:
        ValueError: an option is unknown or wrong; names the key. Nothing was started.
        LaunchError: the process ended, or gave no ports in time.
    """
    settings = SimulatorSettings.from_options(options)
    process = subprocess.Popen(  # noqa: S603 (this interpreter, this package)
        [sys.executable, "-m", "calrig.simulator", json.dumps(dict(options))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    too_late = threading.Timer(START_TIMEOUT_S, process.kill)
    too_late.start()
    assert process.stdout is not None  # noqa: S101 (asked for above)
    line = process.stdout.readline()
    too_late.cancel()
    try:
        said = json.loads(line)
        return SimulatedProcess(process, said["stage"], said["imu"], said.get("clamp"), settings.time_scale)
    except (ValueError, KeyError) as error:
        _end(process)
        raise LaunchError(
            f"the simulated rig's process gave no ports (exit status {process.returncode}); "
            f"run `{sys.executable} -m calrig.simulator` by hand to see why"
        ) from error


def _end(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None and process.stdout is not None  # noqa: S101 (asked for in launch)
    process.stdin.close()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()
