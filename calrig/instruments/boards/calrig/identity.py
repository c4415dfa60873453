"""Who a `calrig` board says it is: the JSON of its identity packet (CONTRACT 3.1)."""

from __future__ import annotations

import json

from calrig.instruments.types import BoardIdentity


def read_identity(text: str) -> BoardIdentity:
    """The identity that a board sent (ValueError where it cannot be used)."""
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
