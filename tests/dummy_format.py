"""A format of another program that a test adds: a module among those of `calrig.export.formats`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calrig.export import formats

DUMMY = """
from calrig.export.formats import CalibrationExporter

EXPORTER = CalibrationExporter(
    name="dummy-ini",
    title="Dummy program",
    file_name="dummy.ini",
    media_type="text/x-dummy",
    contents="the bias",
    about_one_axis="all of it",
    write=lambda document: "bias = " + format(document["bias_deg"], ".3f"),
)
"""


@contextmanager
def added_format(folder: Path, text: str = DUMMY, module: str = "dummy_ini") -> Iterator[None]:
    """The package has one module more for as long as the block lasts; nothing else is told of it."""
    (folder / f"{module}.py").write_text(text)
    formats.__path__.append(str(folder))
    try:
        yield
    finally:
        formats.__path__.remove(str(folder))
        sys.modules.pop(f"{formats.__name__}.{module}", None)
