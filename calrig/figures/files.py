"""A figure as a file: HTML that stands by itself, or PNG where plotly and its exporter are installed."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from calrig.errors import InputError, WorkError
from calrig.figures.parts import Figure
from calrig.settings import packed

PNG_SCALE = 2.0
_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>calrig</title>
<body>
<div id="figure"></div>
<script type="application/json" id="drawn">%(figure)s</script>
<script>%(script)s</script>
<script>
const {data, layout} = JSON.parse(document.getElementById("drawn").textContent);
Plotly.newPlot("figure", data, layout, {displaylogo: false, responsive: true});
</script>
</html>
"""


def writer_of(file: Path) -> Callable[[Figure], None]:
    """What will write a figure to the file, by the name's ending: `.html` (stands by itself) or `.png`.

    Raises:
        InputError: another ending, no such folder, or PNG without the exporter. What is returned raises
            WorkError where the file cannot be written.
    """
    kind = file.suffix.lower()
    if kind not in {".html", ".png"}:
        raise InputError(f"{file}: name it .html or .png")
    if not file.absolute().parent.is_dir():
        raise InputError(f"{file}: there is no folder {file.parent}")
    if kind == ".png" and not (find_spec("kaleido") and find_spec("plotly")):
        raise InputError(f"{file}: PNG needs pip install 'calrig[png]', HTML does not")
    to_bytes = _html if kind == ".html" else _png

    def write(figure: Figure) -> None:
        content = to_bytes(figure)
        try:
            file.write_bytes(content)
        except OSError as error:
            raise WorkError(f"{file}: cannot be written ({error.strerror})") from error

    return write


def _html(figure: Figure) -> bytes:
    """One file with the charts' script inside, so that it opens anywhere without a service."""
    try:
        script = (packed("web") / "vendor" / "plotly-partial.min.js").read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise WorkError(f"{error.filename}: is made when calrig is installed: pip install it") from error
    # A name with `</script>` in it would end the element that holds the figure.
    drawn = json.dumps(figure, allow_nan=False).replace("<", "\\u003c")
    return (_PAGE % {"figure": drawn, "script": script}).encode()


def _png(figure: Figure) -> bytes:
    from plotly.io import to_image  # type: ignore[import-untyped]

    try:
        return bytes(to_image(figure, format="png", scale=PNG_SCALE))
    except (RuntimeError, ValueError) as error:  # kaleido draws in a browser, which may be missing
        raise WorkError(f"PNG cannot be drawn: {error}") from error
