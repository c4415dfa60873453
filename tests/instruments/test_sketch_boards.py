"""Boards that print text, on a wire: who they are, their time, and all that goes wrong with them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from instrument_fakes import CLOCK, TAKES, SimulatedEnd, take_n
from sketch_texts import BANNERS, BY_DRIVER

from calrig.instruments import drivers
from calrig.instruments.boards.sketch_board import READ_TIMEOUT_S, SketchBoard
from calrig.instruments.errors import BoardError, PortError

RAW, LIGHT = BY_DRIVER["i2cdev-raw"], BY_DRIVER["mpu6050-light"]
KALMAN, PLOTTER = BY_DRIVER["tkj-kalman"], BY_DRIVER["adafruit-plotter"]


@pytest.fixture
def wire():
    end = SimulatedEnd()
    yield end
    end.vanish()


@pytest.fixture
def opened():
    boards = []

    def open_it(wire, text):
        boards.append(SketchBoard.open(wire.path, sketch=text.sketch))
        return boards[-1]

    yield open_it
    for board in boards:
        board.close()


def counting(text, first=0):
    """Records that differ from one to the next."""
    for k in itertools.count(first):
        yield text.say([k % 50 + 1, *[1] * (len(text.largest) - 1)])


def started(wire, opened, text, pieces=None):
    enough = wire.keep_sending(pieces or counting(text))
    board = opened(wire, text)
    board.identify()
    board.start(200)
    return board, enough


def take_until_it_fails(board):
    with pytest.raises((BoardError, PortError)) as failure:
        for _ in range(TAKES):
            board.take(0.1)
    return str(failure.value)


def test_it_says_what_it_is_and_measures_its_one_rate(wire):
    wire.keep_sending(counting(RAW))
    board = drivers.open_board("i2cdev-raw", wire.path)
    who = board.identify()
    board.close()
    assert (who.driver, who.serial, who.chip, who.max_rate_hz) == ("i2cdev-raw", "", None, None)
    assert (who.accel_range_g, who.gyro_range_dps) == (2, 250)
    assert who.rate_hz == pytest.approx(100, rel=0.01)


def test_its_time_is_that_of_arrival(wire, opened):
    board, _ = started(wire, opened, RAW)
    before_s = CLOCK.now_s()
    block = take_n(board, 40)
    np.testing.assert_allclose(np.diff(block.time_s), 0.01, atol=READ_TIMEOUT_S)
    assert block.time_s[-1] == pytest.approx(CLOCK.now_s() - before_s, abs=READ_TIMEOUT_S)
    assert not board.faults


def test_records_that_come_in_one_read_are_spread_evenly(wire, opened):
    board, enough = started(wire, opened, RAW)
    take_n(board, 3)
    enough.set()
    board.start(200)
    wire.send(b"".join(itertools.islice(counting(RAW, 10), 8)))
    block = take_n(board, 8)
    np.testing.assert_allclose(np.diff(block.time_s[-8:]), np.diff(block.time_s[-8:])[0], rtol=1e-6)


def test_what_waited_while_nobody_read_says_nothing_of_the_rate(wire, opened):
    board = opened(wire, RAW)
    wire.send(b"".join(itertools.islice(counting(RAW), 150)))
    wire.keep_sending(counting(RAW))
    assert board.identify().rate_hz < 110


def test_a_sketch_that_waits_for_a_character_is_given_one(wire, opened):
    dmp = BY_DRIVER["dmp-ypr"]

    def once_asked():
        yield BANNERS["dmp-ypr"]
        while not wire.heard:
            yield b""
        yield from counting(dmp)

    wire.keep_sending(once_asked())
    assert opened(wire, dmp).identify().driver == "dmp-ypr"


def test_a_clone_whose_data_are_good_is_a_fault_and_no_end(wire, opened):
    said = b"Initializing I2C devices...\r\nTesting device connections...\r\nMPU6050 connection failed\r\n"
    board, _ = started(wire, opened, RAW, itertools.chain([said], counting(RAW)))
    assert len(take_n(board, 5)) >= 5
    assert board.faults == {"board_error": 1}


def test_half_lines_are_dropped_and_counted(wire, opened):
    lines = (line if k % 10 else line[: len(line) // 2] for k, line in enumerate(counting(RAW)))
    board, _ = started(wire, opened, RAW, lines)
    block = take_n(board, 40)
    assert set((block.accel_g[:, 1:] * 16384).flat) == {1.0}
    assert set(board.faults) == {"unparsed"}


@pytest.mark.parametrize(
    ("text", "piece", "words"),
    [
        (RAW, RAW.say([0] * 6), "all its values are 0: no sensor answers the board; check the wires"),
        (RAW, RAW.say([1] * 6), "its values do not change: the sensor's bus hangs"),
        (LIGHT, LIGHT.say([0] * 3), "all its values are 0: no sensor answers the board"),
        (LIGHT, LIGHT.say([7, 8, 9]), "its values do not change: the sensor's bus hangs"),
        (RAW, b"\x9c\xf1\x80\x0c\xe3", "no text: wrong baud rate.* at 38400 baud"),
        (RAW, b"quaternion 1 0 0 0\r\n", "no whole line of jrowberg/i2cdevlib"),
        (RAW, b"", "it is silent"),
    ],
)
def test_what_goes_wrong_in_the_stream_is_named_and_is_no_sample(wire, opened, text, piece, words):
    board, enough = started(wire, opened, text)
    take_n(board, 5)
    enough.set()
    wire.keep_sending(itertools.chain([b"\r\n"], itertools.repeat(piece)))
    board.start(200)
    with pytest.raises(BoardError, match=rf"on {wire.path} has sent no usable sample for .*{words}"):
        for n in itertools.count():
            block = board.take(0.1)
            assert len(block) == 0 or n < 5


@pytest.mark.parametrize(
    ("text", "sent", "words"),
    [
        (LIGHT, BY_DRIVER["tockn"].say([1, 2, 3]), "another device's; it looks like driver 'tockn'"),
        (RAW, BY_DRIVER["adafruit-basic"].say([1] * 7), "looks like driver 'adafruit-basic'"),
        (RAW, b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n", "looks like driver 'grbl'"),
        (RAW, b"\x9c\xf1\x80\x0c\xe3\x0a", "no text: wrong baud rate"),
        (RAW, b"hello\r\n", "is another sketch on the board"),
        (RAW, b"", "silent: is it powered, and on this port.*ElectronicCats' sketch stops"),
        (
            BY_DRIVER["adafruit-plotter"],
            b"Failed to find MPU6050 chip\r\n",
            "says 'Failed to find MPU6050 chip'",
        ),
    ],
)
def test_a_board_that_cannot_be_identified_is_told_why(wire, opened, text, sent, words):
    wire.keep_sending(itertools.repeat(sent))
    with pytest.raises(BoardError, match=rf"board {text.sketch.driver} on {wire.path}.*{words}"):
        opened(wire, text).identify()


def test_the_last_words_of_one_that_fell_silent_are_told(wire, opened):
    board = opened(wire, RAW)
    wire.send(b"Initializing MPU...\r\nTesting MPU6050 connection...\r\nMPU6050 connection failed\r\n")
    with pytest.raises(BoardError, match=r"silent.*'MPU6050 connection failed'"):
        board.identify()


def test_a_reset_is_counted_and_a_raw_board_goes_on(wire, opened):
    board, enough = started(wire, opened, RAW)
    take_n(board, 3)
    enough.set()
    wire.keep_sending(itertools.chain([b"a/g:\t1\t2", BANNERS["i2cdev-raw"]], counting(RAW)))
    take_n(board, 20)
    assert board.faults["board_reset"] == 1


@pytest.mark.parametrize(
    ("text", "half", "first"),
    [
        (KALMAN, b"30.11\t34.16", b""),
        (KALMAN, b"", b""),
        (PLOTTER, b"AccelX:0.", b"\r\n"),
        (PLOTTER, b"", b"\r\n"),
    ],
)
def test_a_reset_that_no_banner_tells_is_seen_by_the_boot_loaders_silence(wire, opened, text, half, first):
    board, enough = started(wire, opened, text)
    take_n(board, 3)
    enough.set()
    wire.play(itertools.chain([(0.01, half), (1.6, first)], ((0.01, line) for line in counting(text))))
    reset_s = CLOCK.now_s()
    for _ in range(TAKES):
        if len(board.take(0.1)) and board.faults["board_reset"]:
            break
    assert board.faults == {"board_reset": 1, **({"unparsed": 1} if half else {})}
    # its own filter begins with one noisy sample: what it says meanwhile is no sample
    assert CLOCK.now_s() - reset_s == pytest.approx(1.6 + text.sketch.settles_s, abs=0.15)


def test_bytes_that_waited_while_this_process_slept_are_no_reset(wire, opened):
    board, enough = started(wire, opened, KALMAN)
    take_n(board, 3)
    enough.set()
    waited = b"".join(itertools.islice(counting(KALMAN, 7), 40))
    wire.play(itertools.chain([(1.6, waited)], ((0.01, line) for line in counting(KALMAN))))
    take_n(board, 60)
    assert not board.faults


def test_a_bus_error_that_the_kalman_sketch_prints_is_a_fault_and_no_end(wire, opened):
    board, enough = started(wire, opened, KALMAN)
    take_n(board, 3)
    enough.set()
    wire.keep_sending(itertools.chain([b"i2cRead failed: 4\r\n"], counting(KALMAN, 9)))
    take_n(board, 10)
    assert board.faults == {"board_error": 1}


@pytest.mark.parametrize("driver", ["mpu6050-light", "tockn", "dmp-ypr"])
def test_a_reset_ends_the_stream_of_a_sketch_that_takes_its_zero_anew(wire, opened, driver):
    text = BY_DRIVER[driver]
    board, enough = started(wire, opened, text)
    take_n(board, 3)
    enough.set()
    wire.keep_sending(itertools.chain([BANNERS[driver]], counting(text)))
    assert "takes its zero anew at every start" in take_until_it_fails(board)
    assert board.faults["board_reset"] == 1


def test_a_pulled_cable_is_a_port_error(wire, opened):
    board, enough = started(wire, opened, RAW)
    enough.set()
    wire.vanish()
    assert "went away" in take_until_it_fails(board)


def test_it_must_be_identified_before_it_is_started(wire, opened):
    with pytest.raises(BoardError, match="must be identified"):
        opened(wire, RAW).start(200)


def test_after_stop_nothing_more_is_taken(wire, opened):
    board, _ = started(wire, opened, RAW)
    take_n(board, 3)
    board.stop()
    board.take(0.0)
    assert len(board.take(0.1)) == 0
