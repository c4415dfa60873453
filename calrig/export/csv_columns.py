"""Columns of a CSV file by the contract's names (CONTRACT section 4), however people write these.

`Target_deg`, `target [°]`, `Target deg` and `target` over a row of units are all `target_deg`. A name that is
not clearly one of these stays a column of its own; two columns that would be one are refused.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from calrig.export.csv_errors import CsvError, shortened
from calrig.export.csv_units import Unit, conversion, stem_and_unit, unit_of_text

MOST_NAMED = 30
MAX_COLUMNS = 200
MAX_NAME_CHARACTERS = 100
DID_YOU_MEAN = "did you mean"
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""A decimal number; unlike `float`, neither `1_000` nor digits of other scripts."""
_DATA = re.compile(r"[+\-−]?[0-9][0-9.,:/eETZ+\- ]*°?|[+\-−]?\.[0-9]+")
"""A number or a time, which is no name of a column."""
_MEANINGS = {
    "target_deg": "the angle of the reference, commanded or measured",
    "reading_deg": "the angle that the unit reads",
}
"""What to rename where a file lacks one of these."""


@dataclass(slots=True)
class Column:
    """A column of a file.

    Attributes:
        text: what the header calls it.
        name: what it is read as; the text where that is no name of the contract.
        unit: what its numbers are in, where known.
        factor: with `offset`, what takes a number to the unit of the name.
        is_known: whether the name is one of those looked for.
        is_clock: whether its cells are times of day (ISO 8601), read as seconds since the first.
        first: the first of these, once read.
        decimal: the decimal sign of its cells where that is not the file's; empty where it is.
    """

    text: str
    name: str
    unit: Unit | None = None
    factor: float = 1.0
    offset: float = 0.0
    is_known: bool = False
    is_clock: bool = False
    first: datetime | None = None
    decimal: str = ""

    @property
    def is_converted(self) -> bool:
        """Whether its numbers are in another unit than its name says."""
        return (self.factor, self.offset) != (1.0, 0.0)

    @property
    def is_text(self) -> bool:
        """Whether a cell may be any text."""
        return not self.is_known or self.name in {"unit", "mount", "mount_axis", "reference_kind"}


_BRACKETS = re.compile(r"(.+?)[\s_]*[\[(]\s*([^\[\]()]+?)\s*[\])]")
_SLASH = re.compile(r"([^/]+?)\s*/\s*(\S.*)")
_LAST_WORD = re.compile(r"(.+)\s+(\S+)")
_SUFFIX = re.compile(r"(.+)_([^_]+)")
_CLOCKS = frozenset(
    {"time", "timestamp", "datetime", "date_time", "time_utc", "timestamp_utc", "datetime_utc"}
)
_NO_UNITS = frozenset({"-", "–"})
_CLOCK_UNITS = frozenset({"utc", "iso", "iso8601", "iso 8601", "local"})
CLOCK_NAMES = ("time_s", "host_time_s")


