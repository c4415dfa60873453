from __future__ import annotations

import re

import pytest
from scripted_stage import Clock

from calrig.instruments.axis import Axis, Motion
from calrig.instruments.errors import StageError
from calrig.instruments.stages.smc100.driver import Smc100


def test_an_axis_drives_a_controller_over_its_wire(controller):
    axis = Axis(Smc100.open(controller.path), zero_deg=5.0, sign=-1, ratio=1.0)
    axis.identify()
    assert axis.needs_home()
    axis.begin_home()
    assert axis.poll().moving
    controller.state = "32"
    assert not axis.poll().moving
    axis.begin_move(30.0)
    controller.state, controller.position = "28", "-10"
    assert axis.poll() == Motion(15.0, moving=True)
    controller.state, controller.position = "33", "-25"
    assert axis.poll() == Motion(30.0, moving=False)
    axis.close()
    assert [line for line in controller.received if re.match("1(OR|PA-)", line)] == ["1OR", "1PA-25"]


def test_a_move_the_controller_never_heard_of_fails(controller):
    clock = Clock()
    axis = Axis(Smc100.open(controller.path), clock=clock)
    controller.state = "33"
    axis.begin_move(30.0)
    axis.poll()
    clock.at_s += 1.1
    with pytest.raises(StageError, match=r"30°.*0\.000°"):
        axis.poll()
    axis.close()
