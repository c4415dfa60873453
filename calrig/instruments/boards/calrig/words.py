"""What a `calrig` board says of itself, and in words why it sends nothing that can be used."""

import json
from collections import Counter
from typing import Any

from calrig.instruments.boards.calrig.packets import IDENTITY, LONGEST_FRAME
from calrig.instruments.types import BoardIdentity

NO_SENSOR = "all registers read 0: no sensor answers the board; check the wires between them"
USELESS = {
    "frozen": "the sensor's registers do not change: its bus hangs; switch the board off and on",
    "clock_jump": "the board's clock does not advance at the rate asked for: ask for one it can hold",
    "repeated": "it sends the same samples again and again: reset the board",
}


LONGEST_FIELD = 100
"""Characters; a unit's serial number has no more either."""
FASTEST_HZ = 100_000
LONGEST_WORDS = 200
SHOWN = 60


def identity_document(text: str) -> dict[str, Any]:
    """The JSON object of an identity packet (ValueError where it is none, with what it is instead)."""
    try:
        said = json.loads(text)
    except RecursionError as error:
        raise ValueError(f"nested too deeply: {_shown(text)}") from error
    except ValueError as error:
        raise ValueError(f"no JSON: {_shown(text)}") from error
    if not isinstance(said, dict):
        raise ValueError(f"no JSON object: {_shown(text)}")
    return said


def read_identity(text: str) -> BoardIdentity:
    """The identity of a board from its packet's JSON (CONTRACT 3.1).

    Raises:
        ValueError: it cannot be used; says which field is what.
    """
    said = identity_document(text)
    for key, known in (("accel_range_g", (2, 4, 8, 16)), ("gyro_range_dps", (250, 500, 1000, 2000))):
        if said.get(key) not in known:
            raise ValueError(f"{key} is {_shown(said.get(key))}, not one of {', '.join(map(str, known))}")
    rate_hz = said.get("max_rate_hz")
    if rate_hz is not None and not (type(rate_hz) is int and 1 <= rate_hz <= FASTEST_HZ):
        raise ValueError(f"max_rate_hz is {_shown(rate_hz)}, not a whole number from 1 to {FASTEST_HZ}")
    return BoardIdentity(
        driver="calrig",
        firmware=_text(said, "firmware"),
        serial=_text(said, "serial") or "",
        chip=_text(said, "chip"),
        accel_range_g=int(said["accel_range_g"]),
        gyro_range_dps=int(said["gyro_range_dps"]),
        max_rate_hz=rate_hz,
    )


def _text(said: dict[str, Any], key: str) -> str | None:
    value = said.get(key)
    if value is None:
        return None
    if type(value) is int:
        value = str(value)
    if not isinstance(value, str) or not value.isprintable():
        raise ValueError(f"{key} is {_shown(value)}, not printable text")
    if len(value) > LONGEST_FIELD:
        raise ValueError(f"{key} has {len(value)} characters, more than {LONGEST_FIELD}: {_shown(value)}")
    return value


def _shown(value: object) -> str:
    """What a board sent, for a sentence: printable, not too much of it, and never nested."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    whole = repr(value[:SHOWN] if isinstance(value, str) else value)
    return whole if len(whole) <= 2 * SHOWN else f"{whole[:SHOWN]}…"


def text_of(payload: bytes) -> str:
    """What a board says in words, on one line of what can be printed."""
    text = payload.decode("utf-8", "replace")[:LONGEST_WORDS]
    return "".join(character if character.isprintable() else " " for character in text).strip()


def why_none(last_words: str, n_bytes: int, overlong: bytes = b"") -> str:
    """Why there is no identity."""
    if last_words:
        return f"it says {_shown(last_words)}"
    if overlong[1:2] == bytes([IDENTITY]):  # behind COBS's own first byte; noise has it once in 256
        begins = _shown(overlong[2:].decode("utf-8", "replace"))
        return (
            f"its identity is longer than {LONGEST_FRAME} bytes and begins {begins}: is it calrig's sketch?"
        )
    if n_bytes:
        return f"{n_bytes} bytes came but no identity: wrong baud rate, or another sketch on it?"
    return "it is silent: check its power, port and baud rate, and that it carries calrig's sketch"


def why_useless(faults: Counter[str], *, went_on: bool, reads_zero: bool) -> str:
    """Why none of its samples was valid for so long.

    `faults` are counts by kind since the last valid one; `went_on` is whether whole samples came, each
    refused.
    """
    if went_on:
        return NO_SENSOR if reads_zero else USELESS[max(USELESS, key=lambda kind: faults[kind])]
    if faults["crc"] or faults["unparsed"]:
        return "bytes come, but no packet is whole: check baud rate, cable and ground"
    return "it is silent: check its power and cable"
