"""What comes from outside is shown on a terminal as text: it neither colours, moves the cursor nor links."""

from __future__ import annotations

import pytest
from command_line import reason

from calrig.cli import output
from calrig.cli.output import print_table
from calrig.client import Result, RunRecord
from calrig.errors import printable
from calrig.model.result import Gyro

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
