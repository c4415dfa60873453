"""Files of poses and logs as people, spreadsheets and broken disks leave them; and what they really hold."""

from __future__ import annotations

import csv
import io
import random
from collections.abc import Callable

from calrig.calibration.poses import COLUMNS

Grid = list[list[str]]
Change = Callable[[random.Random, Grid], None]

ODD_CELLS = (
    "", " ", "nan", "NaN", "NA", "null", "-nan", "inf", "-Infinity", "1e400", "1e-400", "1e30", "1.1e30",
    "9" * 400, "0." + "0" * 300 + "1", "1_000", "1,5", "0x10", "１２",
    "٣", "+.5", "5.", ".", "e5", "1e", "--1",
    "=1+1", "-0.0", "4.9e-324", "TRUE", "é", "\x00", "\x1b[31m", "\u202e", "😀", "\t1", "1 ", "1\n2",
    '"', '""', "'1", "1;2", "#", "0.1" + "0" * 60 + "1", "9007199254740993", "1.7976931348623157e308",
)  # fmt: skip
ODD_NAMES = (
    "", " ", "target_deg", "reading_deg", "time_s", "pass", "Reading_deg", "humidity", "humidity ", "=cmd()",
    "'=cmd()", "+5V", "-x", "@x", "a" * 101, "é", "\u202ex",
    "a,b", 'a"b', "a\nb", "1.5", "😀", "\ufefftarget_deg", "_crc32",
)  # fmt: skip
LOG_COLUMNS = (
    "time_s", "accel_x_g", "accel_y_g", "accel_z_g", "gyro_x_dps", "gyro_y_dps", "gyro_z_dps",
    "temperature_c",
)  # fmt: skip


def damaged_poses(rng: random.Random) -> bytes:
    """A file of poses with none, one or several things changed."""
    names = ["target_deg", "reading_deg"]
    names += rng.sample(COLUMNS[2:], rng.randrange(6)) + rng.sample(
        ("humidity", "supply_v", "note"), rng.randrange(3)
    )
    return _damaged(rng, names)


def damaged_log(rng: random.Random) -> bytes:
    """A log of samples, likewise."""
    return _damaged(
        rng, [*rng.sample(LOG_COLUMNS, rng.randrange(1, 8)), *rng.sample(("lux", "note"), rng.randrange(2))]
    )


def rows_of(data: bytes) -> tuple[list[str], list[list[float | str | None]]]:
    """The names and the cells that a file holds: numbers, None where not known, text where it is text.

    Cells are apart by the mark of which the names hold most. A name that begins with quotes and a sign is
    written so against spreadsheets: one quote is not part of it.
    """
    text = data.decode("utf-8-sig")
    names = next((line for line in text.splitlines() if line.strip()), "")
    mark = max(",;\t", key=names.count)
    lines = [row for row in csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=mark) if row]
    header = [_name(name.strip()) for name in lines[0]]
    return header, [[_value(cell.strip()) for cell in row] for row in lines[1:]]


def _name(text: str) -> str:
    is_quoted = text.startswith("'") and text.lstrip("'")[:1] in {*"=+-@＝＋－＠"}
    return text[1:] if is_quoted else text


def _value(text: str) -> float | str | None:
    if text.lower() in {"", "nan", "na", "n/a", "null", "none"}:
        return None
    try:
        return float(text)
    except ValueError:
        return text


def _damaged(rng: random.Random, names: list[str]) -> bytes:
    grid = [
        names,
        *([_cell(rng, name, k) for name in names] for k in range(rng.choice((0, 1, 2, 5, 5, 12, 12, 40)))),
    ]
    for _ in range(rng.choice((0, 0, 0, 1, 1, 2, 4))):
        rng.choice(CHANGES)(rng, grid)
    text = _written(rng, grid)
    encoding = rng.choices(("utf-8", "utf-8-sig", "utf-16", "latin-1"), (80, 15, 2, 3))[0]
    data = text.encode(encoding, "replace")
    return rng.choice(BREAKAGES)(rng, data) if rng.random() < 0.2 else data


def _cell(rng: random.Random, name: str, row: int) -> str:
    if name == "time_s":
        return repr(row * 2.5 + rng.random())
    if name in {"pass", "n_samples"}:
        return str(rng.randrange(1000))
    if name == "approach":
        return rng.choice(("-1", "0", "1", "1.0", "+1"))
    value = rng.choice(
        (rng.gauss(0, 40), rng.gauss(0, 1e-6), float(rng.randrange(-60, 61)), rng.gauss(0, 1e9))
    )
    return rng.choice((repr, "{:.3f}".format, "{:e}".format, "{:+.17g}".format, " {} ".format))(value)


