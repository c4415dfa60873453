"""Formats of other programs: each module here is one, and says all there is to say of it.

A module binds `EXPORTER` and has the format's name, with `_` for `-`. Nothing else lists the formats: the
choice of `calrig export --format`, the API's parameter, the page's buttons and the table of the documentation
follow from what is here. What several formats have in common lies beside this folder.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, ClassVar, Literal

Source = Literal["calibration", "noise"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Exporter:
    """What every exporter says of its format.

    Attributes:
        name: as `--format` and the API's `format` take it.
        title: on the page's button and in refusals.
        file_name: of a file that a person saves.
        media_type: of the text (RFC 6838).
        contents: what the file holds, for the table of the documentation; Markdown without a full stop.
        about_one_axis: what it holds of a calibration about one axis alone, in the same form.
    """

    name: str
    title: str
    file_name: str
    media_type: str = "text/plain"
    contents: str
    about_one_axis: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationExporter(_Exporter):
    """Writes a calibration document (CONTRACT section 6), the revision of one run.

    Attributes:
        write: the text; ValueError with the reason where the format cannot hold the document.
    """

    source: ClassVar[Source] = "calibration"
    write: Callable[[Mapping[str, Any]], str]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseExporter(_Exporter):
    """Writes the noise of a unit, as its latest static run shows it, whatever the revision.

    Attributes:
        write: the text of a report of `calrig.noise`, and of words that say where it is from; NotHeldError
            where the report lacks what the format needs.
    """

    source: ClassVar[Source] = "noise"
    write: Callable[[Mapping[str, Any], str], str]


Exporter = CalibrationExporter | NoiseExporter


def format_names() -> list[str]:
    """The names of all formats, sorted; no format is loaded for it."""
    return sorted(found.name.replace("_", "-") for found in iter_modules(__path__))


def exporter_of(name: str) -> Exporter:
    """The exporter of one of `format_names()`.

    Raises:
        LookupError: there is no such format.
        TypeError: its module binds no EXPORTER, or one of another name.
    """
    if name not in format_names():
        raise LookupError(f"there is no format {name!r}; there are: {', '.join(format_names())}")
    module = f"{__name__}.{name.replace('-', '_')}"
    exporter = getattr(import_module(module), "EXPORTER", None)
    if not isinstance(exporter, Exporter):
        raise TypeError(f"{module} lacks EXPORTER, the exporter that it is there to describe")
    if exporter.name != name:
        raise TypeError(f"{module} describes {exporter.name!r}: name the module after the format")
    return exporter


def exporters(source: Source | None = None) -> list[Exporter]:
    """All exporters, or those of one source, sorted by name."""
    found = map(exporter_of, format_names())
    return [exporter for exporter in found if source is None or exporter.source == source]
