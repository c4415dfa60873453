"""A certificate as PDF/A-3, by typst, with its data attached: the same bytes for the same content."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from calrig.errors import WorkError
from calrig.export.certificate.content import Certificate
from calrig.export.certificate.sheet import as_json, sheet_of

STANDARD = "a-3b"
NEEDS = "a certificate as PDF needs `pip install 'calrig[certificate]'`"
_TEMPLATE = Path(__file__).with_name("certificate.typ")
_LACKING = re.compile(r"could not be displayed|font", re.IGNORECASE)


class RendererMissingError(WorkError):
    """What makes PDFs is not installed."""


@dataclass(frozen=True, slots=True)
class Attached:
    """A file inside the PDF; `relationship` as PDF/A-3 has it (`source`, `data`, `supplement`)."""

    name: str
    content: bytes
    mime_type: str
    description: str
    relationship: str = "data"


def pdf_of(
    said: Certificate,
    residuals_svg: str,
    attached: Sequence[Attached] = (),
    *,
    logo: Path | None = None,
    fonts: Path | None = None,
) -> bytes:
    """The PDF.

    Args:
        said: the content.
        residuals_svg: the picture of `said.residuals`.
        attached: files to put inside.
        logo: for the head; SVG, PNG or JPEG.
        fonts: a folder of more fonts than typst's own and this machine's.

    Raises:
        RendererMissingError: typst is not installed.
        WorkError: no font has a character, or the logo cannot be read; the message says which.
    """
    if find_spec("typst") is None:
        raise RendererMissingError(NEEDS)
    sheet = as_json(sheet_of(said))
    with TemporaryDirectory(prefix="calrig-certificate-") as folder:
        place = Path(folder)
        sheet["logo"] = _logo(logo, place)
        sheet["attached"] = [
            {"name": one.name, "relationship": one.relationship}
            | {"mime_type": one.mime_type, "description": one.description}
            for one in attached
        ]
        (place / "sheet.json").write_text(json.dumps(sheet, ensure_ascii=False), encoding="utf-8")
        (place / "residuals.svg").write_text(residuals_svg, encoding="utf-8")
        for one in attached:
            (place / one.name).write_bytes(one.content)
        (place / "certificate.typ").write_bytes(_TEMPLATE.read_bytes())
        return _compiled(place, said, [] if fonts is None else [fonts])


def _logo(logo: Path | None, place: Path) -> str | None:
    if logo is None:
        return None
    try:
        name = f"logo{logo.suffix.lower()}"
        (place / name).write_bytes(logo.read_bytes())
    except OSError as error:
        raise WorkError(f"the laboratory's logo {logo} cannot be read: {error.strerror}") from error
    return name


def _compiled(place: Path, said: Certificate, fonts: Sequence[Path]) -> bytes:
    """By typst's own fonts, so that it is the same everywhere; with this machine's where those do not do."""
    import typst

    options: dict[str, Any] = {
        "root": place,
        "font_paths": list(fonts),
        "format": "pdf",
        "pdf_standards": [STANDARD],
        "timestamp": int(said.dates.issued.timestamp()),
    }
    try:
        return bytes(typst.compile(place / "certificate.typ", ignore_system_fonts=True, **options))
    except typst.TypstError as error:
        if not _LACKING.search(str(error)):
            raise WorkError(f"typst cannot make the certificate: {error}") from error
    try:
        return bytes(typst.compile(place / "certificate.typ", ignore_system_fonts=False, **options))
    except typst.TypstError as error:
        raise WorkError(
            f"the certificate cannot be made: {error}. Install a font that has the character, or name a "
            "folder with one as `fonts` in [laboratory]"
        ) from error
