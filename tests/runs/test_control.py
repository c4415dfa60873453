"""A request to end a run: the stage is told by whoever asks, whatever the run's own thread waits for."""

from __future__ import annotations

import threading

import pytest

from calrig.runs.control import Control, End, Ended

ABORTED = End("aborted", None)


def test_the_stage_is_halted_before_a_request_to_end_returns_by_the_thread_that_asks() -> None:
    control, halted_by = Control(), []
    control.arm(lambda: halted_by.append(threading.current_thread()))
    control.end(ABORTED)
    assert halted_by == [threading.current_thread()]
    with pytest.raises(Ended):
        control.check()


def test_a_second_request_halts_the_stage_again_and_the_first_says_how_it_ended() -> None:
    control, halts = Control(), []
    control.arm(lambda: halts.append("halt"))
    control.end(ABORTED)
    control.end(End("interrupted", "the service was stopped"))
    assert len(halts) == 2
    with pytest.raises(Ended) as ended:
        control.check()
    assert ended.value.end == ABORTED


def test_a_stage_that_was_not_open_yet_is_halted_as_soon_as_it_is() -> None:
    control, halts = Control(), []
    control.end(ABORTED)
    control.arm(lambda: halts.append("halt"))
    assert halts == ["halt"]