def normalised(text: str) -> str:
    """Return a name in the contract's way: small letters with `_` between words."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text.strip())
    return re.sub(r"[\s\-._]+", "_", words).strip("_").lower()


def columns_of(
    texts: Sequence[str],
    units: Sequence[str] | None,
    known: Collection[str],
    required: Collection[str],
    line: int,
) -> list[Column]:
    """Return each column under the name that it is read as.

    `temperature_k` stays a column of its own, but `target_rad` and `time_ms` are converted: nothing else is
    in their place. `time_min` may be the least time.

    `units` are the cells of a row of units under the header; None without such a row.

    Raises:
        CsvError: a name states one unit, and brackets or the row of units another.
    """
    try:
        columns = [
            _column(text, "" if units is None else units[place].strip(), known)
            for place, text in enumerate(texts)
        ]
    except CsvError as error:
        raise CsvError(error.what, line=line, column=error.column) from error
    for place, column in enumerate(columns):
        suffix = _SUFFIX.fullmatch(normalised(column.text))
        unit = None if suffix is None or column.is_known else unit_of_text(suffix[2])
        absent = {*required, *CLOCK_NAMES}.intersection(known) - {one.name for one in columns}
        if suffix is not None and unit is not None and suffix[2] != "min":
            columns[place] = _known_by(column.text, suffix[1], unit, absent) or column
    return columns


def _column(text: str, unit_text: str, known: Collection[str]) -> Column:
    unit = unit_of_text(unit_text)
    ways = [(text, unit)] if text in known else [(normalised(text), unit), *_with_units(text)]
    for stem, stated in ways:
        found = _known_by(text, stem, stated, known)
        if found is None:
            continue
        bare = unit_text.strip("-–[]() ").lower()
        if (
            found.unit not in {None, unit}
            and bare
            and not (bare in _CLOCK_UNITS and found.name in CLOCK_NAMES)
        ):
            what = f"the row of units has {shortened(unit_text)!r} where {found.unit} was expected"
            raise CsvError(what, column=text)
        return found
    return Column(text, text, unit or stem_and_unit(normalised(text))[1])


def _with_units(text: str) -> list[tuple[str, Unit | None]]:
    """The name and the unit that a text may be made of."""
    found: list[tuple[str, Unit | None]] = []
    for pattern in (_BRACKETS, _SLASH, _LAST_WORD):
        parts = pattern.fullmatch(text)
        if parts is None:
            continue
        stem, unit = normalised(parts[1]), unit_of_text(parts[2])
        own = stem_and_unit(stem)[1]
        if pattern is not _BRACKETS and (unit is None or own not in {None, unit}):
            continue  # `reading_deg min` and `temperature_c/min` are other things
        if unit is not None or parts[2] in _NO_UNITS:
            found.append((stem, unit))
    return found


def _known_by(text: str, stem: str, stated: Unit | None, known: Collection[str]) -> Column | None:
    """The column as one of the known ones, or None."""
    has_unit = stated is None or stem not in known or stem_and_unit(stem)[1] is not None
    if not (has_unit or stated is None or stated.quantity == "counts" or _of_stem(stem, stated, known)):
        return None  # `pass [V]`
    if stem in known and (stated is None or stem_and_unit(stem)[1] in {stated, None}):
        unit = stem_and_unit(stem)[1]
        if unit is not None or stated is None or not _of_stem(stem, stated, known):
            return Column(text, stem, unit, is_known=True)
    if stated is None:
        return None
    if stem in known and (own := stem_and_unit(stem)[1]) is not None:
        raise CsvError(f"its name says {own}, and brackets or the row of units say {stated}", column=text)
    for name, wanted in _of_stem(stem, stated, known):
        if (linear := conversion(stated, wanted)) is not None:
            return Column(text, name, stated, *linear, is_known=True)
    return None


def _of_stem(stem: str, stated: Unit, known: Collection[str]) -> list[tuple[str, Unit]]:
    """Known names of a stem that a unit can be converted to, those of the same unit first."""
    pairs = ((name, *stem_and_unit(name)) for name in known)
    fit = [(name, unit) for name, own, unit in pairs if own == stem and unit is not None]
    return sorted(
        (pair for pair in fit if pair[1].quantity == stated.quantity), key=lambda pair: pair[1] != stated
    )


def names_a_known(text: str, known: Collection[str]) -> bool:
    """Return whether a name is a known one, in whatever way it is written, or lacks only the unit."""
    if text in known:
        return True
    try:
        column = _column(text, "", known)
    except CsvError:
        return True
    return column.is_known or normalised(text) in {stem_and_unit(name)[0] for name in known}


def clock_name(text: str, known: Collection[str]) -> bool:
    """Return whether a column of such a name is `time_s`, if its cells are times of day."""
    parts = _BRACKETS.fullmatch(text)
    bare = parts[1] if parts is not None and parts[2].lower() in _CLOCK_UNITS else text
    return "time_s" in known and normalised(bare) in _CLOCKS


SAVE_WITH = "save the file with commas, semicolons or tabs"
NO_NAMES = "the first line holds numbers, and the column names must come before it"


def why_no_names(texts: Sequence[str]) -> str:
    """Return why texts that stand for names are none."""
    if not are_data(texts):
        return f"a name has at most {MAX_NAME_CHARACTERS} characters, all printable"
    numbers = texts[0].split() if len(texts) == 1 else []
    has_spaces = len(numbers) > 1 and all(map(NUMBER.fullmatch, numbers))
    return f"{NO_NAMES}; spaces separate the numbers: {SAVE_WITH}" if has_spaces else NO_NAMES


def refuse_bad_names(columns: Sequence[Column], line: int) -> None:
    """Refuse names that are not printable, and columns that would be one.

    Raises:
        CsvError: at the first such column.
    """
    seen: dict[str, str] = {}
    for column in columns:
        if len(column.text) > MAX_NAME_CHARACTERS or not column.text.isprintable():
            raise CsvError(why_no_names([one.text for one in columns]), line=line, column=column.text)
        if not column.name:
            continue
        if (first := seen.get(column.name)) is None:
            seen[column.name] = column.text
        elif first == column.text:
            is_data = are_data([column.text for column in columns])
            what = NO_NAMES if is_data else "the header has this name twice"
            raise CsvError(what, line=line, column=column.text)
        else:
            what = f"is {column.name}, and so is column {shortened(first)}: keep one of them"
            raise CsvError(what, line=line, column=column.text)


def missing_columns(
    columns: Sequence[Column], required: Sequence[str], line: int, why: str = "", below: int | None = None
) -> list[CsvError]:
    """Return what is to be said of each required column that is not there, with the nearest one that is.

    Further down the line `below` may have the names.
    """
    names = {column.name for column in columns}
    absent = [name for name in required if name not in names]
    own = [column.text for column in columns if not column.is_known and column.text]
    found = []
    for name in absent:
        near = next((text for text in own if _misspelling(text, name) <= len(name) // 3), None)
        hint = "" if near is None else f"; {shortened(near)}: {DID_YOU_MEAN} {_with_unit(name, near)}?"
        means = f" ({_MEANINGS[name]})" if name in _MEANINGS and near is None else ""
        found.append(CsvError(f"there is no such column{means}{why}{hint}", line=line, column=name))
    if found:
        texts, last = [column.text for column in columns], found[-1]
        is_data = are_data(texts) and not any(column.is_known for column in columns)
        end = f": {why_no_names(texts)}" if is_data else f"; {there_are(texts)}"
        if len(texts) == 1 and not {*required}.isdisjoint(texts[0].split()):
            end = f"; spaces separate the names: {SAVE_WITH}"
        elif below is not None:
            end = f"; {there_are(texts)}; or the names are in line {below}: leave out the lines before it"
        found[-1] = CsvError(f"{last.what}{end}", line=line, column=last.column)
    return found


def are_data(cells: Sequence[str]) -> bool:
    """Return whether most cells of a line are numbers or times, and no names of columns."""
    return 2 * sum(_DATA.fullmatch(cell.strip()) is not None for cell in cells) > len(cells)


def header_notes(columns: Sequence[Column], known: Collection[str]) -> list[str]:
    """Return what is to be said of how names were read, a line a kind."""
    renamed = [
        f"{shortened(column.text)!r} as {column.name}"
        + (f" (converted from {column.unit.symbol})" if column.is_converted and column.unit else "")
        + (" (ISO 8601, as seconds since the first)" if column.is_clock else "")
        for column in columns
        if column.is_known and (column.name != column.text or column.is_clock)
    ]
    notes = [f"columns are read: {', '.join(renamed)}"] if renamed else []
    own = [shortened(column.text) for column in columns if column.decimal]
    if own:
        notes.append(f"another decimal sign than in the other columns is read in: {', '.join(own)}")
    missing = [name for name in known if name not in {column.name for column in columns}]
    near = [
        f"{shortened(column.text)} ({DID_YOU_MEAN} {_with_unit(name, column.text)}?)"
        for column in columns
        if not column.is_known and (name := _nearest(column.text, missing)) is not None
    ]
    return [*notes, *([f"columns of their own: {', '.join(near)}"] if near else [])]


def _nearest(text: str, names: Sequence[str]) -> str | None:
    """The one of some names that a text nearly is, None if none."""
    away = {name: _misspelling(text, name) for name in names if len(name) >= 6}
    name = min(away, key=away.__getitem__, default=None)
    return None if name is None or away[name] > 2 else name


def _with_unit(name: str, text: str) -> str:
    """A name, and its unit where a text like it does not end in that."""
    stem, unit = stem_and_unit(name)
    return name if unit is None or normalised(text).endswith(name[len(stem) :]) else f"{name}, in {unit}"


def _misspelling(text: str, name: str) -> int:
    """How many letters a text is away from a name; 0 if only the unit is missing, or in brackets.

    Of an axis, `ax_g` and `x (g)` are 0 away from `accel_x_g`. Another digit is another sensor, and far away.
    """
    written = _BRACKETS.fullmatch(text)
    bare = normalised(text if written is None else written[1])
    short, unit = stem_and_unit(bare)
    if written is not None:
        unit = unit_of_text(written[2])
    stem, unit_of_name = stem_and_unit(name)
    is_axis = stem[-2:] in {"_x", "_y", "_z"} and unit in {None, unit_of_name}
    is_alone = unit is not None and short == stem[-1]
    if bare in {name, stem} or (is_axis and (is_alone or _abbreviates(short, stem))):
        return 0
    has_other_digits = re.sub(r"\D", "", bare) != re.sub(r"\D", "", name)
    return len(name) if has_other_digits or abs(len(bare) - len(name)) > 3 else _distance(bare, name)


def _abbreviates(short: str, stem: str) -> bool:
    """Whether a text has some of a name's letters in their order, the first and the last among them."""
    letters = iter(stem)
    ends = len(short) > 1 and (short[0], short[-1]) == (stem[0], stem[-1])
    return ends and all(letter in letters for letter in short)


