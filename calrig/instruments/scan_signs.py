"""What bytes give away of who sent them: identities, banners, replies and lines of every built-in driver."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Literal

from calrig.instruments.boards.calrig.packets import IDENTITY, PacketDecoder
from calrig.instruments.boards.sketches.catalogue import SKETCHES, Sketch
from calrig.instruments.stages.grbl.words import BANNER, parse_report

LINE_ENDS = re.compile(rb"[\r\n]+")
NOT_OF_LINES = b"\x00\x11\x13"
"""A NUL byte says that motor power was cut; XON and XOFF belong to the wire."""

GRBL_VERSION = re.compile(r"\[VER:([^:\]]+).*\]")
SMC100_LIMIT = re.compile(r"1SL\s*[-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?")
SMC100_VERSION = re.compile(r"1VE\s*(\S.*)")
ESP301_VERSION = re.compile(r"ESP30\d\b.*")
ZABER_REPLY = re.compile(r"@(\d{2}) 0 OK (?:IDLE|BUSY) (?:--|[A-Z]{2}) (\d+(?:\.\d+)*)(?::[0-9A-F]{2})?")


@dataclass(frozen=True, slots=True)
class Sign:
    """Who it is: `identity` in words, `axis` the address it answered with, None where it has none."""

    kind: Literal["stage", "board"]
    driver: str
    identity: str
    axis: int | None = None


def recognise(heard: bytes) -> Sign | None:
    """Who sent this, or None where nothing in it is any built-in driver's to the letter."""
    lines = lines_of(heard)
    return _calrig(heard) or _stage(lines) or _sketch(lines)


def lines_of(heard: bytes) -> list[str]:
    """The lines in it that have come to their end, but for empty ones."""
    *whole, _ = LINE_ENDS.split(heard.translate(None, NOT_OF_LINES))
    return [line.decode("latin-1") for line in whole if line]


def _calrig(heard: bytes) -> Sign | None:
    for packet in PacketDecoder().feed(heard):
        if packet[0] != IDENTITY:
            continue
        try:
            said = json.loads(packet[1:])
        except ValueError:
            continue  # its CRC holds, but it is no identity of the contract's
        if isinstance(said, dict):
            unit = f"unit {said['serial']}" if said.get("serial") else "no serial number"
            parts = [unit, said.get("firmware"), said.get("chip")]
            return Sign("board", "calrig", ", ".join(str(part) for part in parts if part))
    return None


def _stage(lines: list[str]) -> Sign | None:
    return _smc100(lines) or _zaber(lines) or _esp301(lines) or _grbl(lines)


def _smc100(lines: list[str]) -> Sign | None:
    versions = [reply[1].strip() for line in lines if (reply := SMC100_VERSION.fullmatch(line))]
    if not versions and not any(SMC100_LIMIT.fullmatch(line) for line in lines):
        return None
    return Sign("stage", "smc100", versions[0] if versions else "at address 1", 1)


def _zaber(lines: list[str]) -> Sign | None:
    replies = [reply for line in lines if (reply := ZABER_REPLY.fullmatch(line))]
    if not replies:
        return None
    first = int(replies[0][1])
    versions = [reply[2] for reply in replies if int(reply[1]) == first and "." in reply[2]]
    others = sorted({int(reply[1]) for reply in replies} - {first})
    words = [f"firmware {versions[0]}"] if versions else []
    if others:
        words.append(f"and behind it addresses {', '.join(map(str, others))}")
    return Sign("stage", "zaber", ", ".join([f"at address {first}", *words]), first)


def _esp301(lines: list[str]) -> Sign | None:
    name = next((line.strip() for line in lines if ESP301_VERSION.fullmatch(line)), None)
    return None if name is None else Sign("stage", "esp301", name)


def _grbl(lines: list[str]) -> Sign | None:
    name, state = "", ""
    for line in lines:
        if banner := BANNER.fullmatch(line):
            name = name or banner[1]
        elif version := GRBL_VERSION.fullmatch(line):
            name = f"Grbl {version[1]}"
        elif report := parse_report(line):
            state = report.state
    if not name and not state:
        return None
    return Sign("stage", "grbl", f"{name or 'Grbl'}{f', in {state}' if state else ''}")


def _sketch(lines: list[str]) -> Sign | None:
    for line in lines:
        senders = [sketch for sketch in SKETCHES if _prints(sketch, line)]
        if len(senders) == 1:  # several sketches share some of what they say at their start
            return Sign("board", senders[0].driver, senders[0].source)
    return None


def _prints(sketch: Sketch, line: str) -> bool:
    if any(form.fullmatch(line) for form in sketch.lines):
        return True
    has_words = any(character.isalpha() for character in line)  # anybody may draw a line of `=`
    return has_words and sketch.banner is not None and sketch.banner.search(line) is not None
