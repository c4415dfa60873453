"""What the command line shows of noise and filters, and how far a long analysis is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from calrig.errors import printable
from calrig.noise.units import bias_instability, level, white_density

PATIENCE_S = 2.0
"""What takes no longer needs no bar."""


@contextmanager
def late_bar(what: str, patience_s: float = PATIENCE_S) -> Iterator[Callable[[float], None]]:
    """Gives what is to be told the share done, 0 to 1; on a terminal a bar shows it once that takes long."""
    console = Console(stderr=True)
    begun_s = time.monotonic()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    progress = Progress(*columns, TimeRemainingColumn(), console=console, transient=True)
    bar = progress.add_task(printable(what), total=1.0)

    def show(share: float) -> None:
        progress.update(bar, completed=share)
        if console.is_terminal and not progress.live.is_started and time.monotonic() - begun_s > patience_s:
            progress.start()

    try:
        yield show
    finally:
        if progress.live.is_started:
            progress.stop()


def print_noise(found: dict[str, Any]) -> None:
    """Prints CONTRACT section 7's noise document: the paper's Table 2 for this unit, then the summary."""
    rows = (
        (
            name,
            _number(channel["adf_slope"], "+z.2f"),
            _number(channel["psd_slope"], "+z.2f"),
            _level(name, channel["std"], level),
            _level(name, _value(channel["coefficients"]["white"]), white_density),
            _level(name, _value(channel["coefficients"]["flicker"]), bias_instability),
            channel["colour"] or "",
        )
        for name, channel in found["channels"].items()
    )
    headings = ("channel", "slope of ADF", "slope of PSD", "std", "white noise", "flicker", "colour")
    _print_table(headings, rows, caption="white noise alone has slopes of −0.5 and 0")
    _print_sentences(found["summary"])


def print_filters(found: dict[str, Any]) -> None:
    """Prints a comparison of filters: one row each, then what it says."""
    rows = (
        (
            row["label"],
            _number(row["jitter_deg"], ".4f", "°"),
            _number(row["lag_ms"], "+z.1f", " ms"),
            _number(row["largest_offset_deg"], ".3f", "°"),
            "yes" if row["causal"] else "no",
        )
        for row in found["filters"]
    )
    headings = ("filter", "jitter in 100 ms", "lag", "largest offset", "causal")
    _print_table(headings, rows, caption="the paper: jitter 0.330° → 0.143°")
    _print_sentences(found["summary"])


def _print_table(headings: Iterable[str], rows: Iterable[tuple[str, ...]], caption: str) -> None:
    table = Table(caption=Text(caption), caption_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place else "left")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console(soft_wrap=True, highlight=False).print(table)


def _print_sentences(sentences: Iterable[str]) -> None:
    console = Console(soft_wrap=True, highlight=False)
    for sentence in sentences:
        console.print(Text(printable(f"· {sentence}")))


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "not known" if value is None else f"{value:{form}}{unit}".replace("-", "−")


def _level(name: str, value: float | None, words: Callable[[str, float], str]) -> str:
    return "not known" if value is None else words(name, value)


def _value(coefficient: dict[str, Any] | None) -> float | None:
    return None if coefficient is None else coefficient["value"]
