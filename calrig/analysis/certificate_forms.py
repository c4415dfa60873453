"""A certificate's bytes: its DCC, signed if the laboratory has a key, and its PDF with the DCC inside.

Apart from what reads the store, so that a process for heavy work loads no database to make them.
"""

from dataclasses import dataclass
from pathlib import Path

from calrig.export.certificate.content import Certificate
from calrig.export.certificate.pdf import Attached, pdf_of
from calrig.export.dcc.document import dcc_of
from calrig.export.signing import signed_dcc
from calrig.figures.svg import residual_steps, svg_of
from calrig.laboratory import LaboratorySettings


@dataclass(frozen=True, slots=True)
class Forms:
    """The bytes of both forms; `pdf` is None where none was asked for."""

    dcc: bytes
    pdf: bytes | None = None


def forms_of(said: Certificate, document: bytes, laboratory: LaboratorySettings, *, printed: bool) -> Forms:
    """Make a certificate's forms.

    `document` is of the revision, as it was issued; `printed` tells whether the PDF is wanted, too.

    Raises:
        RendererMissingError, SignerMissingError: what makes the PDF, or signs, is not installed.
        WorkError: key and certificate cannot be signed with.
        CannotPrintError: something that it says cannot be printed.
    """
    dcc = dcc_of(said, document, laboratory.country)
    if laboratory.signing_key is not None and laboratory.signing_certificate is not None:
        dcc = signed_dcc(dcc, Path(laboratory.signing_key), Path(laboratory.signing_certificate))
    if not printed:
        return Forms(dcc)
    found = said.residuals
    steps = [(step.title, step.left_deg) for step in found.steps]
    picture = svg_of(residual_steps(found.elevation_deg, found.approach, steps))
    attached = [
        Attached("calibration.json", document, "application/json", "The calibration document as issued"),
        Attached("certificate.xml", dcc, "application/xml", "This certificate as a DCC"),
    ]
    return Forms(dcc, pdf_of(said, picture, attached, laboratory))
