"""How a file separates cells and writes decimals: by commas and points, or as spreadsheets elsewhere do."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

SEPARATORS = (",", ";", "\t")
EXAMINED_BYTES = 1_000_000
"""Of the rows, by which the decimals are told: what differs further on is told as a bad cell."""
_QUOTED = re.compile(r'"[^"]*"')


@dataclass(frozen=True, slots=True)
class Dialect:
    """The sign between cells, and that in a decimal number."""

    separator: str = ","
    decimal: str = "."


COMMAS = Dialect()


def dialect_of(header: str, rows: bytes, is_known: Callable[[str], bool]) -> Dialect:
    """The dialect that the header row and the rows under it are in.

    The separator is the one that makes the most known names of the header, a comma where several do. Where
    cells are not separated by commas, these are decimal points if whole cells are numbers so, and none are
    numbers with a point: a file that has both is not guessed at.

    Args:
        header: the line of names.
        rows: what follows it.
        is_known: whether a column has a meaning here.
    """
    separator = max(SEPARATORS, key=lambda sign: _known(header, sign, is_known))
    if separator == ",":
        return COMMAS
    examined = rows[:EXAMINED_BYTES]
    comma = _has_decimals(examined, separator, ",") and not _has_decimals(examined, separator, ".")
    return Dialect(separator, "," if comma else ".")


def _known(header: str, separator: str, is_known: Callable[[str], bool]) -> tuple[int, int]:
    """How many names a separator makes that are known, and how many at all."""
    names = [name.strip().strip('"') for name in _unquoted(header, separator).split(separator)]
    return sum(map(is_known, names)), 0 if any(map(is_known, names)) else len(names)


def _unquoted(header: str, separator: str) -> str:
    """The header with what is quoted free of the separator."""
    return _QUOTED.sub(lambda quoted: quoted[0].replace(separator, " "), header)


def _has_decimals(rows: bytes, separator: str, decimal: str) -> bool:
    between = rb'[\r\n"' + separator.encode() + rb"]"
    number = rb"[ ]*[+-]?[0-9]*" + re.escape(decimal.encode()) + rb"[0-9]+(?:[eE][+-]?[0-9]+)?[ ]*"
    return re.search(rb"(?:\A|" + between + rb")" + number + rb"(?:\Z|" + between + rb")", rows) is not None
