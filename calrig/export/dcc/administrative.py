"""A DCC's administrative data: who, what, when, and what is stated about all of it."""

from __future__ import annotations

from datetime import date
from xml.etree import ElementTree as ET

from calrig.calibration.wording import percent
from calrig.export.certificate.content import NOT_STATED, Certificate
from calrig.export.dcc.elements import LANGUAGE, dcc, plain, words, words_if

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

    Args:
        said: the certificate.
        country: of the laboratory, two letters of ISO 3166-1; None where nobody stated it.
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
    issued = dates.issued.date()
    began = issued if dates.calibration_began is None else dates.calibration_began.date()
    ended = issued if dates.calibration_ended is None else dates.calibration_ended.date()
    order = said.item.order
    identifications = [
        _identification("calibrationLaboratory", said.document_sha256, "SHA-256 of the calibration document"),
        _identification("calibrationLaboratory", f"{said.revision}", "Revision of the unit's calibration"),
    ]
    if order is not None:
        identifications.append(_identification("customer", order, "Order", "calrig_order"))
    before = said.replaces
    amended = previous = None
    if before is not None and before.amends:
        amended = dcc(
            "reportAmendedSubstituted",
            dcc("typeOfChange", "amended"),
            dcc("replacedUniqueIdentifier", f"revision {before.revision}, SHA-256 {before.sha256}"),
        )
    elif before is not None:
        previous = dcc(
            "previousReport",
            words("referral", "Calibration of the same unit that was in force until this one"),
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
        _day("issueDate", issued),
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
    if said.dates.calibration_began is None:
        words_of_it = "The dates of measurement were not stated: in their place stands the date of issue."
        stated.append(_statement("Dates", words_of_it))
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
