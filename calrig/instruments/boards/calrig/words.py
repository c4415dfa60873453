"""What a `calrig` board says of itself, and in words why it sends nothing that can be used."""

from __future__ import annotations

import json
from collections import Counter

from calrig.instruments.types import BoardIdentity

NO_SENSOR = "all registers read 0: no sensor answers the board; check the wires between them"
USELESS = {
    "frozen": "the sensor's registers do not change: its bus hangs; switch the board off and on",
    "clock_jump": "the board's clock does not advance at the rate asked for: ask for one it can hold",
    "repeated": "it sends the same samples again and again: reset the board",
}


def read_identity(text: str) -> BoardIdentity:
    """The identity of a board from its packet's JSON (CONTRACT 3.1; ValueError where it cannot be used)."""
    said = json.loads(text)
    if not isinstance(said, dict):
        raise ValueError("not a JSON object")
    for key, known in (("accel_range_g", (2, 4, 8, 16)), ("gyro_range_dps", (250, 500, 1000, 2000))):
        if said.get(key) not in known:
            raise ValueError(f"{key} is {said.get(key)!r}, not one of {', '.join(map(str, known))}")
    rate_hz = said.get("max_rate_hz")
    if rate_hz is not None and not (isinstance(rate_hz, int) and rate_hz > 0):
        raise ValueError(f"max_rate_hz is {rate_hz!r}, not a whole number")
    return BoardIdentity(
        driver="calrig",
        firmware=_text(said.get("firmware")),
        serial=_text(said.get("serial")) or "",
        chip=_text(said.get("chip")),
        accel_range_g=int(said["accel_range_g"]),
        gyro_range_dps=int(said["gyro_range_dps"]),
        max_rate_hz=rate_hz,
    )


def _text(value: object) -> str | None:
    return None if value is None else str(value)


def why_none(last_words: str, n_bytes: int) -> str:
    """Why there is no identity, from what the board said in words and how many bytes came from it."""
    if last_words:
        return f"it says {last_words!r}"
    if n_bytes:
        return f"{n_bytes} bytes came but no identity: wrong baud rate, or another sketch on it?"
    return "it is silent: is it powered, on this port, and does it carry calrig's sketch?"


def why_useless(faults: Counter[str], *, went_on: bool, reads_zero: bool) -> str:
    """Why none of its samples was valid for so long.

    Args:
        faults: counts by kind since the last valid one.
        went_on: whether whole samples came all the while, each refused.
        reads_zero: whether the last one's registers were all 0.
    """
    if went_on:
        return NO_SENSOR if reads_zero else USELESS[max(USELESS, key=lambda kind: faults[kind])]
    if faults["crc"] or faults["unparsed"]:
        return "bytes come, but no packet is whole: check baud rate, cable and ground"
    return "it is silent: check its power and cable"
