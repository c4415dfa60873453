"""What commands read and print: too large a file is refused, foreign text does nothing to a terminal."""

from __future__ import annotations

import json
import resource
from importlib.resources import files
from pathlib import Path

import pytest
from command_line import calrig, reason

from calrig.calibration.poses import COLUMNS
from calrig.cli import output
from calrig.cli.input_files import read_plan_file
from calrig.cli.output import print_table
from calrig.client import Result, RunRecord
from calrig.errors import printable
from calrig.model.result import Gyro

LARGE, ROOM = 2_000_000_000, 1_000_000_000
"""Bytes: of the file, and what is left to the process."""


@pytest.fixture
def little_memory():
    """The process cannot have the room that reading such a file would take."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.mark.parametrize(
    "command",
    [
        ("import", "large.csv", "--unit", "A"),
        ("diagnose", "large.csv"),
        ("gravity", "large.csv"),
        ("noise", "large.csv"),
        ("run", "--unit", "A", "--plan", "large.csv"),
    ],
    ids=lambda command: command[0],
)
def test_a_file_of_two_gigabytes_is_not_read(folder, little_memory, command):
    with (folder / "large.csv").open("wb") as opened:
        opened.write(b"target_deg,reading_deg,accel_x_g\n1,2,3\n")
        opened.truncate(LARGE)  # sparse: it takes no room
    assert "large.csv: larger than" in reason(*command, status=2)


@pytest.mark.parametrize("command", ["import", "diagnose", "gravity", "noise", "filters"])
def test_help_of_what_takes_a_file_says_where_its_columns_are_told(command):
    said = " ".join(calrig(command, "--help").stdout.replace("│", " ").split())
    assert "calrig/docs/reference/file-formats.md" in said.replace("- ", "-")


def test_every_column_that_poses_and_logs_may_have_is_told():
    told = files("calrig").joinpath("docs/reference/file-formats.md").read_text(encoding="utf-8")
    logged = [
        f"{sensor}_{axis}_{unit}" for sensor, unit in (("accel", "g"), ("gyro", "dps")) for axis in "xyz"
    ]
    assert [name for name in (*COLUMNS, *logged, "velocity_dps") if f"`{name}`" not in told] == []


def test_a_missing_column_is_told_with_those_that_are_there(folder):
    (folder / "poses.csv").write_text("tilt_deg;reading_deg;lux\n1;2;3\n")
    said = reason("diagnose", "poses.csv", status=2)
    assert "column target_deg: there is no such column" in said
    (folder / "log.csv").write_text("time_s\taccel_z_g\n0\t1\n0.1\t1\n")
    assert "there are: accel_z_g" in reason("gravity", "log.csv", status=2)


@pytest.mark.parametrize(
    "command", [("diagnose",), ("solve", "--unit", "A"), ("import", "--unit", "A")], ids=lambda c: c[0]
)
def test_all_bad_cells_of_poses_are_told_at_once(folder, command):
    (folder / "poses.csv").write_text("Target_deg,reading [°]\n1,x\n2,3\ny,\n")
    said = reason(command[0], "poses.csv", *command[1:], status=2)
    for place in ("poses.csv: line 2, column reading [°]: 'x'", "line 4, column Target_deg: 'y'"):
        assert place in said
    (folder / "poses.csv").write_text("tagret_deg,reading_deg\n1,2\n")
    assert "did you mean target_deg?" in reason(command[0], "poses.csv", *command[1:], status=2)


@pytest.mark.parametrize("command", ["gravity", "noise", "filters"])
def test_all_bad_cells_of_a_log_are_told_at_once(folder, command):
    (folder / "log.csv").write_text("Time_s,accel_x [g],accel_y_g,accel_z_g\n0,0,x,1\n0.1,0,0,1\n0.2,0,0,y\n")
    said = reason(command, "log.csv", status=2)
    assert all(place in said for place in ("line 2, column accel_y_g: 'x'", "line 4, column accel_z_g: 'y'"))


def test_a_log_as_people_write_it_has_the_noise_of_the_plain_one(folder):
    rows = [f"{k / 100:.2f};{(k * 7919 % 101) / 1000:.3f}" for k in range(3000)]
    (folder / "plain.csv").write_text("\n".join(["time_s;accel_z_g", *rows, ""]))
    written = [row.replace(".", ",") for row in rows]
    (folder / "log.csv").write_text("\n".join(["# bench 3", "Time;Accel z", "[s];[g]", *written, ""]))
    plain, found = (json.loads(calrig("noise", file, "--json").stdout) for file in ("plain.csv", "log.csv"))
    assert found["channels"] == plain["channels"]
    assert len(found["summary"]) == len(plain["summary"]) + 3


def test_what_designs_a_plan_says_is_taken_for_the_plan(folder):
    (folder / "design.json").write_text(
        json.dumps({"plan": {"step_deg": 30}, "expected": {"duration_s": 60}})
    )
    assert read_plan_file(folder / "design.json").step_deg == 30


EVIL = "[red]a[/red][link=http://x]b[/link]\x1b]0;owned\x07\x1b[2J\u202e"


@pytest.mark.parametrize("name", ["\x1b[31mred.csv", "two\nlines.csv", "\u202egnp.csv", "[bold]x[/bold].csv"])
def test_a_files_name_says_nothing_to_the_terminal(folder, name):
    assert reason("import", name, "--unit", "A", status=2).isprintable()


def test_what_devices_say_is_shown_as_it_is(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    found = {"port": EVIL, "kind": "stage", "driver": "smc100", "identity": EVIL}
    found |= {"usb_id": "1:2", "usb_serial": EVIL}
    output.print_ports([found], f"# {EVIL}\n")
    shown = capsys.readouterr().out
    assert shown.count("[red]a[/red]") == 4
    assert shown.replace("\n", "").isprintable()


def test_a_serial_number_is_no_markup_and_what_is_not_known_is_said(capsys):
    gyro = Gyro(bias_dps=[None] * 3, bias_std_dps=[None] * 3, scale=None, scale_std=None)
    figures = dict.fromkeys(Result.model_fields) | {"gyro": gyro, "n_poses": 3}
    run = RunRecord.model_construct(
        id="1",
        unit="[red]AS-1[/red]",
        rig="bench-1",
        status="completed",
        plan={},
        result=Result.model_construct(**figures),
        verdict=None,
        provenance={"warnings": ["$1=25 lets the table sag."]},
    )
    output.print_result(run)
    shown = capsys.readouterr().out
    assert "unit [red]AS-1[/red], on bench-1" in shown
    assert "not known" in shown
    assert "warning: $1=25 lets the table sag." in shown


def test_printable_text_stays_as_it_is():
    assert printable("Ünit № 7 [a] 'b'\n") == "Ünit № 7 [a] 'b'\n"
    assert printable("\x1b[31m\r\udcff") == r"\x1b[31m\r\udcff"


@pytest.mark.parametrize("n_columns", [60, 80, 100])
def test_a_table_cuts_no_name_and_keeps_to_the_terminal(capsys, monkeypatch, n_columns):
    monkeypatch.setenv("COLUMNS", str(n_columns))
    port = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A6008isP-if00-port0"
    rows = [
        [("bench-in-the-cellar-left", "joined", "Hall 7, north wing, cellar", "2026-11-22T17:34:55")],
        [("AS-1", "", "named", "1.0"), ("AS-2", "x")],
        [(port, "stage", "smc100", "SMC100CC version 2.0")],
    ]
    for table in rows:
        print_table(("name", "is", "found where it stands", "last seen, UTC"), table, justify="left")
        shown = capsys.readouterr().out
        for word in " ".join(cell for row in table for cell in row).split():
            assert word in shown
        assert port in shown or max(map(len, shown.splitlines())) <= n_columns
