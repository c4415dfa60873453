"""A certificate laid out: sections of plain text, for a renderer that knows pairs, tables, paragraphs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date, datetime

from calrig.export.certificate import sheet_results
from calrig.export.certificate.blocks import Block, Section, pairs, paragraphs, picture, stated, table
from calrig.export.certificate.content import NOT_STATED, Certificate, Standard

SUPPLIED_MARK = " †"
TITLES = {
    "certificate": "Calibration certificate",
    "demonstration": "Demonstration of a calibration certificate",
}
STAMPS = {
    "draft": "DRAFT: not in force",
    "superseded": "SUPERSEDED by a later revision",
    "withdrawn": "WITHDRAWN: not to be used",
}
WHATS = {"drafted": "was drafted", "released": "was put in force", "withdrawn": "was withdrawn"}


@dataclass(frozen=True, slots=True)
class Sheet:
    """The whole of it, as text.

    Attributes:
        running: what stands at the head of every page beside its number.
        stamp: what a reader must not miss; None where there is nothing.
        end: the last line.
    """

    title: str
    number: str
    running: str
    stamp: str | None
    laboratory: tuple[str, ...]
    sections: tuple[Section, ...]
    end: str


def sheet_of(said: Certificate) -> Sheet:
    """Lays a certificate out."""
    stamps = ["NO ITEM WAS MEASURED: the rig is a simulation"] if said.kind == "demonstration" else []
    stamps += [STAMPS[said.status]] if said.status in STAMPS else []
    laboratory = said.laboratory
    return Sheet(
        title=TITLES[said.kind],
        number=said.number,
        running=f"Certificate {said.number}",
        stamp=" · ".join(stamps) or None,
        laboratory=(f"Laboratory: {stated(laboratory.name)}", *_lines(laboratory.address, laboratory.place))
        + ((laboratory.accreditation,) if laboratory.accreditation else ()),
        sections=(
            Section("Item", (_item(said), *_supplied(said))),
            Section("Calibration", (_dates(said),)),
            Section("Results", sheet_results.results(said)),
            Section("Conformity", sheet_results.conformity(said)),
            Section("Errors as found and as left", sheet_results.points(said)),
            Section("What is left, step by step", (picture(_seen(said)),)),
            Section("Measurement uncertainty", sheet_results.budget(said)),
            Section("Method and conditions", _method(said)),
            Section("Traceability", tuple(_traceability(said))),
            Section("Deviations and amendments", _deviations(said)),
            Section("Records", _records(said)),
            Section("Statements", (paragraphs((*said.statements, _authorised(said))),)),
            Section("Annex: the calibration document as issued", _annex(said)),
        ),
        end=f"End of certificate {said.number}",
    )


def moment(when: datetime | date | None) -> str:
    """A day, or a time to the minute in UTC."""
    if when is None:
        return NOT_STATED
    return f"{when:%Y-%m-%d %H:%M} UTC" if isinstance(when, datetime) else f"{when:%Y-%m-%d}"


def _lines(address: str | None, place: str | None) -> tuple[str, ...]:
    return (f"Address: {stated(address)}", f"Place of calibration: {place or stated(address)}")


def _item(said: Certificate) -> Block:
    item = said.item
    received = None if item.received_on is None else moment(item.received_on)
    rows = [
        ("Serial number", item.serial, ""),
        ("Description", item.description or "IMU attitude sensor", "description"),
        ("Sensor, firmware", ", ".join(one for one in (item.chip, item.firmware) if one) or None, ""),
        ("Condition at receipt", item.condition, "condition"),
        ("Customer", item.customer, "customer"),
        ("Customer's address", item.address, "address"),
        ("Order number", item.order, "order number"),
        ("Date of receipt", received, "date of receipt"),
    ]
    marks = dict.fromkeys(item.supplied, SUPPLIED_MARK)
    return pairs((name + marks.get(field, ""), stated(value)) for name, value, field in rows)


def _supplied(said: Certificate) -> Iterable[Block]:
    if said.item.supplied:
        yield paragraphs(
            ["† Supplied by the customer; the laboratory is not responsible for it, nor for what follows."]
        )


def _dates(said: Certificate) -> Block:
    dates = said.dates
    began, ended = dates.calibration_began, dates.calibration_ended
    when = moment(ended)
    if began is not None and ended is not None:
        when = f"{moment(began)} to {moment(ended)}"
    rows = [
        ("Measurand", said.method.measurand),
        ("Date of calibration", when),
        ("Date of issue", moment(dates.issued)),
        ("Revision", f"{said.revision} ({said.status.replace('_', ' ')})"),
    ]
    if said.item.interval_months is not None:
        agreed = f"{said.item.interval_months} months, as agreed with the customer"
        rows.append(("Calibrate again by", f"{moment(dates.calibrate_again)} ({agreed})"))
    return pairs(rows)


def _seen(said: Certificate) -> str:
    """The picture in words, for who cannot see it."""
    steps = "; ".join(
        f"{step.title}: RMS {sheet_results.degrees(step.rms_deg)}" for step in said.residuals.steps
    )
    return f"Residual of each pose against elevation. {steps}."


def _method(said: Certificate) -> tuple[Block, ...]:
    conditions = said.conditions
    temperature = NOT_STATED
    if conditions.temperature_min_c is not None and conditions.temperature_max_c is not None:
        low, high = f"{conditions.temperature_min_c:.1f}", f"{conditions.temperature_max_c:.1f}"
        temperature = f"{low} °C to {high} °C, of the sensor's die; ambient {NOT_STATED}".replace("-", "−")
    low, high = (f"{end:g}°".replace("-", "−") for end in conditions.range_deg)
    level = "known" if conditions.level_known else "not known: elevations are relative to their mean"
    rows = [
        ("Program", said.method.program),
        ("Range", f"{low} to {high}"),
        ("Temperature", temperature),
        ("Level", level),
        *conditions.other,
        *said.method.plan,
    ]
    literature = [f"[{k}] {title}" for k, title in enumerate(said.method.literature, 1)]
    return paragraphs(said.method.procedure), pairs(rows), paragraphs(literature)


def _traceability(said: Certificate) -> Iterable[Block]:
    yield paragraphs([said.traceable])
    yield table(
        ("Quantity", "Standard", "Uncertainty", "Certificate", "Issued by", "Issued", "Due"),
        [_standard(one) for one in said.standards],
    )
    hashes = [
        f"Certificate of {one.role.lower()}: {one.file or 'file'}, SHA-256 {one.sha256}"
        for one in said.standards
        if one.sha256
    ]
    late = [
        f"{one.role}: its certificate was overdue when the item was calibrated."
        for one in said.standards
        if one.overdue
    ]
    if hashes or late:
        yield paragraphs([*late, *hashes])
    if said.equipment:
        yield pairs(said.equipment)


def _standard(one: Standard) -> Sequence[str]:
    due = moment(one.due) + (" (overdue)" if one.overdue else "")
    return (
        one.role,
        one.what,
        stated(one.uncertainty),
        stated(one.certificate),
        stated(one.issued_by),
        moment(one.issued_on),
        due,
    )


def _deviations(said: Certificate) -> tuple[Block, ...]:
    lines = list(said.deviations) or ["No deviations from the method."]
    replaced = said.replaces
    if replaced is not None:
        what = "amends and replaces the certificate of" if replaced.amends else "follows the calibration of"
        why = f" Reason: {replaced.reason}" if replaced.reason else ""
        lines.append(
            f"This certificate {what} revision {replaced.revision} of {moment(replaced.issued)} (SHA-256 of "
            f"its document {replaced.sha256}).{why}"
        )
    return (paragraphs(lines),)


def _records(said: Certificate) -> tuple[Block, ...]:
    lines = [f"SHA-256 of the calibration document: {said.document_sha256}"]
    trail = said.trail
    if trail is not None:
        lines.append(
            f"Audit trail: entry {trail.seq} of {moment(trail.at)}, by which this revision "
            f"{WHATS[trail.what]}; the head of the chain there is SHA-256 {trail.sha256}"
        )
    return (paragraphs([*lines, *said.software]),)


def _authorised(said: Certificate) -> str:
    return f"Authorised by: {stated(said.authorised_by)}. {said.in_force_by}"


def _annex(said: Certificate) -> tuple[Block, ...]:
    note = "What software reads, key by key and number for number; the file itself is attached."
    return paragraphs([note]), Block("listing", rows=said.document)
