"""Boards that say anything at all: it is told in words what they said, and no reader dies of it unseen."""

from __future__ import annotations

import itertools
import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from instrument_fakes import IDENTITY, SimulatedEnd, packet
from sketch_texts import TEXTS

from calrig.instruments.boards.calrig import words
from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.boards.sketch_board import SketchBoard
from calrig.instruments.device import recognise
from calrig.instruments.drivers import known_devices
from calrig.instruments.errors import BoardError

LONGEST_MESSAGE = 600

RANGES = '"accel_range_g":2,"gyro_range_dps":250'
HOSTILE = {
    "a lone surrogate": (json.dumps({**IDENTITY, "serial": "A\udc80"}), r"serial is 'A\\udc80'.*printable"),
    "a line end": (json.dumps({**IDENTITY, "firmware": "1\n2"}), r"firmware is '1\\n2'.*printable"),
    "a wide serial": (json.dumps({**IDENTITY, "serial": "A" * 101}), r"serial has 101 characters.*'AAA"),
    "a document": (json.dumps({**IDENTITY, "chip": {"a": [1]}}), "chip is an object.*text"),
    "a large rate": (f'{{{RANGES},"max_rate_hz":1{"0" * 1500}}}', r"max_rate_hz is 10000.*to 100000\)"),
    "an infinite rate": (f'{{{RANGES},"max_rate_hz":1e4000}}', "max_rate_hz is inf"),
    "a rate of true": (json.dumps({**IDENTITY, "max_rate_hz": True}), "max_rate_hz is True"),
    "too many digits": (f'{{"max_rate_hz":{"9" * 1990}}}', "accel_range_g is None"),
    "deep": ("[" * 1990, r"nested too deeply.*\[\[\["),
    "no JSON": ("hello", "JSON.*'hello'"),
    "not UTF-8": (b"\xff\xfe{}", r"JSON"),
}


def says(device, text: str | bytes) -> None:
    payload = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    device.say_identity = lambda: device.wire.send(packet(1, payload))


@pytest.mark.parametrize(("text", "told"), HOSTILE.values(), ids=HOSTILE)
def test_an_identity_that_cannot_be_used_is_told_with_what_was_said(device, board, text, told):
    says(device, text)
    with pytest.raises(BoardError, match=rf"sent an identity that cannot be used.*{told}") as refused:
        board.identify()
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < LONGEST_MESSAGE


@pytest.mark.parametrize("text", ["[" * 60_000, json.dumps({"notes": "f" * 60_000, **IDENTITY})])
def test_sixty_kilobytes_of_identity_are_told_and_not_taken_for_a_wrong_baud_rate(device, board, text):
    says(device, text)
    begins = re.escape(repr(text[:10])[:-1])
    with pytest.raises(BoardError, match=rf"2048 bytes.*begins {begins}") as refused:
        board.identify()
    assert "baud" not in str(refused.value)
    assert len(str(refused.value)) < LONGEST_MESSAGE


def test_what_a_board_says_of_trouble_moves_no_cursor_and_fills_no_screen(device, board):
    board.identify()
    device.refusal = "\x1b[2J\x07" + "no " * 600
    with pytest.raises(BoardError, match=r"refused START 200: .*no no no") as refused:
        board.start(200)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < LONGEST_MESSAGE


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters(exclude_categories=())),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)
identities = st.builds(
    lambda changed: {**IDENTITY, **changed}, st.dictionaries(st.sampled_from(sorted(IDENTITY)), json_values)
)


@given(identities)
def test_what_is_taken_of_an_identity_can_be_stored_shown_and_measured_with(said):
    try:
        taken = words.read_identity(json.dumps(said))
    except ValueError as refused:
        assert str(refused).isprintable()
        assert len(str(refused)) < LONGEST_MESSAGE
        return
    assert taken.max_rate_hz is None or 1 <= taken.max_rate_hz <= words.FASTEST_HZ
    for text in (taken.firmware, taken.serial, taken.chip):
        assert text is None or (text.isprintable() and len(text) <= words.LONGEST_FIELD)


@pytest.mark.parametrize(("text", "_told"), HOSTILE.values(), ids=HOSTILE)
def test_a_scan_shows_such_a_board_in_one_short_line(text, _told):
    payload = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    found = recognise(packet(1, payload), known_devices())
    assert found is None or (
        found.identity.words.isprintable() and len(found.identity.words) < LONGEST_MESSAGE
    )


def a_defect(*_: object) -> None:
    raise ZeroDivisionError


def test_a_reader_that_fails_inside_says_so_at_once(device, board, monkeypatch):
    monkeypatch.setattr("calrig.instruments.boards.calrig.driver.read_identity", a_defect)
    with pytest.raises(BoardError, match=r"board calrig on .*ZeroDivisionError.*log"):
        board.identify()


@given(
    st.lists(
        st.binary(max_size=300) | st.builds(packet, st.integers(0, 7), st.binary(max_size=300)), max_size=8
    )
)
def test_no_bytes_kill_the_reader_of_a_board_unseen(pieces):
    end = SimulatedEnd()
    board = CalrigBoard.open(end.path)
    for piece in pieces:
        end.send(piece)
    end.send(b"\0" + packet(1, json.dumps(IDENTITY).encode()))
    try:
        board.identify()
    except BoardError as error:
        assert "identity that cannot be used" in str(error)
    board.close()
    end.vanish()


@pytest.mark.parametrize("text", TEXTS, ids=lambda text: text.sketch.driver)
def test_a_sketch_that_rambles_is_told_in_a_short_line(text):
    end = SimulatedEnd()
    board = SketchBoard.open(end.path, sketch=text.sketch)
    ramble = b"MPU6050 connection failed " + b"\x1b[2J" * 20_000 + b"\r\n"
    enough = end.keep_sending(itertools.repeat(ramble), every_s=0.5)
    with pytest.raises(BoardError) as refused:
        board.identify()
    enough.set()
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < LONGEST_MESSAGE
    board.close()
    end.vanish()


def test_a_sketchs_reader_that_fails_inside_says_so_at_once(monkeypatch):
    monkeypatch.setattr("calrig.instruments.boards.sketch_board.SketchReader.feed", a_defect)
    end = SimulatedEnd()
    board = SketchBoard.open(end.path, sketch=TEXTS[0].sketch)
    end.send(b"a/g:")
    with pytest.raises(BoardError, match=r"board i2cdev-raw on .*ZeroDivisionError"):
        board.identify()
    board.close()
    end.vanish()
