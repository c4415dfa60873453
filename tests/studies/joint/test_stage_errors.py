"""Stages whose error is no short series: what their map states holds, and the guard sees changes."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from .stage_errors import CASES, CHANGES, Counted, alarm, count


def counted(name: str, seeds: Sequence[int]) -> list[Counted]:
    return [count(CASES[name], seed) for seed in seeds]


def within_two(found: Sequence[Counted]) -> float:
    return sum(one.within for one in found) / sum(one.points for one in found)


def at_visited_angles(found: Sequence[Counted]) -> float:
    return sum(one.visited_within for one in found) / sum(one.visited for one in found)


@pytest.mark.parametrize("name", ["tooth of 0.3°, bell", "tooth of 0.3°, box"])
def test_near_a_damaged_tooth_the_map_widens(name):
    found = counted(name, range(4))
    assert within_two(found) >= 0.9
    assert sum("region" in one.told for one in found) >= 3
    assert all(one.map_std_deg < 0.007 for one in found), "and nowhere else"


def test_without_a_local_error_the_map_does_not_widen():
    found = counted("six orders, jittered", range(4))
    assert not any(one.told for one in found)
    assert all(one.map_std_deg < 0.0065 and one.unknown == 0 for one in found)


def test_a_gear_that_nobody_stated_is_in_the_standard_deviation():
    found = counted("gear of 0.03° every 7.2°", range(3))
    assert within_two(found) >= 0.9
    assert all("gear" in one.told for one in found)


@pytest.mark.parametrize("name", ["grid of 10°, twelve orders", "12 poses, twelve orders"])
def test_between_far_angles_the_map_is_null_and_at_them_it_holds(name):
    found = counted(name, range(4))
    assert all(one.unknown > 40 and "between" in one.told for one in found)
    assert at_visited_angles(found) >= 0.85
    assert sum(one.elevations_within for one in found) / len(found) >= 0.85


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("nothing, noise 0.03°", 0, 1),
        ("order 3 of 0.1° RMS, noise 0.012°", 17, 20),
        ("order 4 of 0.1° RMS, noise 0.03°", 14, 20),
    ],
)
def test_the_guard_sees_changes_and_raises_no_false_alarm(name, least, most):
    assert least <= sum(alarm(CHANGES[name], seed) for seed in range(20)) <= most


@pytest.mark.statistical
@pytest.mark.parametrize("name", [name for name in CASES if "0.1°" not in name])
def test_what_the_map_states_holds_in_the_hard_cases(name):
    # of twelve orders over a turn the unit's share differs by 0.03 from one twenty of benches to the next
    found = counted(name, range(60 if name == "twelve orders, full turn" else 20))
    assert within_two(found) >= (0.85 if "box" in name or "cosine" in name else 0.9)
    assert at_visited_angles(found) >= 0.9
    assert sum(one.elevations_within for one in found) / len(found) >= 0.9
