"""The elements of a DCC: texts, quantities with units in D-SI's notation, and its administrative data."""

import math
import re
from collections.abc import Iterable, Sequence
from datetime import date
from xml.etree import ElementTree as ET

from calrig.calibration.uncertainty import percent
from calrig.estimation.angles import STANDARD_GRAVITY_MPS2
from calrig.export.certificate.content import NOT_STATED, Certificate, Quantity, Row

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
LANGUAGE = "en"
Content = ET.Element | str | None

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
    "mg": (r"\metre\second\tothe{-2}", 1e-3 * STANDARD_GRAVITY_MPS2),
    "mg/°C": (r"\metre\second\tothe{-2}\degreecelsius\tothe{-1}", 1e-3 * STANDARD_GRAVITY_MPS2),
    "mg/g²": (r"\metre\tothe{-1}\second\tothe{2}", 1e-3 / STANDARD_GRAVITY_MPS2),
    "mg/g³": (r"\metre\tothe{-2}\second\tothe{4}", 1e-3 / STANDARD_GRAVITY_MPS2**2),
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

    `unit` is as printed, one of `UNITS` in the SI; `worth` has expanded uncertainty, coverage factor and
    probability of each alike, and the distribution.
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


UNKNOWN_COUNTRY = "ZZ"
"""ISO 3166-1 leaves it to users; here: the laboratory's settings name no country."""
CONFORMITY = {
    "pass": "pass",
    "conditional_pass": "conditionalPass",
    "conditional_fail": "conditionalFail",
    "fail": "fail",
}
"""The verdict's answers in the schema's words, which has none for `undecided`: the declaration says it."""
BASIC = "basic"
OWN = "calrig"
_BASIC_LINK = "https://digilab.ptb.de/dkd/refType/vocab/"


def administrative_data(said: Certificate, country: str | None) -> ET.Element:
    """The first ring of a DCC.

    `country` of the laboratory has two letters of ISO 3166-1; None if not stated.
    """
    return dcc(
        "administrativeData",
        dcc("dccSoftware", software(said)),
        dcc(
            "refTypeDefinitions",
            _ref_types("Reference types of general use", BASIC, _BASIC_LINK),
            _ref_types(
                "calrig's own: what PTB's vocabulary has no word for",
                OWN,
                "calrig/docs/reference/certificate.md",
            ),
        ),
        _core_data(said, country),
        _items(said),
        dcc("calibrationLaboratory", _contact("contact", said.laboratory.name, said.laboratory.address)),
        _persons(said),
        _contact("customer", said.item.customer, said.item.address),
        dcc("statements", *_statements(said)),
    )


def software(said: Certificate) -> ET.Element:
    """The program that calibrated, by its version of then."""
    name, _, release = said.method.program.partition(" ")
    return dcc(
        "software",
        words("name", name),
        dcc("release", plain(release)),
        dcc("type", "application"),
        words("description", *said.software),
    )


def _ref_types(name: str, namespace: str, link: str) -> ET.Element:
    return dcc("refTypeDefinition", words("name", name), dcc("namespace", namespace), dcc("link", link))


def _core_data(said: Certificate, country: str | None) -> ET.Element:
    dates = said.dates
    began = (dates.calibration_began or dates.measured_by).date()
    ended = (dates.calibration_ended or dates.measured_by).date()
    order = said.item.order
    identifications = [
        _identification("calibrationLaboratory", said.document_sha256, "SHA-256 of the calibration document"),
        _identification("calibrationLaboratory", f"{said.revision}", "Revision of the unit's calibration"),
    ]
    if order is not None:
        identifications.append(_identification("customer", order, "Order", "calrig_order"))
    before, issue = said.replaces, said.issue
    amended = previous = None
    if issue is not None and issue.replaces is not None:
        amended = dcc(
            "reportAmendedSubstituted",
            dcc("typeOfChange", "substituted"),
            dcc("replacedUniqueIdentifier", plain(issue.replaces)),
        )
    if before is not None:
        what = "Evaluation of the same measurement" if before.is_same_run else "Calibration of the same unit"
        previous = dcc(
            "previousReport",
            words("referral", f"{what} that was in force until this one"),
            dcc("referralID", f"revision {before.revision}"),
            dcc("procedure", "SHA-256 of the calibration document"),
            dcc("value", before.sha256),
        )
    return dcc(
        "coreData",
        dcc("countryCodeISO3166_1", country or UNKNOWN_COUNTRY),
        dcc("usedLangCodeISO639_1", LANGUAGE),
        dcc("mandatoryLangCodeISO639_1", LANGUAGE),
        dcc("uniqueIdentifier", plain(said.number)),
        dcc("identifications", *identifications),
        _day("receiptDate", said.item.received_on),
        _day("beginPerformanceDate", began),
        _day("endPerformanceDate", ended),
        dcc("performanceLocation", "laboratory" if dates.calibration_began is not None else "other"),
        _day("issueDate", None if issue is None else dates.issued.date()),
        amended,
        previous,
    )


def _items(said: Certificate) -> ET.Element:
    item = said.item
    firmware = None
    if item.firmware is not None:
        firmware = dcc(
            "installedSoftwares",
            dcc(
                "software",
                words("name", "Firmware of the board"),
                dcc("release", plain(item.firmware)),
                dcc("type", "firmware"),
            ),
        )
    supplied = f"Supplied by the customer: {', '.join(item.supplied)}." if item.supplied else None
    condition = None if item.condition is None else f"Condition: {item.condition}"
    return dcc(
        "items",
        dcc(
            "item",
            words("name", "IMU attitude sensor"),
            words_if("description", item.description, condition, supplied),
            firmware,
            None if item.chip is None else dcc("model", plain(item.chip)),
            dcc(
                "identifications",
                _identification("manufacturer", item.serial, "Serial number", "basic_serialNumber"),
            ),
            id="unit",
        ),
    )


