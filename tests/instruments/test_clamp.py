"""The dividing head that turns a unit in its clamp, against its simulated counterpart on a wire."""

from __future__ import annotations

from contextlib import ExitStack, closing

import numpy as np
import pytest
from stage_ports import InProcessPort
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.instruments.index_clamp import ClampError, IndexClamp
from calrig.simulator.config import SimulatorSettings


@pytest.fixture
def make_rig():
    """Rigs with a head, in virtual time."""
    clock = VirtualClock()
    with ExitStack() as stack:
        stack.enter_context(clock.taking_part())
        yield lambda **clamp: stack.enter_context(
            virtual_rig(SimulatorSettings.from_options({"preset": "ideal", "clamp": clamp}), clock)
        )


def test_it_says_who_it_is_and_answers_once_the_unit_sits(make_rig):
    rig = make_rig()
    with closing(IndexClamp.open(rig.clamp_port)) as head:
        assert head.identify().startswith("INDEX")
        began_s = rig.clock()
        head.turn_to(-90.0, "x")
        assert 1.0 < rig.clock() - began_s < 3.0
        stands_deg = rig.bench.sensor(np.array([rig.clock()])).angle_deg
        assert stands_deg == pytest.approx(4.0 - 90.0)  # the stage stands at 4°
        with pytest.raises(ClampError, match=r"refused CLAMP 90\.000 w: unknown"):
            head.turn_to(90.0, "w")


def test_one_that_is_mute_is_said_to_be(make_rig):
    with closing(IndexClamp.open(make_rig(fault="hang").clamp_port)) as head:
        with pytest.raises(ClampError, match="does not answer ID"):
            head.identify()
        with pytest.raises(ClampError, match="60 s"):
            head.turn_to(0.0, "x")


class Stranger:
    """Some other device, on the port that is said to be the clamp's."""

    def receive(self, _data: bytes) -> bytes:
        return b"Grbl 1.1h ['$' for help]\r\n"

    def emit(self) -> bytes:
        return b""


def test_another_device_in_its_place_is_quoted():
    quoted = pytest.raises(ClampError, match=r"answers ID with \"Grbl 1\.1h.*instead of INDEX")
    with closing(IndexClamp(InProcessPort(Stranger()))) as head, quoted:
        head.identify()
