"""How commands print: lines, tables, numbers with units and standard errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from textwrap import fill
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from calrig.errors import printable

FRAME = "│  "
"""Of a column."""


def print_line(text: str, style: str = "") -> None:
    """Prints text as it is: no markup, no escape sequences."""
    Console(soft_wrap=True, highlight=False).print(Text(printable(text), style))


def print_sentence(text: str) -> None:
    """The same for what is read as prose: a terminal's lines break between words, a pipe's not at all."""
    console, text = Console(soft_wrap=True, highlight=False), printable(text)
    if console.is_terminal:
        indent = " " * (len(text) - len(text.lstrip("· ")))
        text = fill(
            text,
            console.width,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
    console.print(Text(text))


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str | None = None,
    caption: str | None = None,
    justify: Any = "right",
) -> None:
    """Prints a table: names to the left in the first column, the others as told.

    Cells wrap between words and are never cut: what is too wide for the terminal is a list instead.
    """
    console = Console(soft_wrap=True, highlight=False)
    cells = [[printable(cell) for cell in row] for row in rows]
    widths = _widths(headings, cells, console.width)
    if widths is None:
        for line in _as_list(headings, cells, title, caption):
            print_line(line)
        return
    table = Table(
        title=None if title is None else Text(printable(title)),
        title_justify="left",
        caption=None if caption is None else Text(caption),
        caption_justify="left",
    )
    for place, (heading, width) in enumerate(zip(headings, widths, strict=True)):
        table.add_column(heading, justify=justify if place else "left", width=width)
    for row in cells:
        table.add_row(*map(Text, row))
    console.print(table)


def _widths(headings: Sequence[str], rows: Sequence[Sequence[str]], most: int) -> list[int] | None:
    """The width of each column of a table that is `most` wide at most; None where a word would be cut."""
    columns = [[str(cell) for cell in column] for column in zip_longest(headings, *rows, fillvalue="")]
    whole = [max(map(cell_len, cells)) for cells in columns]
    least = [max(cell_len(word) for cell in cells for word in cell.split() or [""]) for cells in columns]
    least[0] = max(least[0], *map(cell_len, columns[0][1:]), 0)  # names do not wrap
    spare = most - 1 - sum(least) - len(FRAME) * len(least)
    if spare < 0:
        return None
    for place, (narrow, wide) in enumerate(zip(least, whole, strict=True)):
        given = min(spare, wide - narrow)
        least[place], spare = narrow + given, spare - given
    return least


def _as_list(
    headings: Sequence[str], rows: Sequence[Sequence[str]], title: str | None, caption: str | None
) -> Iterator[str]:
    """The same, a line each; what is empty is left out."""
    if title is not None:
        yield title
    for row in rows:
        yield " ".join(part for part in (headings[0], row[0]) if part)
        for heading, cell in zip(headings[1:], row[1:], strict=False):
            if cell:
                yield f"  {heading}: {cell}"
    if caption is not None:
        yield caption


def print_parameter(title: str, parameter: dict[str, float | None] | None, unit: str = "") -> None:
    """Prints a parameter with its standard error; one that does not apply is left out."""
    if parameter is not None:
        std = "" if parameter["std"] is None else f" ± {parameter['std']:.2g}"
        print_line(f"  {title} = {parameter['value']:.4g}{std}{unit and f' {unit}'}")


def print_warnings(warnings: Iterable[str]) -> None:
    """Prints what a person should know, a line each."""
    for warning in warnings:
        print_sentence(f"warning: {warning}")


def number(value: float | None, unit: str, decimals: int = 4) -> str:
    """A number with its unit, or that it is not known."""
    return "not known" if value is None else f"{value:.{decimals}f}{unit}"
