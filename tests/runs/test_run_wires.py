"""Damaged wires: whatever happens, no reading is wrong, the stage stands, and the run says what happened.

`python -m tests.studies.trials faults` tries a thousand such runs; here is one of each kind.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import pytest
from run_rigs import CLOCK
from studies.trials.faults_run import Case, Outcome, try_case
from studies.trials.proxy_damage import TO_DEVICE, TO_HOST, Fault

from calrig.store import Store


@dataclass(frozen=True)
class Expected:
    """A fault of one wire, and what the run must show: its status, and a counter or words of its error."""

    kind: str
    wire: str
    direction: str
    size: float
    status: str
    shows: str
    from_s: float = 0.0
    stage: str = "smc100"

    @property
    def case(self) -> Case:
        name = re.sub(r"\W+", "-", f"{self.kind}-{self.wire}-{self.direction}-{self.stage}")
        fault = Fault(self.kind, self.direction, self.size, self.from_s)
        sweeps = 2 if self.from_s else 1  # what begins later is not to begin after the end
        return Case(name, self.stage, self.wire, fault, seed=1, sweeps=sweeps)


EXPECTED = [
    Expected("flip", "board", TO_HOST, 0.001, "completed", "crc"),
    Expected("lose line", "board", TO_HOST, 0.01, "completed", "sequence_gap"),
    Expected("double line", "board", TO_HOST, 0.1, "completed", "repeated"),
    Expected("noise", "board", TO_HOST, 0.01, "completed", "unparsed", stage="zaber"),
    Expected("cut", "board", TO_HOST, 0.01, "completed", ""),
    Expected("stall", "board", TO_HOST, 0.7, "completed", "", from_s=0.5),
    Expected("mute", "board", TO_HOST, 0.5, "completed", "sequence_gap", from_s=0.8),
    Expected("reset", "board", TO_HOST, 0.1, "completed", "board_reset", 0.8, "esp301"),
    Expected("freeze", "board", TO_HOST, 0.3, "completed", "frozen", from_s=0.8, stage="grbl"),
    Expected("gone", "board", TO_HOST, 0.1, "failed", "went away", from_s=0.8),
    Expected("flip", "stage", TO_HOST, 0.005, "completed", ""),
    Expected("late", "stage", TO_HOST, 0.06, "completed", "late_reply", stage="esp301"),
    Expected("echo", "stage", TO_HOST, 1.0, "completed", "echo", stage="grbl"),
    Expected("xoff", "stage", TO_HOST, 0.2, "completed", "flow_control"),
    Expected("lose line", "stage", TO_DEVICE, 0.05, "completed", "no_reply", from_s=0.3),
    Expected("reset", "stage", TO_HOST, 0.1, "failed", "NOT REFERENCED|not told to move", from_s=0.8),
    Expected("renamed", "stage", TO_HOST, 0.1, "failed", "went away", from_s=0.8),
]


@pytest.fixture(scope="module")
def outcomes(store: Store, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Outcome]:
    """Every case in virtual time, but for the stage whose maker's library cannot be given time."""
    folder = tmp_path_factory.mktemp("wires")
    cases = [expected.case for expected in EXPECTED]
    return {
        case.name: try_case(case, store, folder, None if case.stage == "zaber" else CLOCK) for case in cases
    }


@pytest.mark.parametrize("expected", EXPECTED, ids=lambda expected: expected.case.name)
def test_no_reading_is_wrong_and_the_stage_stands(outcomes: dict[str, Outcome], expected: Expected) -> None:
    outcome = outcomes[expected.case.name]
    broken = (outcome.wrong, outcome.without_reason, outcome.left_moving, outcome.hung, outcome.beyond)
    assert broken == ([], [], [], [], []), outcome.error


@pytest.mark.parametrize("expected", EXPECTED, ids=lambda expected: expected.case.name)
def test_the_run_shows_what_happened(outcomes: dict[str, Outcome], expected: Expected) -> None:
    outcome = outcomes[expected.case.name]
    assert outcome.status == expected.status, outcome.error
    assert outcome.damaged > 0
    if expected.status == "failed":
        assert re.search(expected.shows, outcome.error or ""), outcome.error
    elif expected.shows:
        assert outcome.faults.get(expected.shows, 0) > 0, outcome.faults
