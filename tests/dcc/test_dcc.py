"""The digital calibration certificate: valid by PTB's schema whatever was stored, its numbers as they are."""

from __future__ import annotations

import base64
import math
import random
import re
from xml.etree import ElementTree as ET

import pytest
from laboratory_keys import key_files
from random_certificates import random_certificate

from calrig.errors import WorkError
from calrig.export.certificate.content import Quantity
from calrig.export.certificate.sheet import points
from calrig.export.dcc.document import dcc_of
from calrig.export.dcc.elements import UNITS, quantity
from calrig.export.signing import signed_dcc

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


def read(xml: bytes) -> ET.Element:
    return ET.fromstring(xml)


def checked(seed: int, errors_in) -> None:
    said, document = random_certificate(random.Random(seed))
    xml = dcc_of(said, document, random.Random(seed).choice([None, "DE"]))
    assert errors_in(xml) == [], seed
    (attached,) = read(xml).iterfind(".//dcc:byteData/dcc:dataBase64", NAMES)
    assert base64.b64decode(attached.text) == document


def test_certificates_of_random_histories_are_valid(errors_in):
    for seed in range(8):
        checked(seed, errors_in)


@pytest.mark.statistical
def test_certificates_of_two_hundred_random_histories_are_valid(errors_in):
    for seed in range(1000, 1200):
        checked(seed, errors_in)


def test_numbers_conformity_and_amendment_are_the_certificates_own():
    seen, with_errors = set(), 0
    for seed in range(30):
        said, document = random_certificate(random.Random(seed))
        xml = dcc_of(said, document)
        assert dcc_of(said, document) == xml
        root = read(xml)

        def text(path, root=root):
            return root.findtext(f".//{path}", namespaces=NAMES)

        assert text("dcc:uniqueIdentifier") == said.number
        if said.conformity is not None:
            # the schema has no word for `undecided`: the declaration says so
            words = {
                "conditional_pass": "conditionalPass",
                "conditional_fail": "conditionalFail",
                "undecided": None,
            }
            assert text("dcc:conformity") == words.get(said.conformity.answer, said.conformity.answer)
            seen.add(said.conformity.answer)
        else:
            assert text("dcc:conformity") is None
        if said.results.elevation is not None:
            elevation = said.results.elevation
            worth = root.find(".//dcc:quantity[@refType='calrig_elevation']//si:expandedUnc", NAMES)
            figures = [float(worth.findtext(f"si:{name}", namespaces=NAMES)) for name in UNCERTAINTY]
            assert figures == [elevation.expanded, elevation.coverage_factor, elevation.coverage]
        column = root.find(".//dcc:quantity[@refType='basic_measurementError']", NAMES)
        told = [one.left_deg for one in said.results.points if math.isfinite(one.left_deg)]
        assert (column is not None) == bool(told), "a curve that turns the slope round leaves no elevation"
        if column is not None:
            values = column.findtext(".//si:valueXMLList", namespaces=NAMES).split()
            assert [float(value) for value in values] == told
            assert column.get("refId") == "asLeft"
            with_errors += 1
        units = {unit.text for unit in root.iterfind(".//si:unit", NAMES)}
        assert units <= {unit for unit, _ in UNITS.values()} | set(UNITS)
        assert text("dcc:typeOfChange") is None, "no certificate is named that it would replace"
        assert text("dcc:previousReport/dcc:value") == (said.replaces and said.replaces.sha256)
        days = {
            one.get("refType"): one.findtext("dcc:date", namespaces=NAMES)
            for one in root.iterfind(".//dcc:statement", NAMES)
        }
        dates = said.dates
        for kind, day in (("recalibration", dates.calibrate_again), ("release", dates.released)):
            assert days.get(f"calrig_{kind}") == (day and day.isoformat()[:10])
        assert days["calrig_revisionMade"] == dates.revision_made.date().isoformat()
    assert len(seen) == 5
    assert 20 <= with_errors < 30


UNCERTAINTY = ("uncertainty", "coverageFactor", "coverageProbability")


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """Two laboratories' keys, each with its certificate."""
    folder = tmp_path_factory.mktemp("keys")
    return [key_files(folder, name) for name in ("lab", "other")]


