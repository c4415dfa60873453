"""Bytes of a `calrig` board to whole packets (CONTRACT 3.1): COBS ended by 0x00, CRC-16/CCITT-FALSE."""

from binascii import crc_hqx
from collections import Counter

from cobs import cobs  # type: ignore[import-untyped]

BAUDRATE = 115200
IDENTITY, SAMPLE, ERROR, ACKNOWLEDGE, FILTERED_SAMPLE = 1, 2, 3, 4, 5
SAMPLES = (SAMPLE, FILTERED_SAMPLE)
ANY_LENGTH = 0
LENGTHS = {
    IDENTITY: ANY_LENGTH,
    SAMPLE: 21,
    ERROR: ANY_LENGTH,
    ACKNOWLEDGE: ANY_LENGTH,
    FILTERED_SAMPLE: 23,
}
LONGEST_FRAME = 2048
BEGINNING = 64


class PacketDecoder:
    """Takes bytes as they come, cut anywhere, and gives the packets whose frame, CRC and length are right.

    What is not right is counted in `faults` and dropped: `crc`, and `unparsed` for a frame that is no COBS,
    too short, too long, of unknown type or of the wrong length. `overlong` is how the last one began that
    was too long.
    """

    def __init__(self, faults: Counter[str] | None = None) -> None:
        self.faults: Counter[str] = Counter() if faults is None else faults
        self.overlong = b""
        self._tail = b""
        self._is_overlong = False  # what comes is the rest of a frame that was dropped

    def feed(self, data: bytes) -> list[bytes]:
        """The packets completed by `data`, each as its type byte and payload, without the CRC."""
        *frames, self._tail = (self._tail + data).split(b"\0")
        if frames and self._is_overlong:
            frames[0], self._is_overlong = b"", False
        packets = []
        for frame in frames:
            if not frame:
                continue  # two delimiters in a row: how a sender ends a line of noise
            if len(frame) > LONGEST_FRAME:
                self._drop_overlong(frame)
                continue
            try:
                packet = cobs.decode(frame)
            except cobs.DecodeError:
                self.faults["unparsed"] += 1
                continue
            body = packet[:-2]
            if not body:
                self.faults["unparsed"] += 1
            elif crc_hqx(body, 0xFFFF) != packet[-1] << 8 | packet[-2]:
                self.faults["crc"] += 1
            elif LENGTHS.get(body[0], -1) not in (ANY_LENGTH, len(body)):
                self.faults["unparsed"] += 1
            else:
                packets.append(body)
        if len(self._tail) > LONGEST_FRAME:
            self._drop_overlong(self._tail)
            self._tail, self._is_overlong = b"", True
        return packets

    def _drop_overlong(self, frame: bytes) -> None:
        self.faults["unparsed"] += 1
        if not self._is_overlong:
            self.overlong = frame[:BEGINNING]
