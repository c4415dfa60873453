"""A certificate as a DCC. Every number in it is the certificate's own; nothing is computed here."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from calrig.export.certificate.content import Certificate
from calrig.export.dcc.administrative import administrative_data
from calrig.export.dcc.elements import DCC, SI, dcc
from calrig.export.dcc.results import measurement_results

VERSION = "3.2.1"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"


def dcc_of(said: Certificate, document: bytes, country: str | None = None) -> bytes:
    """The XML: the same bytes for the same certificate.

    Args:
        said: the certificate.
        document: the calibration document as issued.
        country: of the laboratory, two letters of ISO 3166-1; None where nobody stated it.
    """
    for prefix, namespace in (("dcc", DCC), ("si", SI), ("xsi", _INSTANCE)):
        ET.register_namespace(prefix, namespace)
    where = {f"{{{_INSTANCE}}}schemaLocation": f"{DCC} https://ptb.de/dcc/v{VERSION}/dcc.xsd"}
    root = dcc(
        "digitalCalibrationCertificate",
        administrative_data(said, country),
        measurement_results(said, document),
        schemaVersion=VERSION,
        **where,
    )
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
