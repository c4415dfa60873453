"""What is wrong with somebody's input, in the words that the page has for its fields."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel

SHOWN = 3
"""Of several things that are wrong: somebody who mends the first few finds the others."""
LONGEST_PLACE = 200

COMMON = {
    "plan": "Plan",
    "name": "Name",
    "unit": "Unit's serial number",
    "units": "Units",
    "rig": "Rig",
    "stage_at_deg": "Where the stage stands",
    "operator": "Operator",
    "note": "Note",
    "reason": "Reason",
    "file": "File",
    "accel_range_g": "Accelerometer full scale",
    "gyro_range_dps": "Gyro full scale",
    "token": "Token",
}
"""Titles of fields that mean one thing in every body and query; a model's own stand in its `TITLES`."""
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


def in_words(problems: Sequence[Mapping[str, Any]], kind: object = None) -> str:
    """Say what is wrong: the first few fields at fault, each with its reason.

    `kind` is the model that was asked for, or a list of it: its `TITLES` name its fields.
    """
    problems = _choices_together(problems)
    said = [sentence(problem, kind) for problem in problems[:SHOWN]]
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


def sentence(problem: Mapping[str, Any], kind: object = None) -> str:
    """Such as `Elevation 2 is not a number`; arguments as of `in_words`."""
    place = list(problem["loc"])
    titles = _titles_along(kind, place)
    if problem["type"] == "extra_forbidden":
        inside = next((part for part in reversed(place[:-1]) if isinstance(part, str)), None)
        return f"{_quoted(place[-1])} is not known" + (
            f" in {_title(inside, titles).lower()}" if inside else " here"
        )
    predicate = _predicate(problem)
    if predicate is not None:
        return f"{_field(place, titles)} {predicate}"
    said = reason(problem)
    named = any(isinstance(part, str) and part != "plan" for part in place)
    return f"{_field(place, titles)}: {said}" if named else said


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


def _titles_along(kind: object, place: Sequence[str | int]) -> dict[str, str]:
    """Titles of the fields on the way to a place, by the models that they are of."""
    titles = dict(COMMON)
    for part in place:
        models = list(_models_in(kind))
        for model in models:
            titles |= getattr(model, "TITLES", {})
        if isinstance(part, str):
            hints = [model.model_fields[part] for model in models if part in model.model_fields]
            kind = hints[0].annotation if hints else None
    return titles


def _models_in(kind: object) -> Iterator[type[BaseModel]]:
    """The models that an annotation is made of, such as those of a list or of a union."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for part in get_args(kind):
        yield from _models_in(part)


def _field(place: Sequence[str | int], titles: Mapping[str, str]) -> str:
    """The field's name on the page; of a list, which of its entries."""
    names = [k for k, part in enumerate(place) if isinstance(part, str)]
    if not names:
        return f"Limit {place[0] + 1}" if place and isinstance(place[0], int) else "The body"
    last = names[-1]
    name, of = str(place[last]), ""
    if isinstance(place[0], int) and name in titles:
        of = f" of limit {place[0] + 1}"
    inside = [part for part in place[last + 1 :] if isinstance(part, int)]
    if inside and name in ENTRIES:
        return f"{ENTRIES[name]} {inside[0] + 1}{of}"
    if inside:
        return f"Entry {inside[0] + 1} of {_title(name, titles).lower()}{of}"
    return f"{_title(name, titles)}{of}"


def _title(name: str, titles: Mapping[str, str]) -> str:
    return titles.get(name) or _quoted(name)


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
