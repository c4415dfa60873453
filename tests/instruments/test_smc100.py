"""The driver of the SMC100: no damaged, late or foreign bytes on its wire are taken for an answer."""

from __future__ import annotations

import re
import threading

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from instrument_fakes import CLOCK, FakeSmc100

from calrig.instruments.errors import Halted, PortError, StageError
from calrig.instruments.stages.smc100.driver import Smc100
from calrig.instruments.types import StageIdentity

STATES = [
    *(((f"{code:02X}"), "not_referenced", "NOT REFERENCED") for code in range(0x0A, 0x12)),
    ("14", "configuration", "CONFIGURATION"),
    ("1E", "homing", "HOMING"),
    ("1F", "homing", "HOMING"),
    ("28", "moving", "MOVING"),
    *(((f"{code:02X}"), "ready", "READY") for code in range(0x32, 0x36)),
    *(((f"{code:02X}"), "disabled", "DISABLE") for code in range(0x3C, 0x3F)),
    ("46", "moving", "JOGGING"),
    ("47", "moving", "JOGGING"),
]


def sent(controller, kind):
    return [line for line in controller.received if re.match(rf"1{kind}[^?]*$", line)]


def test_it_says_who_it_is_and_what_it_allows(stage):
    assert stage.identify() == StageIdentity("smc100", "SMC100CC 2.1.0", (-120.0, 130.5), 20.0, 80.0)


def test_what_it_does_not_answer_is_not_known(controller, stage):
    controller.unknown = {"VE", "AC?", "SR?"}
    assert stage.identify() == StageIdentity("smc100", None, None, 20.0, None)


def test_opening_and_identifying_moves_nothing(controller, stage):
    stage.identify()
    assert not sent(controller, "(OR|PA|PR|MM|RS|PW)")


@pytest.mark.parametrize(("code", "state", "words"), STATES)
def test_every_state_is_said_in_words(controller, stage, code, state, words):
    controller.state = code
    status = stage.status()
    assert status.state == state
    assert status.words.startswith(words)


@pytest.mark.parametrize(
    ("bits", "words"),
    [
        ("0001", "negative end of run"),
        ("0002", "positive end of run"),
        ("0020", "following error"),
        ("0200", "80 W"),
        ("0140", "homing time-out, DC voltage too low"),
    ],
)
def test_error_bits_are_said_in_words(controller, stage, bits, words):
    controller.state, controller.error_bits = "3D", bits
    assert words in stage.status().words


@pytest.mark.parametrize("text", ["0", "-0.123", "359.9999", "1E1", "+12."])
def test_the_position_is_read_as_written(controller, stage, text):
    controller.position = text
    assert stage.position_deg() == float(text)


@pytest.mark.parametrize(
    ("target_deg", "line"),
    [(10, "1PA10"), (-59.999999, "1PA-59.999999"), (1e-7, "1PA0"), (-1e-9, "1PA0"), (0.1 + 0.2, "1PA0.3")],
)
def test_a_move_is_sent_once_and_its_error_and_target_asked_for(controller, stage, target_deg, line):
    controller.state = "33"
    stage.move(target_deg)
    assert sent(controller, "PA") == [line]
    after = controller.received[controller.received.index(line) + 1 :]
    assert after[0] == "1TE"
    assert set(after[1:]) == {"1PA?"}


def test_velocity_is_sent_in_stage_degrees(controller, stage):
    stage.set_velocity(12.5)
    assert sent(controller, "VA") == ["1VA12.5"]


@pytest.mark.parametrize(
    ("letter", "words"),
    [
        *((letter, rf"\(error {letter}\)") for letter in "ABDEFQSUVWX"),
        ("C", "parameter"),
        ("G", "displacement"),
        ("H", "in NOT REFERENCED"),
        ("I", "in CONFIGURATION"),
        ("J", "in DISABLE"),
        ("K", "in READY"),
        ("L", "in HOMING"),
        ("M", "in MOVING"),
        ("N", "software limit"),
    ],
)
def test_a_refused_move_is_refused_in_words(controller, stage, letter, words):
    controller.state, controller.refuse = "33", {"PA": letter}
    with pytest.raises(StageError, match=rf"PA10: .*{words}"):
        stage.move(10)
    perhaps_damaged = letter in "ABCN"
    assert sent(controller, "PA") == ["1PA10"] * (5 if perhaps_damaged else 1)


def test_a_move_that_was_lost_on_its_way_is_sent_again(controller, stage):
    controller.state, controller.lost = "33", ["PA10"]
    stage.move(10)
    assert sent(controller, "PA") == ["1PA10", "1PA10"]
    assert stage.faults == {"resent": 1}


def test_a_move_that_was_taken_for_another_is_stopped(controller, stage):
    controller.state, controller.lost, controller.target = "28", ["PA10"], "90"
    with pytest.raises(StageError, match=r"PA10.*90.*stopped"):
        stage.move(10)
    controller.wait_for("1ST")
    assert sent(controller, "(PA|ST)") == ["1PA10", "1ST"]


def test_a_move_that_was_taken_as_sent_is_no_refusal_whatever_a_damaged_letter_says(controller, stage):
    controller.state, controller.say["TE"] = "28", [b"1TE@\r\n", b"1TEA\r\n"]
    stage.move(10)
    assert sent(controller, "(PA|ST)") == ["1PA10"]


def test_a_controller_that_does_not_tell_its_target_is_accepted(controller, stage):
    controller.state = "33"
    controller.unknown = {"PA?"}
    stage.move(10)
    stage.move(20)
    assert sent(controller, "PA") == ["1PA10", "1PA20"]


