"""Tables as people write them: what has one reading gives the arrays of the plain file, and says so."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest

from calrig.export import static_csv
from calrig.export.csv_errors import CsvError
from calrig.export.poses_csv import read_run
from calrig.export.static_csv import read_static

POSES = ("target_deg", "reading_deg", "time_s", "temperature_c", "accel_y_g", "pass", "supply_v")
LOG = ("time_s", "accel_x_g", "accel_y_g", "accel_z_g", "gyro_x_dps", "temperature_c")
UNITS = {"deg": "°", "s": "s", "c": "°C", "g": "g", "dps": "deg/s", "v": "V"}
EPOCH = np.datetime64("2024-02-29T23:59:50")


class Sheet:
    """Rows of text cells under names, which decorations change; lines above and between rows."""

    def __init__(self, names, rows):
        self.names = list(names)
        self.rows = [list(row) for row in rows]
        self.above: list[str] = []
        self.units: list[str] = []
        self.comments: dict[int, str] = {}
        self.separator, self.decimal = ",", "."

    def each(self, names, change):
        for row in self.rows:
            for place, name in enumerate(self.plain):
                if name in names and row[place] not in {"", "nan"}:
                    row[place] = change(row[place])

    @property
    def plain(self):
        return POSES if len(self.names) == len(POSES) else LOG

    def text(self):
        rows = [[cell.replace(".", self.decimal) for cell in row] for row in self.rows]
        lines = [self.separator.join(row) for row in rows]
        for place in sorted(self.comments, reverse=True):
            lines.insert(place, self.comments[place])
        head = [*self.above, self.separator.join(self.names)]
        head += [self.separator.join(self.units)] if self.units else []
        return "\n".join([*head, *lines, ""]).encode()


def unit_of(name):
    return UNITS.get(name.rpartition("_")[2], "")


def bare(name):
    return name.rpartition("_")[0] if unit_of(name) and name != "supply_v" else name


def units_row(sheet):
    sheet.units = [unit_of(name) for name in sheet.plain]


def bare_names_over_units(sheet):
    units_row(sheet)
    sheet.names = [bare(name) for name in sheet.plain]


def capitals(sheet):
    sheet.names = [name if name == "supply_v" else name.upper() for name in sheet.names]


def brackets(sheet):
    sheet.names = [name if bare(name) == name else f"{bare(name)} [{unit_of(name)}]" for name in sheet.plain]


def parentheses(sheet):
    sheet.names = [
        f"{bare(name).title()} ({name.rpartition('_')[2]})" if bare(name) != name else name
        for name in sheet.plain
    ]


def blanks(sheet):
    sheet.names = [
        name.replace("_", " ").capitalize() if bare(name) != name else name for name in sheet.plain
    ]


def comments(sheet):
    sheet.above += ['# bench 3, by hand; "zero" set at 10:00', "#", "# 1,5;2,5"]
    sheet.comments[2] = "# remounted, said M."


def spaces_and_degrees(sheet):
    sheet.each({"target_deg", "gyro_x_dps"}, lambda cell: cell + ("°" if sheet.plain is POSES else " deg/s"))
    sheet.each({"reading_deg"}, lambda cell: cell + " deg")
    sheet.each({"temperature_c"}, lambda cell: cell + " °C")


def not_available(sheet):
    for row in sheet.rows:
        row[:] = ["#N/A" if cell == "nan" else cell for cell in row]


def typographic_minus(sheet):
    sheet.each({"reading_deg", "accel_y_g"}, lambda cell: cell.replace("-", "−"))


def iso_times(sheet):
    def stamp(cell):
        return str(EPOCH + np.timedelta64(round(float(cell) * 1000), "ms")) + "+02:00"

    sheet.each({"time_s"}, stamp)


def semicolons(sheet):
    sheet.separator = ";"


def decimal_commas(sheet):
    sheet.separator, sheet.decimal = ";", ","


def crlf_free_tabs(sheet):
    sheet.separator = "\t"


NAMES = [capitals, brackets, parentheses, blanks, bare_names_over_units]
OTHERS = [
    units_row, comments, spaces_and_degrees, not_available, typographic_minus, iso_times, semicolons,
    decimal_commas, crlf_free_tabs,
]  # fmt: skip
EVERY = [*NAMES, *OTHERS]
TOGETHER = [
    pair
    for pair in itertools.combinations(EVERY, 2)
    if not set(pair) <= set(NAMES)
    and pair not in {(bare_names_over_units, units_row)}
    and not {iso_times, decimal_commas} <= set(pair)  # the comma of a time is its own
]


def sheet_of(names, seed):
    draw = np.random.default_rng(seed)
    rows = []
    for k in range(int(draw.integers(3, 12))):
        row = {name: f"{draw.normal(0.0, 20.0):.4f}" for name in names}
        row |= {"time_s": f"{0.25 * k:.2f}", "pass": str(k), "temperature_c": f"{20.5 + k:.1f}"}
        if k == 2:
            row["temperature_c"] = "nan"
        rows.append([row[name] for name in names])
    return Sheet(names, rows)


def read_poses(data):
    poses, _, said = read_run(data, "A")
    return {name: poses.cells(name) for name in ["pass", *POSES]}, said


def read_log(data):
    log = read_static(data)
    return {**log.channels, "time_s": log.time_s}, list(log.warnings)


def same(found, plain):
    assert found.keys() == plain.keys()
    for name in plain:
        values = [np.array(one[name], dtype=np.float64) for one in (found, plain)]
        np.testing.assert_allclose(*values, rtol=0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(("names", "read"), [(POSES, read_poses), (LOG, read_log)], ids=["poses", "log"])
@pytest.mark.parametrize(
    "decorations", [*((one,) for one in EVERY), *TOGETHER], ids=lambda d: "+".join(x.__name__ for x in d)
)
def test_decorated_tables_give_the_arrays_of_the_plain_one(names, read, decorations, monkeypatch):
    monkeypatch.setattr(static_csv, "PIECE_BYTES", 120)
    for seed in range(3):
        plain, nothing = read(sheet_of(names, seed).text())
        assert nothing == []
        sheet = sheet_of(names, seed)
        for change in decorations:
            change(sheet)
        found, said = read(sheet.text())
        same(found, plain)
        silent = {semicolons, decimal_commas, crlf_free_tabs}
        changed = sheet.text() != sheet_of(names, seed).text() and not set(decorations) <= silent
        assert bool(said) == changed, (said, sheet.text())
        assert len(said) <= 4
