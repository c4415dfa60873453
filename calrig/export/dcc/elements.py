"""The pieces that a DCC is built of: elements, texts, quantities with their units in D-SI's notation."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as ET

from calrig.export.certificate.content import NOT_STATED, Quantity, Row

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
LANGUAGE = "en"
Content = ET.Element | str | None

STANDARD_GRAVITY = 9.80665
"""m/s²; calrig's mg are thousandths of it."""
UNITS: dict[str, tuple[str, float]] = {
    "": (r"\one", 1.0),
    "°": (r"\degree", 1.0),
    "°C": (r"\degreecelsius", 1.0),
    "s": (r"\second", 1.0),
    "%": (r"\percent", 1.0),
    "°/s": (r"\degree\second\tothe{-1}", 1.0),
    "°/°C": (r"\degree\degreecelsius\tothe{-1}", 1.0),
    "°/°C²": (r"\degree\degreecelsius\tothe{-2}", 1.0),
    "°/°²": (r"\degree\tothe{-1}", 1.0),
    "°/°³": (r"\degree\tothe{-2}", 1.0),
    "1/°C": (r"\degreecelsius\tothe{-1}", 1.0),
    "%/°C": (r"\percent\degreecelsius\tothe{-1}", 1.0),
    "mg": (r"\metre\second\tothe{-2}", 1e-3 * STANDARD_GRAVITY),
    "mg/°C": (r"\metre\second\tothe{-2}\degreecelsius\tothe{-1}", 1e-3 * STANDARD_GRAVITY),
    "mg/g²": (r"\metre\tothe{-1}\second\tothe{2}", 1e-3 / STANDARD_GRAVITY),
    "mg/g³": (r"\metre\tothe{-2}\second\tothe{4}", 1e-3 / STANDARD_GRAVITY**2),
}
"""Units as they are printed: in D-SI, and what one of them is in that."""
_NO_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def dcc(tag: str, *content: Content, **attributes: str | None) -> ET.Element:
    """An element of the DCC's own; contents and attributes that are None are left out."""
    return _element(DCC, tag, content, attributes)


def si(tag: str, *content: Content) -> ET.Element:
    """An element of D-SI."""
    return _element(SI, tag, content, {})


def _element(
    namespace: str, tag: str, content: Iterable[Content], attributes: dict[str, str | None]
) -> ET.Element:
    made = ET.Element(f"{{{namespace}}}{tag}", {k: v for k, v in attributes.items() if v is not None})
    for one in content:
        if isinstance(one, str):
            made.text = one
        elif one is not None:
            made.append(one)
    return made


def plain(text: object) -> str:
    """Text as every field of a DCC takes it: in one line, not empty, characters that XML has."""
    kept = _NO_XML.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))
    return " ".join(kept.split()) or NOT_STATED


def words(tag: str, *texts: object) -> ET.Element:
    """Text or rich content, a sentence each; `not stated` of none."""
    said = [plain(text) for text in texts if text is not None] or [NOT_STATED]
    return dcc(tag, *(dcc("content", one, lang=LANGUAGE) for one in said))


def words_if(tag: str, *texts: object) -> ET.Element | None:
    """The same, or None where there is nothing to say."""
    said = [text for text in texts if text is not None]
    return words(tag, *said) if said else None


def listed(tag: str, entries: Sequence[ET.Element]) -> ET.Element | None:
    """A list of elements, which may not be empty: None then."""
    return dcc(tag, *entries) if entries else None


def rows(said: Sequence[Row]) -> list[str]:
    """Rows of a table as sentences."""
    return [f"{name}: {value}" for name, value in said]


def number(value: float) -> str:
    """A number, every digit of it.

    Raises:
        ValueError: it is none that a DCC can state.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be stated in a DCC")
    return repr(float(value))


def numbers(values: Iterable[float]) -> str:
    """Numbers as a list of XML's."""
    return " ".join(map(number, values))


def quantity(
    said: Quantity, ref_type: str | None = None, distribution: str | None = None, about: str | None = None
) -> ET.Element:
    """A figure with its expanded uncertainty; with its standard uncertainty alone, that is said in words.

    A figure in a unit outside the SI is given in both (`si:hybrid`).
    """
    unit, factor = UNITS.get(said.unit, (None, 1.0))
    of_std = None
    if said.expanded is None and said.std is not None:
        of_std = f"Standard uncertainty {number(said.std)} {said.unit}".rstrip()
    name, description = words("name", said.title), words_if("description", about, of_std)
    if unit is None:
        figure = words("noQuantity", f"{number(said.value)} {said.unit}")
    elif factor == 1.0:
        figure = _real(said, unit, 1.0, distribution)
    else:
        figure = si(
            "hybrid", _real(said, unit, factor, distribution), _real(said, said.unit, 1.0, distribution)
        )
    return dcc("quantity", name, description, figure, refType=ref_type)


def _real(said: Quantity, unit: str, factor: float, distribution: str | None) -> ET.Element:
    worth = None
    if said.expanded is not None and (said.coverage_factor or 0.0) >= 1.0 and said.coverage is not None:
        worth = si(
            "expandedUnc",
            si("uncertainty", number(said.expanded * factor)),
            si("coverageFactor", number(said.coverage_factor or 1.0)),
            si("coverageProbability", number(said.coverage)),
            None if distribution is None else si("distribution", distribution),
        )
    return si("real", si("value", number(said.value * factor)), si("unit", unit), worth)


def real_list(
    title: str,
    values: Sequence[float],
    unit: str,
    *,
    ref_type: str,
    ref_id: str | None = None,
    worth: tuple[float, float, float, str | None] | None = None,
) -> ET.Element:
    """A column of figures.

    Args:
        title: what they are.
        values: at least one.
        unit: as it is printed, one of `UNITS` in the SI.
        ref_type: of the quantity.
        ref_id: ids of what it is of.
        worth: expanded uncertainty, coverage factor and probability of each alike, and the distribution.
    """
    uncertainty = None
    if worth is not None:
        expanded, factor, probability, distribution = worth
        uncertainty = si(
            "expandedUncXMLList",
            si("uncertaintyXMLList", numbers([expanded] * len(values))),
            si("coverageFactorXMLList", numbers([factor] * len(values))),
            si("coverageProbabilityXMLList", numbers([probability] * len(values))),
            None
            if distribution is None
            else si("distributionXMLList", " ".join([distribution] * len(values))),
        )
    figures = si(
        "realListXMLList",
        si("valueXMLList", numbers(values)),
        si("unitXMLList", UNITS[unit][0]),
        uncertainty,
    )
    return dcc("quantity", words("name", title), figures, refType=ref_type, refId=ref_id)
