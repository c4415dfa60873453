"""A certificate's results, errors, budget and conformity, laid out."""

from __future__ import annotations

import math

from calrig.calibration.uncertainty import percent
from calrig.export.certificate.blocks import Block, figure, pairs, paragraphs, table
from calrig.export.certificate.content import NOT_STATED, Certificate, EffectFound, Quantity
from calrig.export.certificate.pose_errors import Point
from calrig.export.certificate.rounding import DIGITS, by_itself, place_of, rounded


def degrees(value: float) -> str:
    """An angle of which no uncertainty is stated, two digits."""
    return f"{_minus(by_itself(value))}°"


def results(said: Certificate) -> tuple[Block, ...]:
    """U, bias and scale, the effects in words, RMS errors."""
    found = said.results
    blocks = [figure(_elevation(said))]
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
        ("Probability of conformity", _probability(found.probability_of_conformity)),
    ]
    if found.answer == "pass":
        rows.append(("Probability of false acceptance", _probability(found.probability_of_false_accept)))
    return pairs(rows), paragraphs(found.says)


def points(said: Certificate) -> tuple[Block, ...]:
    """The errors by elevation."""
    found = said.results
    note = f"As found: {found.found_by}. As left: with this calibration."
    columns = ("Elevation", "Poses", "As found", "from … to", "As left", "from … to", "U")
    rows = [_point(point) for point in found.points]
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
            _freedom(line.freedom),
            f"{by_itself(line.std)}{line.unit}" if line.std else "–",
            _minus(f"{by_itself(line.sensitivity, 3)} {line.sensitivity_unit}") if line.sensitivity else "–",
            f"{by_itself(line.contribution_deg)}°" if line.contribution_deg else "–",
            _minus(f"{100 * line.share:.2f} %"),
        )
        for line in found.contributions
    ]
    numbers = (False, False, False, True, True, True, True, True)
    combined = [
        ("Combined standard uncertainty u", _angle(found.combined_deg)),
        ("Effective degrees of freedom", _freedom(found.effective_freedom)),
        ("Coverage factor k", _factor(found.coverage_factor)),
        ("Coverage probability", f"{100 * found.coverage:g} %"),
        ("Expanded uncertainty U", _angle(found.expanded_deg)),
    ]
    return table(columns, rows, numbers), pairs(combined), paragraphs(found.method + found.not_contained)


def _elevation(said: Certificate) -> str:
    found = said.results.elevation
    if found is None:
        return f"Expanded uncertainty of a calibrated elevation: {NOT_STATED}"
    return (
        f"Expanded uncertainty of a calibrated elevation: U = {found.expanded_text}° "
        f"(k = {_factor(found.coverage_factor)}, {100 * (found.coverage or 0.0):g} %)"
    )


def _line(one: Quantity) -> tuple[str, ...]:
    unit = one.unit
    u = NOT_STATED if one.expanded_text is None else f"{one.expanded_text}{unit}"
    return one.title, f"{_minus(one.text)}{unit}", u, _factor(one.coverage_factor)


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


def _point(point: Point) -> tuple[str, ...]:
    place = -3 if point.expanded_deg is None else place_of(point.expanded_deg, DIGITS)

    def at(value: float) -> str:
        return _minus(rounded(value, place)) + "°"

    return (
        _minus(f"{point.elevation_deg:.4g}") + "°",
        str(point.n_poses),
        at(point.found_deg),
        f"{at(point.found_low_deg)} … {at(point.found_high_deg)}",
        at(point.left_deg),
        f"{at(point.left_low_deg)} … {at(point.left_high_deg)}",
        NOT_STATED if point.expanded_deg is None else at(point.expanded_deg),
    )


def _probability(value: float | None) -> str:
    return NOT_STATED if value is None else percent(value)


def _freedom(value: float | None) -> str:
    if value is None:
        return NOT_STATED
    return "∞" if math.isinf(value) else f"{math.floor(value)}"


def _factor(value: float | None) -> str:
    return NOT_STATED if value is None else f"{value:.2f}"


def _angle(value: float | None) -> str:
    return NOT_STATED if value is None else degrees(value)


def _minus(text: str) -> str:
    """A minus sign as one reads it."""
    return text.replace("-", "−")
