from __future__ import annotations

import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from instrument_fakes import cobs_decode, cobs_encode, crc16_bit_by_bit, packet, sample

from calrig.instruments.boards.calrig.packets import PacketDecoder

EXAMPLE = bytes.fromhex("0302010388130101010101010240 02fe 010101010103 39c2 00".replace(" ", ""))

LENGTHS = {1: None, 2: 21, 3: None, 4: None, 5: 23}
texts = st.binary(max_size=300)
packets = st.one_of(
    st.tuples(st.sampled_from([1, 3, 4]), texts),
    st.tuples(st.just(2), st.binary(min_size=20, max_size=20)),
    st.tuples(st.just(5), st.binary(min_size=22, max_size=22)),
)


def whole_packets(stream: bytes) -> list[bytes]:
    """Oracle: what the contract's words say of the frames of a stream, byte by byte and bit by bit."""
    bodies = []
    for frame in stream.split(b"\0")[:-1]:
        body = cobs_decode(frame)
        if body is None or len(body) < 3:
            continue
        if crc16_bit_by_bit(body[:-2]) != struct.unpack("<H", body[-2:])[0]:
            continue
        if body[0] in LENGTHS and LENGTHS[body[0]] in (None, len(body) - 2):
            bodies.append(body[:-2])
    return bodies


def fed_in_pieces(stream: bytes, cuts: list[int]) -> tuple[list[bytes], Counter]:
    decoder = PacketDecoder()
    edges = sorted(cut % (len(stream) + 1) for cut in cuts)
    pieces = [stream[a:b] for a, b in zip([0, *edges], [*edges, len(stream)], strict=True)]
    return [body for piece in pieces for body in decoder.feed(piece)], decoder.faults


def test_the_contracts_example_is_read_and_spelt_alike():
    (body,) = PacketDecoder().feed(EXAMPLE)
    assert struct.unpack("<BHI7h", body) == (2, 1, 5000, 0, 0, 16384, -512, 0, 0, 0)
    assert sample(1, 5000) == EXAMPLE


def test_the_crc_is_ccitt_false():
    check = b"123456789"
    assert crc16_bit_by_bit(check) == 0x29B1
    body = b"\x03" + check
    good = cobs_encode(body + struct.pack("<H", crc16_bit_by_bit(body))) + b"\0"
    assert PacketDecoder().feed(good) == [body]


@given(st.lists(packets, max_size=8), st.lists(st.integers(0, 10_000), max_size=8))
def test_packets_come_whole_however_the_bytes_are_cut(sent, cuts):
    stream = b"".join(packet(kind, payload) for kind, payload in sent)
    received, faults = fed_in_pieces(stream, cuts)
    assert received == [bytes([kind]) + payload for kind, payload in sent]
    assert not faults


@st.composite
def damaged_streams(draw):
    """Packets of which bytes were changed, lost, invented, doubled, or replaced by noise."""
    stream = bytearray(b"".join(packet(*each) for each in draw(st.lists(packets, min_size=1, max_size=6))))
    for _ in range(draw(st.integers(1, 5))):
        at, length = draw(st.integers(0, len(stream))), draw(st.integers(0, 30))
        piece = stream[at : at + length]
        stream[at : at + length] = draw(
            st.sampled_from([b"", piece * 2, piece[::-1], b"\0"]) | st.binary(max_size=30)
        )
    return bytes(stream)


@given(damaged_streams(), st.lists(st.integers(0, 10_000), max_size=8))
def test_no_damage_that_the_protocol_can_show_passes_and_nothing_whole_is_lost(stream, cuts):
    received, faults = fed_in_pieces(stream, cuts)
    assert received == whole_packets(stream)
    frames = [frame for frame in stream.split(b"\0")[:-1] if frame]
    assert faults.total() == len(frames) - len(received)


@given(st.integers(0, 23), st.integers(1, 255), st.integers(0, 65535), st.integers(0, 2**32 - 1))
def test_any_one_changed_byte_loses_at_most_its_own_frame_and_the_next(at, change, seq, t_us):
    """A changed byte may be a delimiter, so that its frame joins the next; the one after that is safe."""
    spoilt = bytearray(sample(seq, t_us))
    spoilt[at] ^= change
    after = [sample(seq + k, t_us) for k in (1, 2)]
    received = PacketDecoder().feed(bytes(spoilt) + b"".join(after))
    assert received[-2:] == [cobs_decode(frame[:-1])[:-2] for frame in after]
    assert received == whole_packets(bytes(spoilt) + b"".join(after))


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (b"\x05\x01\0", "unparsed"),
        (b"\x02\x01\0", "unparsed"),
        (cobs_encode(b"\x03abc\x00\x00") + b"\0", "crc"),
        (packet(2, bytes(19)), "unparsed"),
        (packet(2, bytes(22)), "unparsed"),
        (packet(5, bytes(20)), "unparsed"),
        (packet(9, bytes(20)), "unparsed"),
        (b"\x01" * 2000 + b"\0", "crc"),
        (b"\x01" * 3000 + b"\0", "unparsed"),
    ],
)
def test_what_is_wrong_with_a_frame_is_counted_by_kind(frame, kind):
    decoder = PacketDecoder()
    assert decoder.feed(frame + EXAMPLE) == [cobs_decode(EXAMPLE[:-1])[:-2]]
    assert decoder.faults == {kind: 1}


def test_noise_without_an_end_does_not_pile_up():
    decoder = PacketDecoder()
    for _ in range(100):
        decoder.feed(b"\x55" * 1000)
    assert decoder.feed(b"\0" + EXAMPLE) == [cobs_decode(EXAMPLE[:-1])[:-2]]
    assert decoder.faults["unparsed"] > 10


def test_delimiters_in_a_row_are_no_fault():
    decoder = PacketDecoder()
    assert len(decoder.feed(b"\0\0" + EXAMPLE + b"\0" + EXAMPLE)) == 2
    assert not decoder.faults


@given(st.integers(2049, 8000), st.lists(st.integers(0, 10_000), max_size=8))
def test_a_frame_that_is_too_long_is_never_a_packet_however_it_is_cut(n, cuts):
    long = packet(3, b"x" * n)
    decoder = PacketDecoder()
    edges = sorted(cut % (len(long) + 1) for cut in cuts)
    for a, b in zip([0, *edges], [*edges, len(long)], strict=True):
        assert decoder.feed(long[a:b]) == []
    assert decoder.overlong == long[:64]
    assert decoder.faults["unparsed"] == decoder.faults.total() >= 1
    assert decoder.feed(EXAMPLE) == [cobs_decode(EXAMPLE[:-1])[:-2]]
