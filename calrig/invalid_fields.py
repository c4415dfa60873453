"""What is wrong with somebody's input, in the words that the page has for its fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SHOWN = 3
"""Of several things that are wrong: somebody who mends the first few finds the others."""
LONGEST_PLACE = 200

TITLES = {
    # of a plan and of what starts a run
    "start_deg": "From",
    "stop_deg": "To",
    "step_deg": "Step",
    "elevations_deg": "Elevations",
    "order": "Order",
    "sweeps": "Sweeps",
    "settle_s": "Settling time",
    "dwell_s": "Dwell time",
    "jitter_deg": "Jitter of each elevation",
    "rate_hz": "Sample rate",
    "target_std_deg": "Dwell until standard error",
    "velocity_dps": "Stage velocity",
    "wait_s": "Wait before each sweep",
    "wait_temperature_c": "Wait for temperature",
    "seed": "Seed",
    "plan": "Plan",
    "unit": "Unit's serial number",
    "rig": "Rig",
    "stage_at_deg": "Where the stage stands",
    "operator": "Operator",
    "note": "Note",
    "reason": "Reason",
    "file": "File",
    "accel_range_g": "Accelerometer full scale",
    "gyro_range_dps": "Gyro full scale",
    "token": "Token",
    # of how a unit came
    "customer": "Customer",
    "address": "Customer's address",
    "received_at": "Date of receipt",
    "condition": "Condition at receipt",
    "description": "Description",
    "interval_agreed_months": "Months until the next calibration",
    # of a limit
    "name": "Name",
    "units": "Units",
    "max_error_deg": "Largest error",
    "bias_deg": "Bias",
    "scale": "Scale",
    "rms_deg": "RMS error",
    "expanded_uncertainty_deg": "Stop at expanded uncertainty",
    "rule": "Rule",
    "guard": "Guard",
}
ENTRIES = {"elevations_deg": "Elevation", "effects": "Effect", "runs": "Run", "hosts": "Host"}
"""One of several, by the name of the list."""

_REASONS: dict[str, str] = {
    "float_type": "is not a number",
    "float_parsing": "is not a number",
    "finite_number": "is not a finite number",
    "int_type": "is not a whole number",
    "int_parsing": "is not a whole number",
    "int_parsing_size": "is too large",
    "int_from_float": "is not a whole number",
    "bool_type": "is neither true nor false",
    "bool_parsing": "is neither true nor false",
    "string_type": "is not a text",
    "string_unicode": "is not a text",
    "list_type": "is not a list",
    "tuple_type": "is not a list",
    "dict_type": "is not an object",
    "model_type": "is not an object",
    "model_attributes_type": "is not an object",
    "missing": "is missing",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "string_too_long": "has more than {max_length} characters",
    "too_short": "has {actual_length} entries, fewer than {min_length}",
    "too_long": "has more than {max_length} entries",
    "literal_error": "is none of {expected}",
    "datetime_parsing": "is not a time (ISO 8601)",
    "datetime_from_date_parsing": "is not a time (ISO 8601)",
}


def in_words(problems: Sequence[Mapping[str, Any]]) -> str:
    """What is wrong: the first few fields at fault, each with its reason; problems as pydantic gives them."""
    problems = _choices_together(problems)
    said = [sentence(problem) for problem in problems[:SHOWN]]
    more = len(problems) - len(said)
    return "; ".join([*said, f"and {more} more"] if more > 0 else said)


def _choices_together(problems: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of a field that takes the words of several lists pydantic says each list's failure: here it is one."""
    told: list[Mapping[str, Any]] = []
    for problem in problems:
        *place, last = problem["loc"] or ("",)
        if problem["type"] == "literal_error" and str(last).startswith("literal["):
            choices = problem["ctx"]["expected"].replace(" or ", ", ")
            if told and told[-1]["type"] == "literal_error" and told[-1]["loc"] == place:
                choices = f"{told.pop()['ctx']['expected']}, {choices}"
            told.append({**problem, "loc": place, "ctx": {"expected": choices}})
        else:
            told.append(problem)
    return told


def sentence(problem: Mapping[str, Any]) -> str:
    """Such as `Elevation 2 is not a number`."""
    place = list(problem["loc"])
    if problem["type"] == "extra_forbidden":
        inside = next((part for part in reversed(place[:-1]) if isinstance(part, str)), None)
        return f"{_quoted(place[-1])} is not known" + (f" in {_title(inside).lower()}" if inside else " here")
    predicate = _predicate(problem)
    if predicate is not None:
        return f"{_field(place)} {predicate}"
    said = reason(problem)
    named = any(isinstance(part, str) and part != "plan" for part in place)
    return f"{_field(place)}: {said}" if named else said


def reason(problem: Mapping[str, Any]) -> str:
    """What is wrong, without saying of what: `is not a number`."""
    if problem["type"] == "extra_forbidden":
        return "is not known here"
    return _predicate(problem) or str(problem["msg"]).removeprefix("Value error, ")


def _predicate(problem: Mapping[str, Any]) -> str | None:
    kind, context = problem["type"], problem.get("ctx") or {}
    if kind == "string_too_short":
        least = context["min_length"]
        return "is empty" if least == 1 else f"has fewer than {least} characters"
    words = _REASONS.get(kind)
    return None if words is None else words.format(**context)


def path_of(problem: Mapping[str, Any]) -> str:
    """Where it stands in the JSON, such as `plan.elevations_deg[1]`."""
    path = ""
    for part in problem["loc"]:
        path += f"[{part}]" if isinstance(part, int) else f"{'.' if path else ''}{part}"
    return path if len(path) <= LONGEST_PLACE else path[:LONGEST_PLACE] + "…"


def _field(place: Sequence[str | int]) -> str:
    """The field's name on the page; of a list, which of its entries."""
    names = [k for k, part in enumerate(place) if isinstance(part, str)]
    if not names:
        return f"Limit {place[0] + 1}" if place and isinstance(place[0], int) else "The body"
    last = names[-1]
    name, of = str(place[last]), ""
    if isinstance(place[0], int) and name in TITLES:
        of = f" of limit {place[0] + 1}"
    inside = [part for part in place[last + 1 :] if isinstance(part, int)]
    if inside and name in ENTRIES:
        return f"{ENTRIES[name]} {inside[0] + 1}{of}"
    if inside:
        return f"Entry {inside[0] + 1} of {_title(name).lower()}{of}"
    return f"{_title(name)}{of}"


def _title(name: str) -> str:
    return TITLES.get(name) or _quoted(name)


def _quoted(name: object) -> str:
    shown = str(name)
    return f"“{shown if len(shown) <= LONGEST_PLACE else shown[:LONGEST_PLACE] + '…'}”"


def first_problem(problem: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    """What pydantic says of a configuration, by the names of what it is in."""
    place: list[str] = []
    node: Any = document
    for part in problem["loc"]:
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            node = None
        if isinstance(part, int) and isinstance(node, dict) and "name" in node:
            place[-1] = f"{place[-1]} {node['name']!r}"
        else:
            place.append(str(part))
    return f"{', '.join(place) or 'file'}: {problem['msg'].removeprefix('Value error, ')}"