def _written(rng: random.Random, grid: Grid) -> str:
    """With a spreadsheet's line ends, quotes, blank lines and, at times, another separator."""
    text = io.StringIO()
    writer = csv.writer(
        text,
        delimiter=rng.choices(",;\t", (98, 1, 1))[0],
        quoting=rng.choices((csv.QUOTE_MINIMAL, csv.QUOTE_ALL), (80, 20))[0],
        lineterminator=rng.choice(("\n", "\r\n", "\n", "\r", "\n\n")),
    )
    writer.writerows(grid)
    written = text.getvalue()
    if rng.random() < 0.1:
        written = rng.choice(("\n", "\r\n\r\n", " ")) + written
    return written.rstrip("\r\n") if rng.random() < 0.3 else written


def _row(rng: random.Random, grid: Grid) -> list[str]:
    return rng.choice(grid[1:] or grid)


def _odd_cell(rng: random.Random, grid: Grid) -> None:
    row = _row(rng, grid)
    row[rng.randrange(len(row)) if row else 0 :][:1] = []
    row.insert(rng.randrange(len(row) + 1), rng.choice(ODD_CELLS))


def _odd_name(rng: random.Random, grid: Grid) -> None:
    name = rng.choice(ODD_NAMES)
    if rng.random() < 0.5:  # a column more
        at = rng.randrange(len(grid[0]) + 1)
        for k, row in enumerate(grid):
            row.insert(at, name if k == 0 else rng.choice(("1.5", "", "-2")))
    elif grid[0]:
        grid[0][rng.randrange(len(grid[0]))] = name


def _drop_cell(rng: random.Random, grid: Grid) -> None:
    row = _row(rng, grid)
    if row:
        del row[rng.randrange(len(row))]


def _double_cell(rng: random.Random, grid: Grid) -> None:
    row = _row(rng, grid)
    row.append(row[0] if row else "1")


def _drop_row(rng: random.Random, grid: Grid) -> None:
    if len(grid) > 1:
        del grid[rng.randrange(len(grid))]


def _double_row(rng: random.Random, grid: Grid) -> None:
    at = rng.randrange(len(grid))
    grid.insert(at, list(grid[at]))


def _shuffle_rows(rng: random.Random, grid: Grid) -> None:
    rows = grid[1:]
    rng.shuffle(rows)
    grid[1:] = rows


def _shuffle_columns(rng: random.Random, grid: Grid) -> None:
    width = min(len(row) for row in grid)
    order = rng.sample(range(width), width)
    grid[:] = [[row[place] for place in order] + row[width:] for row in grid]


def _empty_column(rng: random.Random, grid: Grid) -> None:
    place = rng.randrange(len(grid[0])) if grid[0] else 0
    for row in grid[1:]:
        row[place : place + 1] = [""]


def _blank_rows(rng: random.Random, grid: Grid) -> None:
    grid.insert(rng.randrange(1, len(grid) + 1), rng.choice(([], [""], [" "], [""] * len(grid[0]))))


CHANGES: tuple[Change, ...] = (
    _odd_cell, _odd_cell, _odd_name, _drop_cell, _double_cell, _drop_row, _double_row, _shuffle_rows,
    _shuffle_columns, _empty_column, _blank_rows,
)  # fmt: skip


def _cut(rng: random.Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _without(rng: random.Random, data: bytes) -> bytes:
    first = rng.randrange(len(data) + 1)
    return data[:first] + data[first + rng.randrange(20) :]


def _twice(rng: random.Random, data: bytes) -> bytes:
    first = rng.randrange(len(data) + 1)
    return data + data[first:]


def _with_bytes(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return (
        data[:at]
        + rng.choice((b"\0", b"\xff", b'"', b"\r", b"\n", b",", b"\xef\xbb\xbf", b"\x1a"))
        + data[at:]
    )


def _flipped(rng: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _noise(rng: random.Random, data: bytes) -> bytes:
    return rng.randbytes(rng.randrange(200))


BREAKAGES = (_cut, _cut, _without, _twice, _with_bytes, _with_bytes, _flipped, _flipped, _noise)
