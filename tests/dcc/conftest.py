from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from repository import SHARED

SCHEMAS = SHARED / "dcc"


@pytest.fixture(scope="session")
def errors_in() -> Callable[[bytes], list[str]]:
    """What PTB's schema says of a DCC; read from ../shared/dcc, nothing from a network."""
    import signxml
    import xmlschema

    if not (SCHEMAS / "dcc-3.2.1.xsd").is_file():
        pytest.skip(f"PTB's schemas are not in {SCHEMAS}")
    of_signatures = Path(signxml.__file__).parent / "schemas" / "xmldsig-core-schema.xsd"
    locations = {
        "https://ptb.de/si": str(SCHEMAS / "SI_Format-2.1.0.xsd"),
        "http://www.w3.org/2000/09/xmldsig#": str(of_signatures),
    }
    schema = xmlschema.XMLSchema(str(SCHEMAS / "dcc-3.2.1.xsd"), locations=locations, allow="local")
    return lambda xml: [str(error) for error in schema.iter_errors(xml.decode(), use_location_hints=False)]