def test_a_controller_that_tells_its_place_for_its_target_is_accepted(controller, stage):
    controller.state, controller.position = "28", "0.2"
    controller.say["PA?"] = [b"1PA0.2\r\n"] * 3
    stage.move(10)
    assert sent(controller, "(PA|ST)") == ["1PA10"]


def test_limits_are_accepted_when_they_came_twice_alike(controller, stage):
    controller.say["SL?"] = [b"1SL-160\r\n"]
    assert stage.identify().limits_deg == (-120.0, 130.5)


def test_an_error_of_long_ago_is_not_taken_for_this_moves(controller, stage):
    controller.state, controller.error = "33", "S"
    stage.move(10)
    assert sent(controller, "PA") == ["1PA10"]


def test_it_homes_from_not_referenced_only(controller, stage):
    stage.home()
    assert sent(controller, "OR") == ["1OR"]
    with pytest.raises(StageError, match=r"NOT REFERENCED.*in HOMING"):
        stage.home()
    assert sent(controller, "OR") == ["1OR"]


def test_homing_is_never_sent_twice_even_if_its_answer_is_lost(controller, stage):
    controller.on_command = lambda command: setattr(
        controller, "silent", controller.silent or command == "OR"
    )
    with pytest.raises(StageError, match="does not answer TE"):
        stage.home()
    assert sent(controller, "OR") == ["1OR"]


def test_a_disabled_motor_is_switched_on_once_when_it_is_identified(controller, stage):
    controller.state = "3C"
    stage.identify()
    assert sent(controller, "MM") == ["1MM1"]
    assert stage.status().state == "ready"


def test_a_motor_that_stays_disabled_fails_in_words_and_no_flash_is_written(controller, stage):
    controller.state, controller.say["MM1"] = "3D", [b""]
    controller.error_bits = "0020"
    with pytest.raises(StageError, match=r"DISABLE from MOVING \(following error\)"):
        stage.identify()
    assert sent(controller, "(MM|PW)") == ["1MM1"]


def test_a_silent_stage_fails_in_words(controller, stage):
    controller.silent = True
    with pytest.raises(StageError, match=rf"address 1 on {controller.path} does not answer TS .*check power"):
        stage.identify()


def test_it_answers_again_after_a_silence(controller, stage):
    controller.silent = True
    for _ in range(2):
        with pytest.raises(StageError):
            stage.status()
    controller.silent, controller.state = False, "28"
    assert stage.status().state == "moving"


def test_a_pulled_cable_is_a_port_error(controller, stage):
    controller.vanish()
    with pytest.raises(PortError, match="went away"):
        stage.status()


def test_a_halt_is_on_the_wire_within_100_ms_while_the_stage_answers_nothing(controller, stage):
    controller.silent = True

    def ask():
        with pytest.raises(StageError):
            stage.status()

    asking = CLOCK.thread(ask, "asking")
    asking.start()
    controller.wait_for("1TS")
    asked_s = CLOCK.now_s()
    stage.halt()
    assert controller.wait_for("1ST") - asked_s < 0.1
    assert asking.is_alive()
    asking.join()


def test_no_motion_is_sent_once_it_is_halted(controller, stage):
    controller.state = "0A"
    stage.halt()
    with pytest.raises(Halted, match="PA10 was not sent"):
        stage.move(10)
    with pytest.raises(Halted, match="OR was not sent"):
        stage.home()
    assert not sent(controller, "(PA|OR)")


def test_a_halt_between_the_check_of_a_move_and_its_sending_still_wins(controller, stage):
    controller.state = "33"
    controller.on_command = lambda command: command == "TE" and CLOCK.at(CLOCK.now_s(), stage.halt)
    with pytest.raises(Halted):
        stage.move(10)
    assert not sent(controller, "PA")


def test_whatever_the_moment_no_move_follows_a_stop(controller):
    """Halts at growing delays into a move: the stop is always the last motion command on the wire."""
    controller.state = "33"
    for k, delay_us in enumerate(range(0, 3000, 150)):
        stage = Smc100.open(controller.path)
        halting = threading.Timer(delay_us * 1e-6, stage.halt)
        halting.start()
        try:
            while True:
                stage.move(10)
        except Halted:
            halting.join()
        stage.status()
        stage.close()
        controller.wait_for("1ST", times=k + 1)
        assert sent(controller, "(PA|ST)")[-1] == "1ST"


def test_the_stop_can_be_sent_again(controller, stage):
    stage.halt()
    stage.halt()
    stage.status()
    assert sent(controller, "ST") == ["1ST", "1ST"]


def test_another_address_is_asked_by_its_own_number(controller):
    stage = Smc100.open(controller.path, axis=12)
    controller.on_line = lambda line: controller.wire.send(b"1TP1\r\n12TP3.5\r\n") if line == "12TP" else None
    assert stage.glimpse_deg() == 3.5
    stage.close()


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


@pytest.mark.parametrize("state", ["0000ZZ", "000077", "33"])
def test_a_state_that_does_not_exist_is_not_accepted(controller, stage, state):
    controller.say["TS"] = [f"1TS{state}\r\n".encode()] * 4
    with pytest.raises(StageError, match=rf"answers TS with '{state}'.*(unparsed|late_reply)"):
        stage.status()


def test_a_line_that_begins_as_no_query_is_no_answer(controller, stage):
    controller.say["TS"] = [b"garbage\r\n"] * 4
    with pytest.raises(StageError, match=r"does not answer TS .*unparsed"):
        stage.status()


def test_a_position_that_is_no_number_is_quoted(controller, stage):
    controller.state, controller.position = "33", "nan"
    with pytest.raises(
        StageError, match=r"answers TP with 'nan', which cannot be read .*check the serial cable"
    ):
        stage.position_deg()


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