def test_a_signed_dcc_is_valid_and_any_change_breaks_its_signature(errors_in, keys):
    from signxml import InvalidSignature
    from signxml.verifier import XMLVerifier

    (key, certificate), (_, other) = keys
    xml = signed_dcc(dcc_of(*random_certificate(random.Random(3))), key, certificate)
    assert errors_in(xml) == []
    verified = XMLVerifier().verify(xml, x509_cert=certificate.read_text())
    assert verified.signed_xml.tag == "{https://ptb.de/dcc}digitalCalibrationCertificate"
    for forged in (
        xml.replace(b"<si:value>1.0", b"<si:value>1.1", 1),
        xml.replace(b"Elevation<", b"elevation<", 1),
    ):
        assert forged != xml
        with pytest.raises(InvalidSignature):
            XMLVerifier().verify(forged, x509_cert=certificate.read_text())
    with pytest.raises(WorkError, match="cannot be signed with"):
        signed_dcc(dcc_of(*random_certificate(random.Random(3))), key, other)
    with pytest.raises(WorkError, match=r"absent\.key: cannot be read"):
        signed_dcc(b"", key.with_name("absent.key"), certificate)


METRE, SECOND, DEGREE, KELVIN = "metre", "second", "degree", "kelvin"
D_SI_NAMES = {
    "one": ({}, 1.0), "percent": ({}, 0.01), "metre": ({METRE: 1}, 1.0), "second": ({SECOND: 1}, 1.0),
    "degree": ({DEGREE: 1}, 1.0), "degreecelsius": ({KELVIN: 1}, 1.0),
}  # fmt: skip
"""PTB, Digital System of Units, brochure 2.1: names of units, as dimensions and a factor."""
PRINTED = {
    "1": ({}, 1.0), "%": ({}, 0.01), "s": ({SECOND: 1}, 1.0), "°": ({DEGREE: 1}, 1.0),
    "°C": ({KELVIN: 1}, 1.0), "g": ({METRE: 1, SECOND: -2}, 9.80665),
    "mg": ({METRE: 1, SECOND: -2}, 9.80665e-3),
}  # fmt: skip
"""The same for units as printed; g is the standard acceleration of free fall (3rd CGPM, 1901)."""


def product(factors):
    dimensions, size = {}, 1.0
    for (powers, one), exponent in factors:
        size *= one**exponent
        for name, power in powers.items():
            dimensions[name] = dimensions.get(name, 0) + power * exponent
    return {name: power for name, power in dimensions.items() if power}, size


@pytest.mark.parametrize("printed", list(UNITS))
def test_a_unit_in_d_si_is_the_unit_that_is_printed(printed):
    d_si, factor = UNITS[printed]
    words = re.findall(r"\\([a-z]+)(?:\\tothe\{(-?\d+)\})?", d_si)
    stated, size = product([(D_SI_NAMES[word], int(power or 1)) for word, power in words])
    numerator, _, denominator = (printed or "1").partition("/")
    below = denominator.rstrip("²³")
    exponent = {"²": 2, "³": 3}.get(denominator[-1:], 1)
    meant, worth = product([(PRINTED[numerator], 1), *([(PRINTED[below], -exponent)] if below else [])])
    assert stated == meant
    assert size * factor == pytest.approx(worth, rel=1e-12)


def test_a_figure_in_mg_is_in_m_per_s2_with_its_uncertainty():
    said = Quantity(
        "y_mg", "Offset of y", 4.0, "mg", std=0.5, expanded=1.0, coverage_factor=2.0, coverage=0.95
    )
    (in_si, as_printed) = quantity(said).iterfind(".//si:real", NAMES)
    for real, factor in ((in_si, 9.80665e-3), (as_printed, 1.0)):
        found = [float(real.findtext(f".//si:{name}", namespaces=NAMES)) for name in ("value", *UNCERTAINTY)]
        assert found == pytest.approx([4.0 * factor, 1.0 * factor, 2.0, 0.95])


def test_what_a_curve_leaves_no_elevation_for_is_not_stated_on_the_sheet_either():
    sheets = [points(random_certificate(random.Random(seed))[0]) for seed in range(30)]
    told = [str(blocks) for blocks in sheets]
    assert not any("nan" in text for text in told)
    assert any("not stated … not stated" in text for text in told)
