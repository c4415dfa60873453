"""A simulated rig as a process of its own: options in, ports and drivers out, both as JSON.

`python -m calrig.simulator '{"preset": "demo"}'` runs until its standard input closes (so that it never
outlives the process that started it) or it is terminated or interrupted.
"""

import json
import signal
import sys
from typing import NoReturn

from calrig.simulator.clamp import IndexClamp
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig

WRONG_USAGE = 2


def main(arguments: list[str]) -> int:
    """Serves one rig; returns the exit status."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _terminated)
    try:
        options = json.loads(arguments[0]) if arguments else {}
        if not isinstance(options, dict):
            raise ValueError("the options must be one JSON object")
        settings = SimulatorSettings.from_options(options)
    except ValueError as error:
        sys.stderr.write(f"simulated rig: {error}\n")
        return WRONG_USAGE
    with SimulatedRig(settings) as rig:
        stage = {"driver": rig.stage_driver, "port": rig.stage_port}
        imu = {"driver": rig.imu_driver, "port": rig.imu_port}
        clamp = {"clamp": {"driver": IndexClamp.driver, "port": rig.clamp_port}} if rig.clamp_port else {}
        sys.stdout.write(json.dumps({"stage": stage, "imu": imu, **clamp}) + "\n")
        sys.stdout.flush()
        sys.stdin.buffer.read()
    return 0


def _terminated(_signal: int, _frame: object) -> NoReturn:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
