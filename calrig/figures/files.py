"""Figures as a file: several on one sheet, as HTML that stands by itself or as PNG."""

import json
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from calrig.errors import InputError, WorkError, writable
from calrig.figures.parts import Figure
from calrig.settings import packed

Rows = Sequence[Sequence[tuple[str, Figure]]]
"""Rows of cells, each a caption and a figure of one pair of axes."""
PNG_SCALE = 2.0
ROW_PX = 400
WIDTH_PX = 1500
_LEGEND_PX, _CHARACTER_PX = 50, 6.6
"""To the right of each cell: a legend's marks, and each character of its longest name."""
_GAP_PX = 100
"""Between rows, for the axis title below and the caption above."""
_BETWEEN_PX = 90
"""Between columns, for the axis title."""
_MARGINS = {"l": 90, "r": 10, "t": 100, "b": 10}
TEXT = "#24292f"
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


def writer_of(file: Path) -> Callable[[str, Rows], None]:
    """What will write figures under a title to the file, by its ending: `.html` (stands by itself) or `.png`.

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

    def write(title: str, rows: Rows) -> None:
        content = to_bytes(sheet_of(title, rows))
        with writable(file):
            file.write_bytes(content)

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


def sheet_of(title: str, rows: Rows) -> Figure:
    """One figure with captioned cells, on white; a row's cells share its width.

    `title` is above them all; `rows` are from the top.
    """
    height, width = ROW_PX * len(rows), WIDTH_PX - _MARGINS["l"] - _MARGINS["r"]
    sheet: Figure = {"data": [], "layout": _page(title, height)}
    place = 0
    for k, row in enumerate(rows):
        up = 1.0 - (k + 1) / len(rows) + _GAP_PX / height, 1.0 - k / len(rows)
        cell = (width + _BETWEEN_PX) / len(row)
        for column, (caption, figure) in enumerate(row):
            place += 1
            left = column * cell
            right = left + cell - _BETWEEN_PX - _legend_px(figure)
            _put(sheet, figure, place, caption, (left / width, right / width), up)
    return sheet


def _legend_px(figure: Figure) -> float:
    names = [len(trace["name"]) for trace in figure["data"] if _in_legend(figure, trace)]
    return _LEGEND_PX + _CHARACTER_PX * max(names) if names else 0.0


def _in_legend(figure: Figure, trace: dict[str, Any]) -> bool:
    return bool(figure["layout"]["showlegend"] and trace.get("showlegend", True))


def _page(title: str, height: int) -> dict[str, Any]:
    return {
        "title": {"text": title, "x": 0.02},
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": TEXT},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": _MARGINS,
        "hovermode": "closest",
        "bargap": 0,
        "width": WIDTH_PX,
        "height": height + _MARGINS["t"] + _MARGINS["b"],
        "annotations": [],
    }


def _put(
    sheet: Figure,
    figure: Figure,
    place: int,
    caption: str,
    across: tuple[float, float],
    up: tuple[float, float],
) -> None:
    layout, number = sheet["layout"], "" if place == 1 else str(place)
    for trace in figure["data"]:
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}", "legend": f"legend{number}"}
        group = {"legendgroup": f"{trace['legendgroup']} {number}"} if "legendgroup" in trace else {}
        shown = {"showlegend": _in_legend(figure, trace)}
        sheet["data"].append({**trace, **axes, **group, **shown})
    drawn = figure["layout"]
    layout[f"xaxis{number}"] = {**drawn["xaxis"], "domain": list(across), "anchor": f"y{number}"}
    layout[f"yaxis{number}"] = {**drawn["yaxis"], "domain": list(up), "anchor": f"x{number}"}
    layout[f"legend{number}"] = {"x": across[1], "xanchor": "left", "y": up[1], "yanchor": "top"}
    layout["annotations"].append(
        {
            "text": f"<b>{caption}</b>",
            "showarrow": False,
            "xref": "paper",
            "yref": "paper",
            "x": across[0],
            "xanchor": "left",
            "y": up[1],
            "yanchor": "bottom",
            "yshift": 4,
        }
    )
