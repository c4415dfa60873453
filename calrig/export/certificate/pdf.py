"""A certificate as PDF/A-3, by typst, with its data attached: the same bytes for the same content."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from calrig.errors import WorkError
from calrig.export.certificate.content import Certificate
from calrig.export.certificate.sheet import sheet_of
from calrig.export.signing import signed_pdf
from calrig.laboratory import LaboratorySettings

STANDARD: Literal["a-3b"] = "a-3b"
NEEDS = "a certificate as PDF needs typst, which this installation lacks: `pip install 'typst>=0.15,<0.16'`"
_TEMPLATE = Path(__file__).with_name("certificate.typ")


class RendererMissingError(WorkError):
    """What makes PDFs is not installed."""


class CannotPrintError(WorkError):
    """Something that the certificate says cannot be printed."""


@dataclass(frozen=True, slots=True)
class Attached:
    """A file inside the PDF; `relationship` as PDF/A-3 has it (`source`, `data`, `supplement`)."""

    name: str
    content: bytes
    mime_type: str
    description: str
    relationship: str = "data"


def has_renderer() -> bool:
    """Return whether typst, which makes PDFs, is installed."""
    return find_spec("typst") is not None


def require_renderer() -> None:
    """Raise RendererMissingError where typst is not installed."""
    if not has_renderer():
        raise RendererMissingError(NEEDS)


def pdf_of(
    said: Certificate, residuals_svg: str, attached: Sequence[Attached], laboratory: LaboratorySettings
) -> bytes:
    """The PDF.

    `residuals_svg` is the picture of `said.residuals`, `attached` are files to put inside. `laboratory` has
    logo, fonts and the key that an issued certificate is signed with.

    Raises:
        RendererMissingError: typst is not installed.
        SignerMissingError: what signs is not installed.
        WorkError: key and certificate cannot be signed with.
        CannotPrintError: no font has a character, or the logo cannot be read; the message says which.
    """
    require_renderer()
    sheet = asdict(sheet_of(said))
    with TemporaryDirectory(prefix="calrig-certificate-") as folder:
        place = Path(folder)
        sheet["logo"] = _logo(laboratory.logo, place)
        sheet["attached"] = [
            {key: value for key, value in asdict(one).items() if key != "content"} for one in attached
        ]
        (place / "sheet.json").write_text(json.dumps(sheet, ensure_ascii=False), encoding="utf-8")
        (place / "residuals.svg").write_text(residuals_svg, encoding="utf-8")
        for one in attached:
            (place / one.name).write_bytes(one.content)
        (place / "certificate.typ").write_bytes(_TEMPLATE.read_bytes())
        made = _compiled(place, said.dates.issued, laboratory.fonts)
    key, certificate = laboratory.signing_key, laboratory.signing_certificate
    if said.issue is None or key is None or certificate is None:
        return made
    return signed_pdf(made, Path(key), Path(certificate))


def _logo(logo: str | None, place: Path) -> str | None:
    if logo is None:
        return None
    file = Path(logo)
    name = f"logo{file.suffix.lower()}"
    try:
        (place / name).write_bytes(file.read_bytes())
    except OSError as error:
        raise CannotPrintError(f"the laboratory's logo {logo} cannot be read: {error.strerror}") from error
    return name


def _compiled(place: Path, issued: datetime, fonts: str | None) -> bytes:
    """By typst's own fonts, so that it is the same everywhere; by others too where those lack a character."""
    import typst

    try:
        return _by_fonts(place, issued, [], ignore_system_fonts=True)
    except typst.TypstError:
        pass
    try:
        return _by_fonts(place, issued, [] if fonts is None else [Path(fonts)], ignore_system_fonts=False)
    except typst.TypstError as error:
        raise CannotPrintError(
            f"the certificate cannot be printed: {error}. Where a font lacks a character, install one that "
            "has it, or name a folder with one as `fonts` in [laboratory]"
        ) from error


def _by_fonts(place: Path, issued: datetime, fonts: list[Path], *, ignore_system_fonts: bool) -> bytes:
    import typst

    return typst.compile(
        place / "certificate.typ",
        root=place,
        font_paths=fonts,
        ignore_system_fonts=ignore_system_fonts,
        format="pdf",
        pdf_standards=[STANDARD],
        timestamp=int(issued.timestamp()),
    )
