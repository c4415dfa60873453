"""The content of a certificate of calibration, in the order of ISO/IEC 17025:2017, 7.8.2 and 7.8.4.

It is made once (`making.certificate_of`) and written in several forms, none of which computes anything. What
is unknown is None, an empty tuple or `NOT_STATED`, never a default.

Numbers are rounded as in JCGM 100:2008, 7.2.6: an uncertainty to two digits, its value to the same place,
from the shortest decimal that is the number, half away from zero.
"""

from dataclasses import dataclass
from datetime import date, datetime
from decimal import ROUND_HALF_UP, Decimal
from typing import Literal

from calrig.model.calibration import RevisionStatus
from calrig.model.verdict import Answer, Limit

DIGITS = 2


def place_of(uncertainty: float, digits: int = DIGITS) -> int:
    """The power of ten of the last digit that is kept: −3 of 0.0123, 1 of 123; of 0.0996, which is 0.10, −2.

    Raises:
        ValueError: the uncertainty is not a positive number.
    """
    exact = Decimal(repr(float(uncertainty)))
    if not exact.is_finite() or exact <= 0:
        raise ValueError(f"an uncertainty of {uncertainty!r} has no digits")
    place = exact.adjusted() - digits + 1
    return max(place, _at(exact, place).adjusted() - digits + 1)


def rounded(value: float, place: int) -> str:
    """A number rounded to a power of ten, without an exponent; never −0."""
    exact = _at(Decimal(repr(float(value))), place)
    return format(abs(exact) if exact == 0 else exact, "f")


def with_uncertainty(value: float, uncertainty: float | None) -> tuple[str, str | None]:
    """A value and its uncertainty; without one, the value with four digits, and None."""
    if uncertainty is None or not uncertainty > 0.0:
        return by_itself(value, 4), None
    place = place_of(uncertainty)
    return rounded(value, place), rounded(uncertainty, place)


def by_itself(value: float, digits: int = DIGITS) -> str:
    """A number of which no uncertainty is known, to so many digits."""
    return "0" if value == 0.0 else rounded(value, place_of(abs(value), digits))


def _at(exact: Decimal, place: int) -> Decimal:
    """The number rounded to the place; places of 10 and more keep their zeros."""
    return (exact.scaleb(-place).quantize(Decimal(1), ROUND_HALF_UP)).scaleb(place)


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of the budget.

    Attributes:
        type_: A from the scatter of the poses, B from elsewhere.
        freedom: degrees of freedom; infinite of what is known; None where they are not stated.
        std: standard uncertainty of the quantity, in `unit`; of a correlation 0.
        sensitivity: of the elevation, in `sensitivity_unit`.
        share: of the combined variance; of a correlation it may be negative.
    """

    symbol: str
    title: str
    type_: Literal["A", "B"]
    distribution: str
    freedom: float | None
    std: float
    unit: str
    sensitivity: float
    sensitivity_unit: str
    share: float = 0.0

    @property
    def contribution_deg(self) -> float:
        """Standard uncertainty of the elevation from this alone."""
        return abs(self.sensitivity) * self.std


@dataclass(frozen=True, slots=True)
class Budget:
    """The lines, and what they come to; None where it is not known.

    Attributes:
        combined_deg: standard uncertainty u of a calibrated elevation.
        effective_freedom: by Welch and Satterthwaite, all of type A being from one scatter.
        coverage_factor, coverage, expanded_deg: as the document has them.
        method: how they come about, a sentence each.
        not_contained: what has no line, and why.
    """

    contributions: tuple[Contribution, ...]
    combined_deg: float | None
    effective_freedom: float | None
    coverage_factor: float | None
    coverage: float
    expanded_deg: float | None
    method: tuple[str, ...]
    not_contained: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Point:
    """The errors about one elevation, degrees: mean over its poses, and from lowest to highest.

    Attributes:
        found_deg: before: by the calibration that was in force, or as the unit read.
        left_deg: with this calibration.
        expanded_deg: expanded uncertainty of the calibrated elevation; None where it is not known.
    """

    elevation_deg: float
    n_poses: int
    found_deg: float
    found_low_deg: float
    found_high_deg: float
    left_deg: float
    left_low_deg: float
    left_high_deg: float
    expanded_deg: float | None


@dataclass(frozen=True, slots=True)
class Step:
    """The residual of each pose after one correction, degrees, in the order of the poses."""

    title: str
    left_deg: tuple[float, ...]
    rms_deg: float


@dataclass(frozen=True, slots=True)
class Residuals:
    """The residual of each pose, step by step: uncorrected, by bias and scale, then effect by effect.

    `title` says of which poses.
    """

    title: str
    elevation_deg: tuple[float, ...]
    approach: tuple[int, ...]
    steps: tuple[Step, ...]


NOT_STATED = "not stated"

Row = tuple[str, str]
"""What something is called, and what is said of it."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A figure with its unit; what is not known of it is None.

    Attributes:
        name: as the calibration document has it.
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
class CalibrationItem:
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
    """When it was calibrated, when the revision was made and put in force; times are aware, in UTC.

    `measured_by` is the latest time by which it was measured: of imported poses, when they were imported.
    `issued` is when the certificate was; of a preview the time of the revision.
    """

    calibration_began: datetime | None
    calibration_ended: datetime | None
    measured_by: datetime
    revision_made: datetime
    released: datetime | None
    issued: datetime
    calibrate_again: date | None


@dataclass(frozen=True, slots=True)
class Method:
    """By what it was calibrated.

    Attributes:
        program: name and version at the time of the calibration.
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
    certificate: str | None = None
    file: str | None = None
    sha256: str | None = None
    issued_by: str | None = None
    issued_on: date | None = None
    due: date | None = None
    overdue: bool | None = None


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
    """An earlier revision in whose place this one is; `is_same_run`: of the same measurement.

    It says nothing of certificates: one that amends another (7.8.8) names it in `Issue.replaces`.
    """

    revision: int
    sha256: str
    issued: datetime
    is_same_run: bool
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
class Issue:
    """How a certificate is issued.

    Attributes:
        by: None where nobody is known by name.
        replaces: number of the certificate that it corrects, `reason` why.
        trail_seq, trail_sha256: the newest entry of the audit trail, and its hash, which chains all
            before it.
    """

    at: datetime
    by: str | None
    replaces: str | None
    reason: str | None
    trail_seq: int
    trail_sha256: str


@dataclass(frozen=True, slots=True)
class Certificate:
    """Everything a certificate says.

    Attributes:
        number: unique: it has in it a hash of everything else.
        issue: how it is issued; None of a preview.
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
    issue: Issue | None
    kind: Literal["certificate", "demonstration"]
    revision: int
    status: RevisionStatus
    document_sha256: str
    laboratory: Laboratory
    item: CalibrationItem
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
