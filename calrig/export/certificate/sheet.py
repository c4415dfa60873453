"""A certificate laid out: sections of plain text as pairs, tables and paragraphs, for a renderer."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import Literal

from calrig.calibration.uncertainty import percent
from calrig.export.certificate.content import (
    DIGITS,
    NOT_STATED,
    Certificate,
    EffectFound,
    Point,
    Quantity,
    Row,
    Standard,
    by_itself,
    place_of,
    rounded,
)


@dataclass(frozen=True, slots=True)
class Block:
    """Something on the page.

    Attributes:
        kind: `pairs` (each row a name and what is said of it), `table`, `paragraphs`, `picture` (described by
            its one line), `figure` (a statement to be seen first), `listing` (names and values, small).
        columns: heads of a table.
        numbers: which columns of a table are figures.
        lines: of paragraphs.
    """

    kind: Literal["pairs", "table", "paragraphs", "picture", "figure", "listing"]
    rows: tuple[tuple[str, ...], ...] = ()
    columns: tuple[str, ...] = ()
    numbers: tuple[bool, ...] = ()
    lines: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and the blocks below it."""

    title: str
    blocks: tuple[Block, ...]


def pairs(rows: Iterable[Row]) -> Block:
    """Names and what is said of them."""
    return Block("pairs", rows=tuple(rows))


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[bool] = ()) -> Block:
    """A table; `numbers` tells which columns are figures, none without it."""
    chosen = tuple(numbers) or (False,) * len(columns)
    return Block("table", tuple(map(tuple, rows)), tuple(columns), chosen)


def paragraphs(lines: Iterable[str]) -> Block:
    """Sentences, a paragraph each."""
    return Block("paragraphs", lines=tuple(lines))


def stated(value: str | None) -> str:
    """What is said, or that nothing is."""
    return value or NOT_STATED


def shown(value: float | None, form: Callable[[float], str] = "{:.2f}".format) -> str:
    """A figure in a form, or that none is stated."""
    return NOT_STATED if value is None else form(value)


def degrees(value: float) -> str:
    """An angle of which no uncertainty is stated, two digits."""
    return f"{_minus(by_itself(value))}°"


def results(said: Certificate) -> tuple[Block, ...]:
    """U, bias and scale, the effects in words, RMS errors."""
    found = said.results
    blocks = [Block("figure", lines=(_elevation(said),))]
    if found.line:
        columns = ("Result", "Value", "Expanded uncertainty U", "k")
        blocks.append(table(columns, [_line(one) for one in found.line], (False, True, True, True)))
    blocks += [_effect(one, "of the unit; part of the calibration") for one in found.effects]
    blocks += [_effect(one, "of the stage; taken out, no part of the calibration") for one in found.of_stage]
    if not found.effects and not found.of_stage:
        blocks.append(paragraphs(["Beside bias and scale no effect was accepted."]))
    blocks.append(pairs((one.title, f"{_minus(one.text)}{one.unit}") for one in found.figures))
    return tuple(blocks)


def conformity(said: Certificate) -> tuple[Block, ...]:
    """The statement of conformity with its rule and risk, or that there is none, and what was judged."""
    found = said.conformity
    agreed = said.laboratory.decision_rule
    if found is None:
        none = "No statement of conformity: no limits matched this unit when it was issued."
        return (paragraphs([none, *said.judged]),)
    rows = [
        ("Statement", found.answer_in_words),
        ("Specification", f"{found.limit_name}: {'; '.join(found.asks) or NOT_STATED}"),
        ("Decision rule", found.rule + (f". {agreed}" if agreed else "")),
        ("Probability of conformity", shown(found.probability_of_conformity, percent)),
    ]
    if found.answer == "pass":
        rows.append(("Probability of false acceptance", shown(found.probability_of_false_accept, percent)))
    return pairs(rows), paragraphs(found.says)


def points(said: Certificate) -> tuple[Block, ...]:
    """The errors by elevation."""
    found = said.results
    note = f"As found: {found.found_by}. As left: with this calibration."
    columns = ("Elevation", "Poses", "As found", "from … to", "As left", "from … to", "U")
    ends = [end for one in found.points for end in (one.left_low_deg, one.left_high_deg)]
    largest = max((abs(end) for end in ends if math.isfinite(end)), default=None)
    shown = [one for one in (found.points[0].expanded_deg, largest) if one] if found.points else []
    place = min((place_of(one, DIGITS) for one in shown), default=-3)
    rows = [_point(point, place) for point in found.points]
    numbers = (True,) * len(columns)
    return paragraphs([note, *found.points_say]), table(columns, rows, numbers)


