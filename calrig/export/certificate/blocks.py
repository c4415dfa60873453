"""What a certificate's page is made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from calrig.export.certificate.content import NOT_STATED, Row


@dataclass(frozen=True, slots=True)
class Block:
    """Something on the page.

    Attributes:
        kind: `pairs` (each row a name and what is said of it), `table`, `paragraphs`, `picture` (described by
            its one line), `figure` (a statement to be seen first), `listing` (names and values, small).
        columns: heads of a table.
        numbers: which columns of a table are figures.
        lines: of paragraphs.
    """

    kind: Literal["pairs", "table", "paragraphs", "picture", "figure", "listing"]
    rows: tuple[tuple[str, ...], ...] = ()
    columns: tuple[str, ...] = ()
    numbers: tuple[bool, ...] = ()
    lines: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands below it."""

    title: str
    blocks: tuple[Block, ...]


def pairs(rows: Iterable[Row]) -> Block:
    """Names and what is said of them."""
    return Block("pairs", rows=tuple(rows))


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[bool] = ()) -> Block:
    """A table; `numbers` tells which columns are figures, none without it."""
    chosen = tuple(numbers) or (False,) * len(columns)
    return Block("table", tuple(map(tuple, rows)), tuple(columns), chosen)


def paragraphs(lines: Iterable[str]) -> Block:
    """Sentences, a paragraph each."""
    return Block("paragraphs", lines=tuple(lines))


def figure(line: str) -> Block:
    """The statement that the page is for."""
    return Block("figure", lines=(line,))


def picture(seen: str) -> Block:
    """The picture of the residuals, with what it shows in words."""
    return Block("picture", lines=(seen,))


def stated(value: str | None) -> str:
    """What is said, or that nothing is."""
    return value or NOT_STATED