def _persons(said: Certificate) -> ET.Element:
    return dcc(
        "respPersons",
        dcc(
            "respPerson",
            dcc("person", words("name", said.authorised_by or NOT_STATED)),
            words("description", said.in_force_by),
            dcc("role", "authorises this certificate"),
            dcc("mainSigner", "true"),
        ),
    )


def _statements(said: Certificate) -> list[ET.Element]:
    conditions, mark = said.conditions, said.trail
    stated = [
        _statement(
            "Metrological traceability",
            said.traceable,
            ref_type="basic_metrologicallyTraceableToSI",
            traceable=any(one.certificate is not None and not one.overdue for one in said.standards[:1]),
        ),
        *_conformity(said),
        *(_statement("Statement", sentence) for sentence in said.statements),
        _statement("Validity", said.in_force_by),
    ]
    if not conditions.level_known:
        stated.append(
            _statement(
                "Level", f"The measurand is relative: {said.method.measurand}", ref_type="calrig_level"
            )
        )
    if said.issue is None:
        stated.append(_statement("Preview", "This is a preview and not a certificate: it was not issued."))
    else:
        stated.append(
            _statement(
                "Issue",
                f"The newest entry of the audit trail before the issue was {said.issue.trail_seq}, SHA-256 "
                f"{said.issue.trail_sha256}.",
            )
        )
        if said.issue.replaces is not None:
            why = f"Certificate {said.issue.replaces} is replaced. Reason: {said.issue.reason}"
            stated.append(_statement("Correction", why))
    if said.dates.calibration_began is None:
        words_of_it = (
            "The dates of measurement were not stated: in their place stands the day by which it was "
            "measured, that of the import."
        )
        stated.append(_statement("Dates", words_of_it, ref_type="calrig_dates"))
    stated += _dated(said)
    if said.replaces is not None:
        number = said.replaces.revision
        why = f" Reason: {said.replaces.reason}" if said.replaces.reason else ""
        stated.append(
            _statement(
                "Revision", f"It stands in the place of revision {number}.{why}", ref_type="basic_revision"
            )
        )
    if said.dates.calibrate_again is not None:
        stated.append(
            _statement(
                "Recalibration, as agreed with the customer",
                f"To be calibrated again after {said.item.interval_months} months.",
                ref_type="calrig_recalibration",
                day=said.dates.calibrate_again,
            )
        )
    stated += [_statement("Not to be relied on", one, ref_type="calrig_gone") for one in said.gone]
    stated += [_statement("Deviation", one, ref_type="calrig_deviation") for one in said.deviations]
    if said.kind == "demonstration":
        stated.append(_statement("Demonstration", "No item was measured: the rig is a simulation."))
    if mark is not None:
        entry = f"Entry {mark.seq} ({mark.what}), SHA-256 {mark.sha256}, chained to all before it."
        stated.append(_statement("Audit trail", entry, ref_type="calrig_trail"))
    if said.laboratory.accreditation is not None:
        stated.append(_statement("Accreditation", said.laboratory.accreditation))
    return stated


def _dated(said: Certificate) -> list[ET.Element]:
    """The dates that the schema has no elements for."""
    dates = said.dates
    made = _statement(
        "Revision made",
        f"Revision {said.revision} of the calibration was made on this day.",
        ref_type="calrig_revisionMade",
        day=dates.revision_made.date(),
    )
    if dates.released is None:
        return [made]
    released = _statement(
        "Release",
        f"Revision {said.revision} was released on this day.",
        ref_type="calrig_release",
        day=dates.released.date(),
    )
    return [made, released]


def _conformity(said: Certificate) -> list[ET.Element]:
    found = said.conformity
    if found is None:
        return []
    probabilities = [
        f"{what}: {percent(value)}"
        for what, value in (
            ("Probability of conformity", found.probability_of_conformity),
            ("Probability of false acceptance", found.probability_of_false_accept),
        )
        if value is not None
    ]
    rule = f"Decision rule: {found.rule}"
    agreed = said.laboratory.decision_rule
    return [
        dcc(
            "statement",
            words("name", f"Conformity with the limits “{found.limit_name}”"),
            words("description", *found.asks, rule, agreed, *probabilities),
            dcc("norm", "JCGM 106:2012"),
            dcc("norm", "ILAC-G8:09/2019"),
            words("declaration", *found.says),
            None if found.answer not in CONFORMITY else dcc("conformity", CONFORMITY[found.answer]),
            refType="basic_conformity",
            refId="results",
        )
    ]


def _statement(
    name: str,
    declaration: str,
    *,
    ref_type: str | None = None,
    traceable: bool | None = None,
    day: date | None = None,
) -> ET.Element:
    return dcc(
        "statement",
        words("name", name),
        None if traceable is None else dcc("traceable", str(traceable).lower()),
        words("declaration", declaration),
        _day("date", day),
        refType=ref_type,
    )


def _contact(tag: str, name: str | None, address: str | None) -> ET.Element:
    return dcc(
        tag, words("name", name or NOT_STATED), dcc("location", words("further", address or NOT_STATED))
    )


def _identification(issuer: str, value: str, name: str, ref_type: str | None = None) -> ET.Element:
    return dcc(
        "identification",
        dcc("issuer", issuer),
        dcc("value", plain(value)),
        words("name", name),
        refType=ref_type,
    )


def _day(tag: str, day: date | None) -> ET.Element | None:
    return None if day is None else dcc(tag, day.isoformat())
