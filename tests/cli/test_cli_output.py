"""What comes from outside is shown on a terminal as text: it neither colours, moves the cursor nor links."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from command_line import reason

from calrig.cli import output
from calrig.errors import printable

EVIL = "[red]a[/red][link=http://x]b[/link]\x1b]0;owned\x07\x1b[2J\u202e"


@pytest.mark.parametrize("name", ["\x1b[31mred.csv", "two\nlines.csv", "\u202egnp.csv", "[bold]x[/bold].csv"])
def test_a_files_name_says_nothing_to_the_terminal(folder, name):
    assert reason("import", name, "--unit", "A", status=2).isprintable()


def test_what_devices_say_is_shown_as_it_is(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    found = SimpleNamespace(
        port=EVIL, kind="stage", driver="smc100", identity=EVIL, usb_id="1:2", usb_serial=EVIL
    )
    output.print_ports([found], f"# {EVIL}\n")
    shown = capsys.readouterr().out
    assert shown.count("[red]a[/red]") == 4
    assert shown.replace("\n", "").isprintable()


def test_a_serial_number_is_no_markup_and_what_is_not_known_is_said(capsys):
    number = {"bias_dps": [None] * 3, "bias_std_dps": [None] * 3, "scale": None, "scale_std": None}
    result = dict.fromkeys(
        ("bias_deg", "bias_std_deg", "scale", "scale_std", "rms_raw_deg", "rms_calibrated_deg", "noise_deg")
    )
    result |= {"gyro": number, "temperature_c": None, "reference": None, "n_poses": 3}
    output.print_result(
        SimpleNamespace(id="1", unit="[red]AS-1[/red]", rig="bench-1", plan=None, result=result, verdict=None)
    )
    shown = capsys.readouterr().out
    assert "unit [red]AS-1[/red] on bench-1" in shown
    assert "not known" in shown


def test_printable_text_stays_as_it_is():
    assert printable("Ünit № 7 [a] 'b'\n") == "Ünit № 7 [a] 'b'\n"
    assert printable("\x1b[31m\r\udcff") == r"\x1b[31m\r\udcff"
