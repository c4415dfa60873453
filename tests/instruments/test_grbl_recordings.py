"""The driver against conversations recorded from unmodified GRBL (../shared/wire, described there)."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from pathlib import Path

import pytest
from grbl_script import GO, Script
from repository import SHARED
from stage_ports import InProcessPort, homed, until_it_stands

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl.count import Count
from calrig.instruments.stages.grbl.driver import Grbl
from calrig.instruments.stages.grbl.link import GrblLink
from calrig.instruments.stages.grbl.protocol import parse_report

WIRE = Path(os.environ.get("CALRIG_WIRE", SHARED / "wire"))
MISSING = pytest.param("", marks=pytest.mark.skip(f"no recorded conversations here: {WIRE}"))
GRBL = sorted(path.stem for path in WIRE.glob("grbl11h-*.jsonl")) or [MISSING]
BEFORE_1_1 = sorted(path.stem for path in WIRE.glob("grbl09j-*.jsonl")) or [MISSING]
GARBLED = {"grbl11h-wrong-baud": 1}
"""Lines sent at another baud rate."""
STATES = {
    **dict.fromkeys(("Run", "Jog", "Hold:1", "Door:2"), "moving"),
    **dict.fromkeys(("Hold:0", "Door:0", "Door:1", "Sleep"), "disabled"),
    **{"Idle": "ready", "Alarm": "not_referenced", "Check": "configuration", "Home": "homing"},
}


def rows_of(name: str) -> list[dict]:
    """A recording's rows without its head."""
    return [json.loads(line) for line in (WIRE / f"{name}.jsonl").read_text("utf-8").splitlines()[1:]]


def scripted(name: str) -> tuple[Script, InProcessPort]:
    controller = Script()
    port = InProcessPort(controller, name)
    controller.now_s = port.clock.now_s
    return controller, port


def said_in(rows: list[dict]) -> list[str]:
    return [row["from"] for row in rows if "from" in row]


def taken_in(name: str) -> tuple[GrblLink, Count, Counter[str]]:
    """What the link and the count are after every message of a recording."""
    faults: Counter[str] = Counter()
    port, count = InProcessPort(Script(), name), Count(0, name)
    link = GrblLink(port, faults)
    for text in said_in(rows_of(name)):
        port.push(text.encode("latin-1"))
        link.catch_up()
        if report := parse_report(text.strip()):
            count.hear_offset(report)
            count.degrees(report)
    return link, count, faults


@pytest.mark.parametrize("name", GRBL)
def test_every_message_is_understood(name):
    link, count, faults = taken_in(name)
    said = [text.strip() for text in said_in(rows_of(name))]
    assert (faults["unparsed"], faults["echo"]) == (GARBLED.get(name, 0), 0)
    banners = [k for k, text in enumerate(said) if text.startswith("Grbl ")]
    assert link.resets == len(banners)
    assert link.firmware == ("Grbl 1.1h" if banners else None)
    alarms = [(k, int(text[6:])) for k, text in enumerate(said) if text.startswith("ALARM:")]
    assert link.alarm == (alarms[-1][1] if alarms else None)
    assert link.locked == (bool(alarms) and alarms[-1][1] in (1, 2) and max(banners) < alarms[-1][0])
    reports = [text for text in said if text.startswith("<")]
    if reports:
        offsets = [float(found[1]) for text in reports if (found := re.search(r"WCO:([-.\d]+)", text))]
        frame, first = re.search(r"([MW])Pos:([-.\d]+)", reports[-1]).groups()
        if frame == "W" or offsets[-2:-1] == offsets[-1:]:
            here_deg = float(first) - (offsets[-1] if frame == "M" and offsets else 0)
            assert count.shown_deg == pytest.approx(here_deg, abs=1e-9)


@pytest.mark.parametrize("name", BEFORE_1_1)
def test_an_older_firmware_is_named_and_not_spoken(name):
    link, _, _ = taken_in(name)
    assert (link.before_1_1, link.firmware, link.alarm) == (True, "Grbl 0.9j", None)


@pytest.mark.parametrize("name", GRBL)
def test_every_report_is_a_state(name):
    controller = Script()
    stage = homed(Grbl(InProcessPort(controller, name)))
    reports = {text.strip() for text in said_in(rows_of(name)) if text.startswith("<")}
    for text in sorted({re.sub(r"\|WCO:[^|>]*", "", report) for report in reports}):
        controller.report = text
        state = re.match(r"<(\w+(?::\d)?)", text)[1]
        assert stage.status().state == STATES[state], text
        stage.glimpse_deg()
    assert set(stage.faults) <= {"zero_not_homed"}