def budget(said: Certificate) -> tuple[Block, ...]:
    """The lines of the budget, what they come to, how, and what has no line."""
    found = said.budget
    columns = (
        "Quantity", "Type", "Distribution", "ν", "Std uncertainty", "Sensitivity", "Contribution", "Share",
    )  # fmt: skip
    rows = [
        (
            f"{line.symbol}: {line.title}",
            line.type_,
            line.distribution,
            shown(line.freedom, _freedom),
            f"{by_itself(line.std)}{line.unit}" if line.std else "–",
            _minus(f"{by_itself(line.sensitivity, 3)} {line.sensitivity_unit}") if line.sensitivity else "–",
            f"{by_itself(line.contribution_deg)}°" if line.contribution_deg else "–",
            _minus(f"{100 * line.share:.2f} %"),
        )
        for line in found.contributions
    ]
    numbers = (False, False, False, True, True, True, True, True)
    combined = [
        ("Combined standard uncertainty u", shown(found.combined_deg, degrees)),
        ("Effective degrees of freedom", shown(found.effective_freedom, _freedom)),
        ("Coverage factor k", shown(found.coverage_factor)),
        ("Coverage probability", f"{100 * found.coverage:g} %"),
        ("Expanded uncertainty U", shown(found.expanded_deg, degrees)),
    ]
    return table(columns, rows, numbers), pairs(combined), paragraphs(found.method + found.not_contained)


def _elevation(said: Certificate) -> str:
    found = said.results.elevation
    if found is None:
        return f"Expanded uncertainty of a calibrated elevation: {NOT_STATED}"
    return (
        f"Expanded uncertainty of a calibrated elevation: U = {found.expanded_text}° "
        f"(k = {shown(found.coverage_factor)}, {100 * (found.coverage or 0.0):g} %)"
    )


def _line(one: Quantity) -> tuple[str, ...]:
    unit = one.unit
    u = NOT_STATED if one.expanded_text is None else f"{one.expanded_text}{unit}"
    return one.title, f"{_minus(one.text)}{unit}", u, shown(one.coverage_factor)


def _effect(one: EffectFound, whose: str) -> Block:
    rows = [
        (
            quantity.title,
            _minus(quantity.text)
            + (f" ± {quantity.std_text}" if quantity.std_text else "")
            + ("" if quantity.unit == "°" else " ")
            + quantity.unit
            + (" (standard error)" if quantity.std_text else ""),
        )
        for quantity in one.parameters
    ]
    return pairs([("Effect", f"{one.title} ({whose})"), *rows, ("Added to the reading", one.formula)])


def _point(point: Point, place: int) -> tuple[str, ...]:
    """A row; all errors to one place, so that the largest error has the digits that the verdict shows."""

    def at(value: float) -> str:
        return _minus(rounded(value, place)) + "°" if math.isfinite(value) else NOT_STATED

    return (
        _minus(f"{point.elevation_deg:.4g}") + "°",
        str(point.n_poses),
        at(point.found_deg),
        f"{at(point.found_low_deg)} … {at(point.found_high_deg)}",
        at(point.left_deg),
        f"{at(point.left_low_deg)} … {at(point.left_high_deg)}",
        shown(point.expanded_deg, degrees),
    )


def _freedom(value: float) -> str:
    return "∞" if math.isinf(value) else f"{math.floor(value)}"


