"""The driver against conversations recorded from unmodified GRBL (../shared/wire, described there)."""

from __future__ import annotations

import re
from collections import Counter

import pytest
from grbl_script import GO, Script
from stage_ports import InProcessPort, homed, until_it_stands
from wire_recordings import Event, recording, recordings

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl.count import Count
from calrig.instruments.stages.grbl.driver import Grbl
from calrig.instruments.stages.grbl.link import GrblLink
from calrig.instruments.stages.grbl.protocol import parse_report

GRBL = recordings("grbl11h-*")
BEFORE_1_1 = recordings("grbl09j-*")
GARBLED = {"grbl11h-wrong-baud": 1}
"""Lines sent at another baud rate."""
STATES = {
    **dict.fromkeys(("Run", "Jog", "Hold:1", "Door:2"), "moving"),
    **dict.fromkeys(("Hold:0", "Door:0", "Door:1", "Sleep"), "disabled"),
    **{"Idle": "ready", "Alarm": "not_referenced", "Check": "configuration", "Home": "homing"},
}


def scripted(name: str) -> tuple[Script, InProcessPort]:
    controller = Script()
    port = InProcessPort(controller, name)
    controller.now_s = port.clock.now_s
    return controller, port


def said_in(rows: list[Event]) -> list[str]:
    return [row.text for row in rows if row.says("")]


def taken_in(name: str) -> tuple[GrblLink, Count, Counter[str]]:
    """What the link and the count are after every message of a recording."""
    faults: Counter[str] = Counter()
    port, count = InProcessPort(Script(), name), Count(0, name)
    link = GrblLink(port, faults)
    for text in said_in(recording(name)):
        port.push(text.encode("latin-1"))
        link.catch_up()
        if report := parse_report(text.strip()):
            count.hear_offset(report)
            count.degrees(report)
    return link, count, faults


@pytest.mark.parametrize("name", GRBL)
def test_every_message_is_understood(name):
    link, count, faults = taken_in(name)
    said = [text.strip() for text in said_in(recording(name))]
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
    reports = {text.strip() for text in said_in(recording(name)) if text.startswith("<")}
    for text in sorted({re.sub(r"\|WCO:[^|>]*", "", report) for report in reports}):
        controller.report = text
        state = re.match(r"<(\w+(?::\d)?)", text)[1]
        assert stage.status().state == STATES[state], text
        stage.glimpse_deg()
    assert set(stage.faults) <= {"zero_not_homed"}


def conversations(way: str, text: str) -> list:
    """Each recorded line with this text, as (recording, row)."""
    found = [
        pytest.param(name, k, id=f"{name}-{k}")
        for name in GRBL
        if isinstance(name, str)
        for k, row in enumerate(recording(name))
        if (row.way, row.text) == (way, text)
    ]
    return found or [pytest.param("", 0, marks=pytest.mark.skip("no recorded conversations here"))]


def played(rows: list[Event], since_s: float) -> list[tuple[float, str]]:
    return [(row.t_s - since_s, row.text) for row in rows if row.says("")]


def reset_after(rows: list[Event]) -> tuple[Event, list[tuple[float, str]], str]:
    """The first reset that was taken, what it set off, and the next report."""
    told = next((k for k, row in enumerate(rows) if row.says("[MSG:Reset to continue")), 0)
    at = next(k for k, row in enumerate(rows) if k >= told and row.way == "to" and "\x18" in row.text)
    rest = rows[at + 1 :]
    report = next(row.text.strip() for row in rest if row.says("<"))
    within = [row for row in rest if row.t_s < rows[at].t_s + 0.25]
    return rows[at], played(within, rows[at].t_s), report


@pytest.mark.parametrize(("name", "row"), conversations("to", "$H\n"))
def test_a_homing_succeeds_or_fails_as_recorded(name, row):
    rows = recording(name)[row:]
    answer = next(one for one in rows if one.says("ok", "error:"))
    within = [one for one in rows if one.t_s < answer.t_s + 0.06]
    play = [one for one in played(within, rows[0].t_s) if not one[1].startswith(("<", "[GC"))]
    controller, port = scripted(name)
    stage = Grbl(port)
    stage.identify()
    controller.plays["$H"] = play
    if answer.text.startswith("error:"):
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
    controller.report = next(one.text.strip() for one in rows if one.t_s > answer.t_s and one.says("<"))
    failed = any(text.startswith("ALARM") for _, text in play)
    assert until_it_stands(stage) == ("not_referenced" if failed else "ready")
    assert stage._link.resets - resets == sum(text.startswith("Grbl") for _, text in play)
    if not failed:
        assert stage.position_deg() == parse_report(controller.report).position[0]


@pytest.mark.parametrize(("name", "row"), conversations("from", "ALARM:2\r\n"))
def test_a_soft_limit_keeps_the_angle_as_recorded(name, row):
    rows = recording(name)[row:]
    controller, port = scripted(name)
    _, after, report = reset_after(rows)
    controller.report = report.replace("Alarm", "Idle")
    stage = homed(Grbl(port))
    alarm = [one for one in rows if one.says("ALARM:2", "[MSG:Reset")][:2]
    controller.plays = {f"{GO} X500": played(alarm, alarm[0].t_s), "\x18": after}
    with pytest.raises(StageError, match="ALARM:2"):
        stage.move(500)
    assert (controller.resets, controller.lines[-2:]) == (1, ["$X", "$$"])
    assert stage.position_deg() == stage._count.shown_deg


@pytest.mark.parametrize(("name", "row"), conversations("from", "ALARM:1\r\n"))
def test_a_hard_limit_costs_the_angle_as_recorded(name, row):
    rows = recording(name)[row:]
    if not any(one.way == "to" and "\x18" in one.text for one in rows):
        pytest.skip("the recording ends before a reset")
    controller, port = scripted(name)
    stage = homed(Grbl(port))
    _, after, report = reset_after(rows)
    alarm = [one for one in rows if one.says("ALARM:1", "[MSG:Reset")][:2]
    controller.plays = {"hit": played(alarm, alarm[0].t_s), "\x18": after}
    controller._plays("hit")
    controller.report = report
    status = stage.status()
    assert (status.state, controller.resets) == ("not_referenced", 1)
    assert "ALARM:1" in status.words
    with pytest.raises(StageError, match="lost its angle: ALARM:1"):
        stage.position_deg()
