from __future__ import annotations

import itertools
import socket
import threading

import numpy as np
import pytest
from instrument_fakes import IDENTITY, FakeBoard, packet, sample, take_n

from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.errors import BoardError, PortError
from calrig.instruments.types import GAP_PERIODS, BoardIdentity


def test_it_says_who_it_is(board):
    assert board.identify() == BoardIdentity("calrig", "calrig 1.0", "AS-0042", "MPU-6050", 2, 250, 1000)


def test_it_is_asked_until_it_answers(device, board):
    device.ids_to_ignore = 3
    assert board.identify().serial == "AS-0042"
    assert device.received.count("ID") == 4


def test_one_that_says_it_at_power_up_is_heard_and_extra_identities_do_no_harm(device, board):
    for _ in range(3):
        device.say_identity()
    board.identify()
    device.say_identity()
    board.start(200)
    device.stream(5)
    assert len(take_n(board, 5)) == 5
    assert not board.faults


def test_what_a_board_does_not_say_is_not_known(device, board):
    device.identity = {"accel_range_g": 4, "gyro_range_dps": 500}
    assert board.identify() == BoardIdentity("calrig", None, "", None, 4, 500, None)


@pytest.mark.parametrize(
    "identity",
    [
        {**IDENTITY, "accel_range_g": 3},
        {**IDENTITY, "gyro_range_dps": None},
        [1],
        {**IDENTITY, "max_rate_hz": "9"},
    ],
)
def test_an_identity_that_cannot_be_used_is_said(device, board, identity):
    device.identity = {}
    device.say_identity = lambda: device.wire.send(packet(1, str(identity).replace("'", '"').encode()))
    with pytest.raises(BoardError, match="identity that cannot be used"):
        board.identify()


def test_a_silent_board_fails_in_words(device, board):
    device.ids_to_ignore = 1000
    device.on_line = lambda line: None
    with pytest.raises(BoardError, match=rf"on {device.path} .*no identity in 5 s.*silent"):
        board.identify()


def test_a_board_with_another_sketch_or_baud_rate_fails_in_words(device, board):
    device.on_line = lambda line: device.wire.send(b"a/g:\t1\t2\t3\t4\t5\t6\r\n")
    with pytest.raises(BoardError, match=r"no identity.*baud rate.*sketch"):
        board.identify()


def test_a_board_left_streaming_by_a_process_before_is_taken_over(device):
    board = CalrigBoard.open(device.path)
    device.stream(30)
    device.wire.send(sample(31, 1)[5:])
    board.identify()
    device.stream(3)
    board.start(200)
    device.stream(4)
    block = take_n(board, 4)
    np.testing.assert_allclose(block.time_s, [0, 0.005, 0.01, 0.015], atol=1e-9)
    assert not board.faults
    assert device.received[0] == "STOP"
    board.close()


def test_samples_come_in_order_and_in_units(device, streaming):
    device.stream(500)
    block = take_n(streaming, 500)
    np.testing.assert_allclose(block.time_s, np.arange(500) * 0.005, atol=1e-9)
    np.testing.assert_allclose(block.accel_g[:, 2], 1.0)
    np.testing.assert_allclose(block.temperature_c, -512 / 340 + 36.53)
    assert not streaming.faults


def test_take_gives_nothing_when_nothing_came_and_the_board_is_not_streaming(board):
    board.identify()
    assert len(board.take(0.01)) == 0


def test_a_rate_above_the_boards_is_refused_without_asking_it(device, board):
    board.identify()
    with pytest.raises(BoardError, match="at 1000 Hz at most, not 2000 Hz"):
        board.start(2000)
    assert not [line for line in device.received if line.startswith("START")]


def test_a_refusal_comes_in_the_boards_own_words(device, board):
    board.identify()
    device.refusal = "rate 200 not possible with FILTER ON"
    with pytest.raises(BoardError, match=r"START 200.*FILTER ON"):
        board.start(200)


def test_a_start_that_was_damaged_on_its_way_is_sent_again(device, board):
    board.identify()
    answer, refusals = device.on_line, ["unknown command: STRT 200"]

    def answer_but_once(line):
        device.refusal = refusals.pop() if line.startswith("START") and refusals else None
        answer(line)

    device.on_line = answer_but_once
    board.start(200)
    assert device.received.count("START 200") == 2


def test_a_start_whose_acknowledge_is_lost_is_sent_again(device, board):
    board.identify()
    device.starts_to_ignore = 1
    board.start(200)
    device.stream(3)
    assert len(take_n(board, 3)) == 3
    assert device.received.count("START 200") == 2


def test_a_start_acknowledged_twice_begins_again_at_seq_0(device, streaming):
    device.stream(10)
    take_n(streaming, 10)
    device.seq = 0
    device.wire.send(packet(4, b"START 200"))
    device.stream(10)
    block = take_n(streaming, 10)
    assert block.time_s[0] > 0.045
    assert not streaming.faults


def test_a_board_that_never_acknowledges_fails_in_words(device, board):
    board.identify()
    device.starts_to_ignore = 100
    with pytest.raises(BoardError, match="did not acknowledge START 200"):
        board.start(200)


