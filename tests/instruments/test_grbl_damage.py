"""GRBL behind damage, and simulated ones that lose what a real one loses."""

from __future__ import annotations

import pytest
from grbl_script import Script
from hypothesis import given, settings
from hypothesis import strategies as st
from stage_ports import KINDS, InProcessPort, homed, moved_to, simulated, until_it_stands

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl.driver import Grbl


@given(
    damages=st.lists(st.sampled_from(KINDS), max_size=12),
    steps=st.integers(-35_000, 35_000),
)
@settings(max_examples=40, deadline=None)
def test_no_damage_is_taken_for_a_place_and_the_next_command_is_answered(damages, steps):
    truth_deg = steps / 200
    script = Script()
    script.report = f"<Idle|MPos:{truth_deg:.3f},0.000,0.000|FS:0,0>"
    port = InProcessPort(script, "property")
    stage = Grbl(port)
    stage.identify()
    port.damages = list(damages)
    for _ in range(3):
        try:
            assert stage.position_deg() == truth_deg
            assert stage.status().state == "not_referenced"
        except StageError:
            continue  # said to be unreadable, which it was
    port.damages = []
    assert stage.position_deg() == truth_deg


@given(damages=st.lists(st.sampled_from(KINDS), max_size=10), refused=st.booleans())
@settings(max_examples=40, deadline=None)
def test_no_damage_makes_a_refused_move_an_accepted_one(damages, refused):
    script = Script()
    port = InProcessPort(script, "property")
    stage = homed(Grbl(port))
    stage.move(0)
    if refused:
        script.answers["G0 X10"] = b"error:9\r\n"
    port.damages = ["sound", *damages]
    try:
        stage.move(10)
    except StageError:
        pass
    else:
        assert not refused
    port.damages = []
    script.answers.clear()
    stage.move(20)
    assert script.lines[-2:] == ["G0 X20", "$$"]


def test_a_simulated_one_homes_moves_and_stops():
    stage = homed(Grbl(simulated("grbl")))
    assert stage.position_deg() == 0
    assert moved_to(stage, -30.5).position_deg() == -30.5
    stage.move(170)
    stage.halt()
    assert until_it_stands(stage) == "disabled"
    assert stage.position_deg() < 170
    stage.close()


def test_a_simulated_one_that_finds_no_switch_says_so():
    stage = Grbl(simulated("grbl", mechanics={"obstruction_deg": 2.0}))
    with pytest.raises(StageError, match="ALARM:9, homing failed: no limit switch found"):
        stage.home()
    assert stage.status().state == "not_referenced"


def test_a_simulated_one_that_is_reset_on_the_move_never_gives_an_angle():
    port = simulated("grbl", stage={"homing": False})
    stage = Grbl(port)
    stage.identify()
    stage.move(170)
    port.device.reset()
    with pytest.raises(StageError, match="lost its angle"):
        stage.position_deg()