def _distance(a: str, b: str) -> int:
    """Letters put in, left out, changed or swapped with the next one (optimal string alignment)."""
    before: list[int] = []
    last = list(range(len(b) + 1))
    for i, letter in enumerate(a, 1):
        row = [i]
        for j, other in enumerate(b, 1):
            cost = min(last[j] + 1, row[j - 1] + 1, last[j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == b[j - 2] and a[i - 2] == other:
                cost = min(cost, before[j - 2] + 1)
            row.append(cost)
        before, last = last, row
    return last[-1]


def there_are(names: Sequence[str] | Mapping[str, object]) -> str:
    """Return the columns that a file has, in so many words as a message bears."""
    texts = [shortened(name) for name in names]
    shown = ", ".join(name for name in texts[:MOST_NAMED] if name) or "none with a name"
    more = f" and {len(texts) - MOST_NAMED} more" if len(texts) > MOST_NAMED else ""
    return f"there are: {shown}{more} (calrig/docs/reference/file-formats.md lists the columns)"


_DECIMALS = {
    sign: re.compile(
        rf"[+\-−]?(?:[0-9]*{re.escape(sign)}(?![0-9]{{3}}(?![0-9]))|0{re.escape(sign)})[0-9]+\D{{0,6}}"
    )
    for sign in ",."
}
"""Numbers with a decimal sign that cannot be one of thousands."""


def own_decimal(cells: Sequence[str], decimal: str) -> str:
    """Return the other decimal sign where a column has no other, and no cell may mean thousands; else ''."""
    other = "," if decimal == "." else "."
    with_it = [cell for cell in cells if other in cell]
    is_other = with_it and not any(decimal in cell for cell in cells)
    return other if is_other and all(map(_DECIMALS[other].fullmatch, with_it)) else ""
