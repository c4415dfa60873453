"""A look at a board opens its port once: the run after it goes on with that, and the board boots no more."""

from __future__ import annotations

from contextlib import closing

import pytest
from run_rigs import CLOCK, plan
from support import FAST

from calrig.instruments.drivers import may_stay_open
from calrig.instruments.transcript import read_transcript
from calrig.model.run import TERMINAL
from calrig.runs.service import RunService

BOOT_S = 1.5


@pytest.mark.parametrize("is_seen", [True, False])
def test_a_board_boots_once_for_a_look_and_the_run_after_it(make_rig, store, tmp_path, is_seen):
    rig = make_rig(board={"serial": "ONCE-1", "boot_s": BOOT_S * FAST["time_scale"]})
    with closing(RunService(store, [rig.settings], record=tmp_path)) as service:
        service.look("bench-1")
        if is_seen:
            CLOCK.until(lambda: service.looks()["bench-1"].serial, "unit")
        else:  # Enter comes while it boots
            CLOCK.sleep(BOOT_S / 2)
        run = service.start(unit="ONCE-1", plan=plan())
        assert not service.looks()
        ended = CLOCK.until(lambda: (now := service.run(run.id)).status in TERMINAL and now, "end")
    assert (ended.status, ended.error, ended.faults) == ("completed", None, {})
    (of_board,) = tmp_path.glob("*board*")
    said = read_transcript(of_board.read_text().splitlines())
    answer = next(piece for piece in said if b"ONCE-1" in piece.data)
    assert answer.at_s < (0.1 if is_seen else BOOT_S), (
        "the run's own record begins with it, and no boot is in it"
    )


def test_a_board_that_takes_its_zero_when_it_starts_is_opened_anew():
    assert may_stay_open("calrig") and may_stay_open("tkj-kalman")
    assert not any(map(may_stay_open, ["mpu6050-light", "tockn", "dmp-ypr", "somebody-elses"]))