def conversations(cause) -> list:
    """Each recorded line that `cause` holds for, as (recording, row)."""
    found = [
        pytest.param(name, k, id=f"{name}-{k}")
        for name in GRBL
        if isinstance(name, str)
        for k, row in enumerate(rows_of(name))
        if cause(row)
    ]
    return found or [pytest.param("", 0, marks=MISSING.marks)]


def played(rows: list[dict], since_s: float) -> list[tuple[float, str]]:
    return [(row["t"] - since_s, row["from"]) for row in rows if "from" in row]


def reset_after(rows: list[dict]) -> tuple[dict, list[tuple[float, str]], str]:
    """The first reset that was taken, what it set off, and the next report."""
    told = next((k for k, row in enumerate(rows) if "Reset to continue" in row.get("from", "")), 0)
    at = next(k for k, row in enumerate(rows) if k >= told and "\x18" in row.get("to", ""))
    rest = rows[at + 1 :]
    report = next(row["from"].strip() for row in rest if row.get("from", "").startswith("<"))
    within = [row for row in rest if row["t"] < rows[at]["t"] + 0.25]
    return rows[at], played(within, rows[at]["t"]), report


@pytest.mark.parametrize(("name", "row"), conversations(lambda row: row.get("to") == "$H\n"))
def test_a_homing_succeeds_or_fails_as_recorded(name, row):
    rows = rows_of(name)[row:]
    answer = next(one for one in rows if one.get("from", "").startswith(("ok", "error:")))
    within = [one for one in rows if one["t"] < answer["t"] + 0.06]
    play = [one for one in played(within, rows[0]["t"]) if not one[1].startswith(("<", "[GC"))]
    controller, port = scripted(name)
    stage = Grbl(port)
    stage.identify()
    controller.plays["$H"] = play
    if answer["from"].startswith("error:"):
        with pytest.raises(StageError, match=r"refused \$H"):
            stage.home()
        return
    up_s, resets = port.clock.now_s() + play[-1][0], stage._link.resets
    receive = controller.receive

    def silent_while_it_homes(data):
        controller.silent = data == b"?" and port.clock.now_s() < up_s
        return receive(data)

    stage.home()
    controller.receive = silent_while_it_homes
    controller.report = next(
        one["from"].strip() for one in rows if one["t"] > answer["t"] and one.get("from", "").startswith("<")
    )
    failed = any(text.startswith("ALARM") for _, text in play)
    assert until_it_stands(stage) == ("not_referenced" if failed else "ready")
    assert stage._link.resets - resets == sum(text.startswith("Grbl") for _, text in play)
    if not failed:
        assert stage.position_deg() == parse_report(controller.report).position[0]


@pytest.mark.parametrize(("name", "row"), conversations(lambda row: row.get("from") == "ALARM:2\r\n"))
def test_a_soft_limit_keeps_the_angle_as_recorded(name, row):
    rows = rows_of(name)[row:]
    controller, port = scripted(name)
    _, after, report = reset_after(rows)
    controller.report = report.replace("Alarm", "Idle")
    stage = homed(Grbl(port))
    alarm = [one for one in rows if one.get("from", "").startswith(("ALARM:2", "[MSG:Reset"))][:2]
    controller.plays = {f"{GO} X500": played(alarm, alarm[0]["t"]), "\x18": after}
    with pytest.raises(StageError, match="ALARM:2"):
        stage.move(500)
    assert (controller.resets, controller.lines[-2:]) == (1, ["$X", "$$"])
    assert stage.position_deg() == stage._count.shown_deg


@pytest.mark.parametrize(("name", "row"), conversations(lambda row: row.get("from") == "ALARM:1\r\n"))
def test_a_hard_limit_costs_the_angle_as_recorded(name, row):
    rows = rows_of(name)[row:]
    if not any("\x18" in one.get("to", "") for one in rows):
        pytest.skip("the recording ends before a reset")
    controller, port = scripted(name)
    stage = homed(Grbl(port))
    _, after, report = reset_after(rows)
    alarm = [one for one in rows if one.get("from", "").startswith(("ALARM:1", "[MSG:Reset"))][:2]
    controller.plays = {"hit": played(alarm, alarm[0]["t"]), "\x18": after}
    controller._plays("hit")
    controller.report = report
    status = stage.status()
    assert (status.state, controller.resets) == ("not_referenced", 1)
    assert "ALARM:1" in status.words
    with pytest.raises(StageError, match="lost its angle: ALARM:1"):
        stage.position_deg()
