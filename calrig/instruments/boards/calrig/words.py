"""Why a `calrig` board sends nothing that can be used, in words."""

from __future__ import annotations

from collections import Counter

NO_SENSOR = "all registers read 0: no sensor answers the board; check the wires between them"
USELESS = {
    "frozen": "the sensor's registers do not change: its bus hangs; switch the board off and on",
    "clock_jump": "the board's clock does not advance at the rate asked for: ask for one it can hold",
    "repeated": "it sends the same samples again and again: reset the board",
}


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
