"""The way back to a pose after an interruption, and what its second reading tells."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calrig.analysis.errors import NotTheSame
from calrig.calibration.poses import Pose
from calrig.estimation.reading import Reading
from calrig.runs.resume import Returned, way_back

LIMITS_DEG = (-60.0, 60.0)


@given(target_deg=st.floats(*LIMITS_DEG), approach=st.sampled_from([-1, 0, 1]))
def test_the_way_back_stays_within_the_limits_and_ends_on_the_side_it_was_approached_from(
    target_deg, approach
):
    way = way_back(Pose(target_deg=target_deg, reading_deg=0.0, approach=approach), LIMITS_DEG)
    assert way[-1] == target_deg
    assert all(LIMITS_DEG[0] <= elevation_deg <= LIMITS_DEG[1] for elevation_deg in way)
    if len(way) == 2:
        assert (target_deg - way[0]) * approach > 0


def returned(before_deg: float, after_deg: float, stderr_deg: float | None = 0.01) -> Returned:
    before = Pose(target_deg=10.0, reading_deg=before_deg, reading_stderr_deg=stderr_deg)
    return Returned(before, Reading(after_deg, 0.02, stderr_deg, 400))


def test_a_difference_that_chance_allows_says_nothing():
    close = returned(10.8, 10.87)
    close.require_same_unit()
    assert close.warnings() == []


def test_a_difference_that_chance_does_not_allow_is_said_and_one_that_no_warm_up_makes_is_refused():
    drifted = returned(10.8, 11.0)
    drifted.require_same_unit()
    assert "+0.200°" in drifted.warnings()[0]
    with pytest.raises(NotTheSame, match=r"-0\.800°"):
        returned(10.8, 10.0).require_same_unit()


def test_readings_on_both_sides_of_half_a_turn_are_close():
    assert returned(179.95, -179.95).difference_deg == pytest.approx(0.1)


def test_without_standard_errors_only_a_large_difference_is_told():
    returned(10.8, 11.2, None).require_same_unit()
    assert returned(10.8, 11.2, None).warnings() == []
    with pytest.raises(NotTheSame):
        returned(10.8, 11.4, None).require_same_unit()
