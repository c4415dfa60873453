"""What a certificate of calibration says, in the order of ISO/IEC 17025:2017, 7.8.2 and 7.8.4.

Made once (`making.certificate_of`) and written in several forms, none of which computes anything. What is not
known is None, an empty tuple or `NOT_STATED`, never a default.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime
from typing import Literal

from calrig.calibration.uncertainty import Answer, Limit
from calrig.export.certificate.budget import Budget
from calrig.export.certificate.pose_errors import Point, Residuals
from calrig.export.certificate.rounding import by_itself, with_uncertainty
from calrig.store.issued import RevisionStatus

NOT_STATED = "not stated"

Row = tuple[str, str]
"""What something is called, and what is said of it."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A figure with its unit; what is not known of it is None.

    Attributes:
        name: as the calibration document has it.
        title: in words.
        unit: as it is printed; empty of a ratio.
        std: standard uncertainty.
        expanded: the standard uncertainty times `coverage_factor`, for the probability `coverage`.
        digits: that are shown where no uncertainty is known.
    """

    name: str
    title: str
    value: float
    unit: str
    std: float | None = None
    expanded: float | None = None
    coverage_factor: float | None = None
    coverage: float | None = None
    digits: int = 4

    @property
    def text(self) -> str:
        """The value, to the place of its uncertainty."""
        uncertainty = self.expanded or self.std
        if not uncertainty:
            return by_itself(self.value, self.digits)
        return with_uncertainty(self.value, uncertainty)[0]

    @property
    def expanded_text(self) -> str | None:
        """The expanded uncertainty, two digits."""
        return None if not self.expanded else by_itself(self.expanded)

    @property
    def std_text(self) -> str | None:
        """The standard uncertainty, two digits."""
        return None if not self.std else by_itself(self.std)


@dataclass(frozen=True, slots=True)
class Laboratory:
    """Who issues it, by its own settings."""

    name: str | None
    address: str | None
    place: str | None
    accreditation: str | None
    decision_rule: str | None
    authorised_by: str | None


@dataclass(frozen=True, slots=True)
class Item:
    """The unit as it was handed in. All but serial, chip and firmware is what the customer or a person said.

    Attributes:
        interval_months: until the next calibration, only where the customer agreed to one (7.8.4.3).
        supplied: which of this the customer supplied, in words.
    """

    serial: str
    chip: str | None
    firmware: str | None
    description: str | None
    condition: str | None
    customer: str | None
    address: str | None
    order: str | None
    received_on: date | None
    interval_months: int | None
    supplied: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Dates:
    """When it was calibrated, and when the revision was made and put in force; times are aware, in UTC."""

    calibration_began: datetime | None
    calibration_ended: datetime | None
    issued: datetime
    released: datetime | None
    calibrate_again: date | None


@dataclass(frozen=True, slots=True)
class Method:
    """By what it was calibrated.

    Attributes:
        program: name and version at the time of the calibration.
        measurand: what was calibrated, in words.
        model: as the calibration document has it.
        procedure: sentences.
        plan: of the run.
        literature: the paper and the guides that it follows.
    """

    program: str
    measurand: str
    model: str
    procedure: tuple[str, ...]
    plan: tuple[Row, ...]
    literature: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Conditions:
    """Under which it was measured, and for which it holds; temperatures are of the sensor's die, °C."""

    range_deg: tuple[float, float]
    temperature_min_c: float | None
    temperature_max_c: float | None
    level_known: bool
    level_std_deg: float | None
    other: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class EffectFound:
    """An effect that enters the calibration: the catalogue's words, and this unit's figures."""

    name: str
    title: str
    formula: str
    origin: str
    parameters: tuple[Quantity, ...]


@dataclass(frozen=True, slots=True)
class Results:
    """What came out.

    Attributes:
        elevation: U of one calibrated elevation over the range, as a figure of value 0; None: not known.
        line: bias and scale.
        effects: of the unit itself, applied by who uses the calibration.
        of_stage: effects of the rig's, which were taken out and are no part of the calibration.
        figures: RMS errors and what else the run tells.
        found_by: which calibration gave the errors as found, in words.
        points: by elevation, ascending.
        points_say: what the errors are and are not.
    """

    elevation: Quantity | None
    line: tuple[Quantity, ...]
    effects: tuple[EffectFound, ...]
    of_stage: tuple[EffectFound, ...]
    figures: tuple[Quantity, ...]
    found_by: str
    points: tuple[Point, ...]
    points_say: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Standard:
    """What something was measured by, and what shows that it is traceable; all as kept with the run.

    Attributes:
        role: such as `angle of the stage`.
        what: the device, or the map in force.
        uncertainty: in words.
        sha256: of the certificate's file.
        overdue: whether the run was made after `due`; None where no date is stated.
    """

    role: str
    what: str
    uncertainty: str | None
    certificate: str | None
    file: str | None
    sha256: str | None
    issued_by: str | None
    issued_on: date | None
    due: date | None
    overdue: bool | None


@dataclass(frozen=True, slots=True)
class Conformity:
    """The verdict on the revision as it was made, by the limit of that time.

    Attributes:
        limit: None where the store no longer tells what it asked.
        asks: what it asks, a sentence each.
    """

    answer: Answer
    answer_in_words: str
    limit_name: str
    limit: Limit | None
    rule: str
    asks: tuple[str, ...]
    says: tuple[str, ...]
    probability_of_conformity: float | None
    probability_of_false_accept: float | None


@dataclass(frozen=True, slots=True)
class Replaced:
    """An earlier revision in whose place this one is; `amends`: of the same measurement (7.8.8)."""

    revision: int
    sha256: str
    issued: datetime
    amends: bool
    reason: str | None


@dataclass(frozen=True, slots=True)
class TrailMark:
    """The entry of the audit trail that is the last about this revision: its hash chains all before it."""

    seq: int
    at: datetime
    what: str
    who: str | None
    sha256: str


@dataclass(frozen=True, slots=True)
class Certificate:
    """Everything a certificate says.

    Attributes:
        number: unique: it has in it a hash of everything else.
        kind: `demonstration` of a rig that is a simulation.
        traceable: to what the angles are traceable, a sentence.
        authorised_by: who is responsible for what it says, and how it came into force.
        gone: what it rests on that counts no more: it is not to be relied on.
        deviations: from the plan or the method, and what else to know of the measurement; a sentence each.
        software: what shows that the program does what it should.
        statements: such as that results relate to this item alone.
        document: the calibration document as issued, key by key, its numbers in full.
    """

    number: str
    kind: Literal["certificate", "demonstration"]
    revision: int
    status: RevisionStatus
    document_sha256: str
    laboratory: Laboratory
    item: Item
    dates: Dates
    method: Method
    conditions: Conditions
    results: Results
    residuals: Residuals
    budget: Budget
    standards: tuple[Standard, ...]
    traceable: str
    equipment: tuple[Row, ...]
    conformity: Conformity | None
    judged: tuple[str, ...]
    authorised_by: str | None
    in_force_by: str
    replaces: Replaced | None
    gone: tuple[str, ...]
    deviations: tuple[str, ...]
    software: tuple[str, ...]
    trail: TrailMark | None
    statements: tuple[str, ...]
    document: tuple[Row, ...]
