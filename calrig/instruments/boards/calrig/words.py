"""Why a `calrig` board sends nothing that can be used, in words."""

from __future__ import annotations

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
