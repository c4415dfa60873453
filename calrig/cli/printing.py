"""How commands print: lines, tables, numbers with units and standard errors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from calrig.errors import printable


def print_line(text: str, style: str = "") -> None:
    """Prints text as it is: no markup, no escape sequences."""
    Console(soft_wrap=True, highlight=False).print(Text(printable(text), style))


def print_table(
    headings: Iterable[str],
    rows: Iterable[Iterable[str]],
    *,
    title: str | None = None,
    caption: str | None = None,
    justify: Any = "right",
) -> None:
    """Prints a table: names to the left in the first column, the others as told."""
    table = Table(
        title=None if title is None else Text(printable(title)),
        title_justify="left",
        caption=None if caption is None else Text(caption),
        caption_justify="left",
    )
    for place, heading in enumerate(headings):
        table.add_column(heading, justify=justify if place else "left", no_wrap=not place)
    for row in rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    Console(soft_wrap=True, highlight=False).print(table)


def print_parameter(title: str, parameter: dict[str, float | None] | None, unit: str = "") -> None:
    """Prints a parameter with its standard error; one that does not apply is left out."""
    if parameter is not None:
        std = "" if parameter["std"] is None else f" ± {parameter['std']:.2g}"
        print_line(f"  {title} = {parameter['value']:.4g}{std}{unit and f' {unit}'}")


def print_warnings(warnings: Iterable[str]) -> None:
    """Prints what a person should know, a line each."""
    for warning in warnings:
        print_line(f"warning: {warning}")


def number(value: float | None, unit: str, decimals: int = 4) -> str:
    """A number with its unit, or that it is not known."""
    return "not known" if value is None else f"{value:.{decimals}f}{unit}"
