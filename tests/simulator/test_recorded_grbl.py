"""The simulated GRBL against every recorded conversation with the real one: same host, same words.

The recordings lie beside the repository, in CI; what they show is in `test_simulated_grbl` as well.
"""

from __future__ import annotations

import re

import pytest
from recorded_wires import AT_WRONG_BAUD_S, Recording, Replay
from wire_recordings import recordings

NAMES = recordings("grbl*")
LATE_S = 0.06
"""An answer comes within this of the recorded one."""
HOMING_LATE_S = 0.35
"""Of a cycle of seconds, whose ramps are the simulation's own."""
STEP_DEG = 0.021
JITTER_S = 0.014
BURST_JITTER_S = 0.022
"""After 600 bytes in one write."""
STOPPED_DEG = 0.45
"""Where a stop on the way ends: the instant at which it was sent is known to 20 ms."""
STOPS_ON_THE_WAY = ("!", "\x18", "\x84", "\x85")
RATE_PER_MIN = 320
HOMING = {
    "grbl11h-homing": {"switch_deg": -2.0},
    "grbl11h-homing-no-switch": {"switch_deg": None},
    "grbl11h-homing-switch-stuck": {"switch_deg": -2.0},
    "grbl11h-soft-limit-wco": {"switch_deg": -2.0},
}
BLANK = "grbl11h-power-up-blank-eeprom"
OPEN = "grbl11h-open-without-reset"

REPORT = re.compile(r"<(?P<state>\w+)(?::(?P<substate>\d))?[|,](?P<fields>.*)>")
FIELD = re.compile(r"[|,](?=[A-Z])")


def options(name: str) -> dict:
    if name == BLANK:
        return {"settings": {}, "blank_eeprom": True, "boot_s": 0.0}
    return HOMING.get(name, {})


def replayed(recording: Recording) -> tuple[list[tuple[float, str]], list[tuple[float, str]]]:
    """Lines that came in the recording, and from the simulated controller."""
    before = (b"G0 X8\nS211\n", b"?", b"?") if recording.name == OPEN else ()
    replay = Replay(recording, before, **options(recording.name))
    came, said = recording.came(), replay.lines()
    if recording.changes_baud:
        begin_s, end_s = AT_WRONG_BAUD_S
        said = [line for line in said if not begin_s < line[0] < end_s]
    if recording.name == BLANK:  # the first bytes of the recording are missing
        came, said = came[1:], said[said.index((said[0][0], said[0][1])) :]
        said = said[2:]
    return came, said


def parsed(line: str) -> tuple[str, str | None, dict[str, list[float] | str]]:
    found = REPORT.fullmatch(line)
    assert found, line
    fields: dict[str, list[float] | str] = {}
    for part in FIELD.split(found["fields"]):
        name, _, value = part.partition(":")
        fields[name] = value if name in ("Pn", "A") else [float(number) for number in value.split(",")]
    return found["state"], found["substate"], fields


@pytest.mark.parametrize("name", NAMES)
def test_it_says_what_the_firmware_said(name):
    recording = Recording(name)
    came, said = replayed(recording)
    answers, own = ([line for line in lines if line[1][:1] != "<"] for lines in (came, said))
    assert [line for _, line in own] == [line for _, line in answers]
    late_s = HOMING_LATE_S if name in HOMING else LATE_S
    for (at_s, line), (own_s, _) in zip(answers, own, strict=True):
        assert own_s == pytest.approx(at_s, abs=late_s), line


@pytest.mark.parametrize("name", NAMES)
def test_it_reports_what_the_firmware_reported(name):
    recording = Recording(name)
    came, said = replayed(recording)
    reports, own = (
        [(at_s, parsed(line)) for at_s, line in lines if line[:1] == "<"] for lines in (came, said)
    )
    assert len(own) == len(reports)
    stopped_s = min(
        (
            at_s
            for at_s, kind, text in recording.entries
            if kind == "to" and set(text) & set(STOPS_ON_THE_WAY)
        ),
        default=float("inf"),
    )
    stopped_s = min([stopped_s, *(at_s for at_s, kind, _ in recording.entries if kind == "event" and at_s)])
    inches = 25.4 if recording.name == "grbl11h-inches" else 1.0
    for k, ((at_s, report), (_, its_own)) in enumerate(zip(reports, own, strict=True)):
        state, substate, fields = report
        around = {other[:2] for _, other in own[max(k - 1, 0) : k + 2]}  # a state changes within 50 ms
        assert (state, substate) in around, (at_s, report, its_own)
        assert list(its_own[2]) == list(fields), (at_s, report, its_own)
        rates = [values["FS"][0] for values in (fields, its_own[2]) if "FS" in values]
        moves_dps = max([0.0, *rates]) / 60 * (inches if rates and max(rates) < 100 else 1.0)
        if not rates and state in ("Run", "Hold"):
            moves_dps = 500 / 60
        jitter_s = BURST_JITTER_S if recording.name == "grbl11h-rx-overflow" else JITTER_S
        for field, value in fields.items():
            if field in ("MPos", "WPos"):
                loose = STOPPED_DEG if at_s >= stopped_s else 0.0
                assert its_own[2][field] == pytest.approx(
                    value, abs=STEP_DEG + loose + jitter_s * max(moves_dps, 1.0)
                ), (at_s, report, its_own)
            elif field == "FS":
                assert its_own[2]["FS"] == pytest.approx(value, abs=RATE_PER_MIN), (at_s, report, its_own)
            elif field == "Bf":
                assert its_own[2]["Bf"] == pytest.approx(value, abs=1), (at_s, report, its_own)
            else:
                assert its_own[2][field] == value, (at_s, report, its_own)
