"""GRBL behind damage, and simulated ones that lose what a real one loses."""

from __future__ import annotations

import pytest
from grbl_script import BANNER, GO, IDLE, Script
from hypothesis import given, settings
from hypothesis import strategies as st
from stage_ports import KINDS, READ_S, InProcessPort, homed, moved_to, simulated, until_it_stands

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
        script.answers[f"{GO} X10"] = b"error:9\r\n"
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
    assert script.lines[-2:] == [f"{GO} X20", "$$"]


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
    stage.identify()
    stage.home()
    assert until_it_stands(stage) == "not_referenced"
    assert "ALARM:9, homing failed: no limit switch found" in stage.status().words


def test_a_simulated_one_that_is_reset_on_the_move_never_gives_an_angle():
    port = simulated("grbl", stage={"homing": False})
    stage = Grbl(port)
    stage.identify()
    stage.move(170)
    port.device.reset()
    with pytest.raises(StageError, match="lost its angle"):
        stage.position_deg()


def test_a_count_that_jumps_while_it_stands_costs_the_angle():
    controller = Script()
    stage = homed(Grbl(InProcessPort(controller)))
    controller.report = "<Idle|MPos:40.000,0.000,0.000|FS:0,0>"
    stage.move(40)
    assert stage.position_deg() == 40
    controller.report = IDLE
    with pytest.raises(StageError, match="from 40° to 0°"):
        stage.position_deg()


@pytest.mark.parametrize("cut", [3, 12, 20, len(BANNER) - 1])
def test_a_banner_that_has_half_arrived_is_heard_whole(cut):
    controller = Script()
    port = InProcessPort(controller)
    stage = homed(Grbl(port))
    rest = [BANNER[cut:]]
    receive = controller.receive
    controller.receive = lambda data: (rest.pop() if rest else b"") + receive(data)
    port.push(BANNER[:cut])
    assert "its count with it" in stage.status().words


@pytest.mark.parametrize("homing", [True, False], ids=["with a switch", "without"])
def test_a_reset_whose_banner_is_lost_on_the_way_to_0_is_known_and_0_is_not_believed(homing):
    """Its count begins anew at 0, which is where it was sent: the motor stands elsewhere."""
    port = simulated("grbl", stage={"homing": homing})
    stage = Grbl(port)
    stage.identify()
    if homing:
        homed(stage)
    moved_to(stage, 60)
    stage.move(0)
    port.device.reset()
    port.clock.sleep(READ_S)
    port.lose_what_is_said()
    if homing:  # somebody unlocks it, so that it says Idle
        port.device.receive(b"$X\n")
        port.clock.sleep(READ_S)
        port.lose_what_is_said()
    port.device.receive(b"?")
    port.clock.sleep(READ_S)
    assert "<Idle|MPos:0.000" in port.device.emit().decode()
    with pytest.raises(StageError, match=r"lost its angle.*reset"):
        stage.position_deg()
    with pytest.raises(StageError, match="takes no move"):
        stage.move(10)


def test_a_hard_limit_on_the_move_is_told_as_what_it_is_and_homed_away():
    port = simulated("grbl")
    stage = homed(Grbl(port))
    stage.move(170)
    port.device.set_limit_switch(closed=True)
    port.device.set_limit_switch(closed=False)
    assert "ALARM:1, a limit switch was hit" in stage.status().words
    with pytest.raises(StageError, match=r"lost its angle.*ALARM:1"):
        stage.position_deg()
    with pytest.raises(StageError, match="ALARM:1"):
        stage.move(0)
    stage.home()
    assert until_it_stands(stage) == "ready"
    assert moved_to(stage, 20).position_deg() == 20


@pytest.mark.parametrize("words", ["G20", "G91", "T3", "G92 X5"])
@pytest.mark.parametrize("homing", [True, False], ids=["with a switch", "without"])
def test_another_programs_line_costs_the_angle(words, homing):
    port = simulated("grbl", stage={"homing": homing})
    stage = Grbl(port)
    stage.identify()
    if homing:
        homed(stage)
    moved_to(stage, 10)
    port.device.receive(f"{words}\n".encode())
    with pytest.raises(StageError, match="another program sends it G-code"):
        stage.position_deg()


def test_a_grbl_before_1_1_is_named():
    port = simulated("grbl", stage={"firmware": "0.9j"})
    with pytest.raises(StageError, match=r"Grbl 0\.9j.*GRBL 1\.1"):
        Grbl(port).identify()
    assert b"\x18" not in port.sent


def test_its_firmware_is_known_without_a_banner():
    port = simulated("grbl", stage={"firmware": "1.1f"})
    port.lose_what_is_said()
    assert Grbl(port).identify().firmware == "Grbl 1.1f"
