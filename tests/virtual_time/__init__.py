"""Simulated rigs in virtual time: their ports are in this process, `sim://NAME`."""

from collections.abc import Callable
from functools import partial

from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig
from calrig.simulator.wire import Device
from virtual_time.clock import VirtualClock
from virtual_time.world import SimWire


def virtual_rig(settings: SimulatorSettings, clock: VirtualClock) -> SimulatedRig:
    """Return a rig whose devices and ports live by a virtual clock."""
    return SimulatedRig(settings, now_s=clock.now_s, plug_in=partial(_plugged, clock))


def _plugged(
    clock: VirtualClock, device: Device, name: str, most_waiting_bytes: int, opened: Callable[[], None]
) -> SimWire:
    return SimWire(device, name, clock, most_waiting_bytes, opened)