def _minus(text: str) -> str:
    return text.replace("-", "−")


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
        running: the head of every page, next to its number.
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
    stamps = [] if said.issue is not None else ["PREVIEW: not a certificate"]
    stamps += ["NO ITEM WAS MEASURED: the rig is a simulation"] if said.kind == "demonstration" else []
    stamps += [STAMPS[said.status]] if said.status in STAMPS else []
    stamps += ["NOT TO BE RELIED ON: what it rests on counts no more"] if said.gone else []
    laboratory = said.laboratory
    authorised = f"Authorised by: {stated(said.authorised_by)}. {said.in_force_by}"
    return Sheet(
        title=TITLES[said.kind],
        number=said.number,
        running=f"Certificate {said.number}",
        stamp=" · ".join(stamps) or None,
        laboratory=(
            f"Laboratory: {stated(laboratory.name)}",
            f"Address: {stated(laboratory.address)}",
            f"Place of calibration: {laboratory.place or stated(laboratory.address)}",
            *filter(None, [laboratory.accreditation]),
        ),
        sections=(
            Section("Item", _item(said)),
            Section("Calibration", (_dates(said),)),
            Section("Results", results(said)),
            Section("Conformity", conformity(said)),
            Section("Errors as found and as left", points(said)),
            Section("What is left, step by step", (Block("picture", lines=(_seen(said),)),)),
            Section("Measurement uncertainty", budget(said)),
            Section("Method and conditions", _method(said)),
            Section("Traceability", tuple(_traceability(said))),
            Section("Deviations and amendments", _deviations(said)),
            Section("Records", _records(said)),
            Section("Statements", (paragraphs((*said.statements, authorised)),)),
            Section("Annex: the calibration document as issued", _annex(said)),
        ),
        end=f"End of certificate {said.number}",
    )


def moment(when: datetime | date | None) -> str:
    """A day, or a time to the minute in UTC."""
    if when is None:
        return NOT_STATED
    return f"{when:%Y-%m-%d %H:%M} UTC" if isinstance(when, datetime) else f"{when:%Y-%m-%d}"


def _item(said: Certificate) -> tuple[Block, ...]:
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
    told = pairs((name + marks.get(field, ""), stated(value)) for name, value, field in rows)
    supplied = "† Supplied by the customer; the laboratory is not responsible for it, nor for what follows."
    return (told, paragraphs([supplied])) if item.supplied else (told,)


def _dates(said: Certificate) -> Block:
    dates = said.dates
    began, ended = dates.calibration_began, dates.calibration_ended
    when = moment(ended)
    if began is not None and ended is not None:
        when = f"{moment(began)} to {moment(ended)}"
    elif ended is None:
        when = f"not stated; measured no later than {moment(dates.measured_by)}"
    rows = [
        ("Measurand", said.method.measurand),
        ("Date of calibration", when),
        ("Date of issue", "not issued: a preview" if said.issue is None else moment(dates.issued)),
        ("Revision", f"{said.revision} of {moment(dates.revision_made)} ({said.status.replace('_', ' ')})"),
        ("Released", "no" if dates.released is None else moment(dates.released)),
    ]
    if said.item.interval_months is not None:
        agreed = f"{said.item.interval_months} months, as agreed with the customer"
        rows.append(("Calibrate again by", f"{moment(dates.calibrate_again)} ({agreed})"))
    return pairs(rows)


def _seen(said: Certificate) -> str:
    """The picture in words, for who cannot see it."""
    steps = "; ".join(f"{step.title}: RMS {degrees(step.rms_deg)}" for step in said.residuals.steps)
    return f"{said.residuals.title} against elevation. {steps}."


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
    lines = [*said.gone, *said.deviations] or ["No deviations from the method."]
    replaced = said.replaces
    if replaced is not None:
        what = "evaluates the measurement of" if replaced.is_same_run else "follows the calibration of"
        again = " again" if replaced.is_same_run else ""
        why = f" Reason: {replaced.reason}" if replaced.reason else ""
        lines.append(
            f"This revision {what} revision {replaced.revision} of {moment(replaced.issued)} (SHA-256 of "
            f"its document {replaced.sha256}){again}.{why}"
        )
    issue = said.issue
    if issue is not None and issue.replaces is not None:
        lines.append(
            f"This certificate amends and replaces certificate {issue.replaces}. Reason: "
            f"{stated(issue.reason)}."
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
    if said.issue is not None:
        lines.append(
            f"Issued by {stated(said.issue.by)}; the newest entry of the audit trail before the issue was "
            f"{said.issue.trail_seq}, SHA-256 {said.issue.trail_sha256}"
        )
    return (paragraphs([*lines, *said.software]),)


def _annex(said: Certificate) -> tuple[Block, ...]:
    note = "What software reads, key by key and number for number; the file itself is attached."
    return paragraphs([note]), Block("listing", rows=said.document)
