"""A figure as a file: HTML that stands by itself, or PNG where plotly's exporter is installed."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from calrig.errors import InputError, WorkError
from calrig.figures.parts import Figure

PNG_SCALE = 2.0


def writer_of(file: Path) -> Callable[[Figure], None]:
    """What will write a figure to the file, by the name's ending: `.html` (plotly inside) or `.png`.

    Raises:
        InputError: another ending, no such folder, or PNG without the exporter. What is returned raises
            WorkError where the file cannot be written.
    """
    kind = file.suffix.lower()
    if kind not in {".html", ".png"}:
        raise InputError(f"{file}: name it .html or .png")
    if not file.absolute().parent.is_dir():
        raise InputError(f"{file}: there is no folder {file.parent}")
    if kind == ".png" and find_spec("kaleido") is None:
        raise InputError(f"{file}: PNG needs the package kaleido (pip install 'calrig[png]'), HTML does not")
    to_bytes = _html if kind == ".html" else _png

    def write(figure: Figure) -> None:
        content = to_bytes(figure)
        try:
            file.write_bytes(content)
        except OSError as error:
            raise WorkError(f"{file}: cannot be written ({error.strerror})") from error

    return write


def _html(figure: Figure) -> bytes:
    from plotly.io import to_html  # type: ignore[import-untyped]

    return str(to_html(figure, include_plotlyjs=True, config={"displaylogo": False})).encode()


def _png(figure: Figure) -> bytes:
    from plotly.io import to_image

    try:
        return bytes(to_image(figure, format="png", scale=PNG_SCALE))
    except (RuntimeError, ValueError) as error:  # kaleido draws in a browser, which may be missing
        raise WorkError(f"PNG cannot be drawn: {error}") from error
