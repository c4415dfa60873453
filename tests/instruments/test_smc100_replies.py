"""Damaged, late and foreign bytes on the wire of an SMC100: none of them is taken for an answer."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from instrument_fakes import CLOCK, FakeSmc100

from calrig.instruments.errors import StageError
from calrig.instruments.stages.smc100.driver import Smc100


def test_a_nul_byte_tells_that_motor_power_was_cut(controller, stage):
    controller.state, controller.say["TS"] = "3D", [b"\x001TS00003D\r\n"]
    status = stage.status()
    assert status.state == "disabled"
    assert "motor power is cut" in status.words
    assert stage.faults == {"unparsed": 1}


def test_an_echo_another_address_and_noise_are_dropped_and_counted(controller, stage):
    controller.say["TP"] = [b"1TP\r\n2TP7.5\r\n\xff\xfe\r\n1TS000033\r\n1TP4.25\r\n"]
    assert stage.glimpse_deg() == 4.25
    assert stage.faults == {"unparsed": 2, "late_reply": 2}


def test_a_reply_of_address_eleven_is_not_address_ones(controller, stage):
    controller.say["TP"] = [b"11TP7.5\r\n1TP4.25\r\n"]
    assert stage.glimpse_deg() == 4.25


def test_a_late_reply_is_not_taken_for_the_answer_to_the_same_question_asked_again(controller, stage):
    held = [b"1TP1.0\r\n"]
    controller.say["TP"] = [b"", b"1TP2.0\r\n"]

    def release_with_the_next_command(command):
        if command != "TP" and held:
            controller.wire.send(held.pop())

    controller.on_command = release_with_the_next_command
    assert stage.glimpse_deg() == 2.0
    assert stage.faults == {"late_reply": 1, "no_reply": 1}


def test_what_arrived_before_a_question_is_not_its_answer(controller, stage):
    controller.wire.send(b"1TP99\r\n1TS00003C\r\n")
    CLOCK.sleep(0.01)
    controller.position, controller.state = "1.5", "33"
    assert stage.glimpse_deg() == 1.5
    assert stage.status().state == "ready"
    assert stage.faults == {"late_reply": 2}


@pytest.mark.parametrize(
    "damaged",
    [
        b"1TP12",
        b"1TP12\r\n.5\r",
        b"1TP12\r.5\r\n",
        b"P12.5\r\n",
        b"1TP1\x002.5\r\n",
        b"1TS00",
        b"x" * 1000,
        b"\x13",
        b"",
    ],
)
def test_it_recovers_from_a_damaged_reply_within_one_command(controller, stage, damaged):
    controller.position = "-7.125"
    controller.say["TP"] = [damaged, b"1TP-7.125\r\n"]
    assert stage.position_deg() == -7.125


def test_a_misread_digit_is_not_accepted(controller, stage):
    controller.state, controller.position = "33", "12.3"
    controller.say["TP"] = [b"1TP17.3\r\n"]
    assert stage.position_deg() == 12.3


def test_a_position_that_never_agrees_fails_in_words(controller, stage):
    controller.state = "33"
    controller.say["TP"] = [b"1TP%d\r\n" % k for k in range(20)]
    with pytest.raises(StageError, match="differ"):
        stage.position_deg()


@pytest.mark.parametrize("reply", [b"1TS0000ZZ\r\n", b"1TS000077\r\n", b"1TS33\r\n", b"garbage\r\n"])
def test_a_state_that_does_not_exist_is_not_accepted(controller, stage, reply):
    controller.say["TS"] = [reply] * 4
    with pytest.raises(StageError, match=r"does not answer TS .*(unparsed|late_reply)"):
        stage.status()


junk_line = st.one_of(
    st.sampled_from(
        [b"1TP", b"1PA10", b"1TS000033", b"1TE@", b"2TP5", b"11TP5", b"-1TP5", b"TP5", b"1TP5,0"]
    ),
    st.binary(max_size=20).map(lambda line: line.replace(b"\n", b"").replace(b"TP", b"")),
)


@pytest.fixture(scope="module")
def shared():
    controller = FakeSmc100()
    stage = Smc100.open(controller.path)
    yield controller, stage
    stage.close()
    controller.vanish()


@given(junk=st.lists(junk_line, max_size=6), thousandths=st.integers(-360_000, 360_000))
@example(junk=[b"\0", b"\x11", b"\r"], thousandths=0)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_junk_before_a_reply_is_taken_for_it(shared, junk, thousandths):
    controller, stage = shared
    truth = f"{thousandths / 1000:.3f}"
    controller.say["TP"] = [b"".join(line + b"\r\n" for line in junk) + f"1TP{truth}\r\n".encode()]
    assert stage.glimpse_deg() == float(truth)