def test_stop_is_acknowledged_and_what_came_before_can_be_taken(device, streaming):
    device.stream(5)
    streaming.stop()
    device.stream(5)
    streaming.identify()
    assert len(streaming.take(0.1)) == 5


def test_damage_is_counted_by_kind_and_never_enters_the_samples(device, streaming):
    spoilt = bytearray(sample(5, 26_000, (31_000, 0, 0, 0, 0, 0, 0)))
    spoilt[-3] ^= 0x10
    device.stream(5)
    device.wire.send(bytes(spoilt) + b"noise\0" + packet(3, b"I2C time-out"))
    device.seq, device.t_us = device.seq + 1, device.t_us + 5000
    device.stream(5)
    block = take_n(streaming, 10)
    assert block.accel_g[:, 0].max() < 0.001
    np.testing.assert_allclose(block.time_s[5], 0.03, atol=1e-9)
    assert streaming.faults == {"crc": 1, "unparsed": 1, "board_error": 1, "sequence_gap": 1}


def test_a_board_that_resets_is_started_again_and_time_goes_on(device, streaming):
    device.stream(10)
    before = take_n(streaming, 10)
    device.t_us = 500
    device.say_identity()
    device.wait_for("START 200", times=2)
    device.stream(10)
    after = take_n(streaming, 10)
    assert after.time_s[0] - before.time_s[-1] > GAP_PERIODS * 0.005, "so that nobody filters across it"
    np.testing.assert_allclose(np.diff(after.time_s), 0.005, atol=1e-9)
    assert streaming.faults == {"board_reset": 1}


def test_a_board_that_falls_silent_is_started_again(device, streaming):
    device.stream(3)
    take_n(streaming, 3)
    streaming.take(1.1)
    device.wait_for("START 200", times=2)
    device.stream(3)
    assert len(take_n(streaming, 3)) == 3
    assert streaming.faults["restarted"] == 1


def test_another_board_in_its_place_ends_the_stream(device, streaming):
    device.identity["serial"] = "AS-0043"
    device.say_identity()
    with pytest.raises(BoardError, match=r"exchanged.*'AS-0043'"):
        take_n(streaming, 1)


def test_a_board_that_falls_silent_fails_in_words_though_it_answers_every_start(device, streaming):
    device.stream(3)
    device.wire.send(packet(3, b"sensor lost"))
    with pytest.raises(BoardError, match=r"no usable sample.*silent.*'sensor lost'"):
        take_n(streaming, 100)


@pytest.mark.parametrize(
    ("registers", "words"),
    [((1, 2, 3, 4, 5, 6, 7), "registers do not change"), ((0,) * 7, "no sensor answers the board")],
)
def test_a_sensor_that_hangs_or_is_not_there_fails_in_words(device, streaming, registers, words):
    samples = (sample(k, 1000 + 5000 * k, registers) for k in itertools.count())
    enough = device.wire.keep_sending(samples, every_s=0.005)
    with pytest.raises(BoardError, match=words):
        take_n(streaming, 100)
    enough.set()


def test_a_clock_that_does_not_fit_the_rate_fails_in_words(device, streaming):
    samples = (sample(k, 1000 + 60_000 * k, (k + 1, 0, 0, 0, 0, 0, 0)) for k in itertools.count())
    enough = device.wire.keep_sending(samples, every_s=0.005)
    with pytest.raises(BoardError, match=r"clock.*rate"):
        take_n(streaming, 100)
    enough.set()


def test_bytes_without_a_whole_packet_fail_in_words(device, streaming):
    enough = device.wire.keep_sending(itertools.repeat(b"\x9c\x00\x66"), every_s=0.005)
    with pytest.raises(BoardError, match=r"no packet.*baud rate"):
        take_n(streaming, 100)
    enough.set()


def test_a_pulled_cable_is_a_port_error_after_what_came_before(device, streaming):
    device.stream(5)
    assert len(take_n(streaming, 5)) == 5
    device.vanish()
    with pytest.raises(PortError, match="went away"):
        take_n(streaming, 1)
    streaming.close()


def test_closing_tells_a_streaming_board_to_stop(device, streaming):
    streaming.close()
    device.wait_for("STOP", times=2)


def test_the_driver_reads_over_a_socket_alike():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection, connection.makefile("rb") as lines:
                fake = object.__new__(FakeBoard)
                fake.identity, fake.refusal, fake.ids_to_ignore, fake.starts_to_ignore = IDENTITY, None, 0, 0
                fake.wire = type("Wire", (), {"send": staticmethod(connection.sendall)})
                for line in lines:
                    fake.on_line(line.decode().strip())
                    if line.startswith(b"START"):
                        fake.t_us = 0
                        fake.stream(300)

        serving = threading.Thread(target=serve, daemon=True)
        serving.start()
        board = CalrigBoard.open(f"socket://127.0.0.1:{server.getsockname()[1]}")
        board.identify()
        board.start(200)
        assert len(take_n(board, 300)) == 300
        assert not board.faults
        board.close()
        serving.join()
