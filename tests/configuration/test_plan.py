"""A plan: the poses that follow from it, and what it refuses."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from calrig.plan import MAX_POSES, Plan, PlanError

LIMITS = (-90.0, 90.0)
ROUNDING_DEG = 1e-6
"""Jittered targets are given to a millionth of a degree."""

angles = st.floats(-90, 90)
elevations = st.lists(angles, min_size=1, max_size=20)
grids = st.fixed_dictionaries({"start_deg": angles, "stop_deg": angles, "step_deg": st.floats(0.5, 200)})
jittered = st.fixed_dictionaries(
    {
        "elevations_deg": elevations,
        "sweeps": st.integers(1, 4),
        "order": st.sampled_from(["sweep", "random", "given"]),
        "jitter_deg": st.floats(0, 45),
        "seed": st.integers(0, 2**63 - 1),
    }
)


def targets(plan: Plan, limits_deg: tuple[float, float] = LIMITS) -> list[float]:
    return [pose.target_deg for pose in plan.poses(limits_deg)]


def sweeps(plan: Plan) -> list[list[float]]:
    """The targets of each sweep."""
    poses = plan.poses(LIMITS)
    return [[p.target_deg for p in poses if p.sweep == sweep] for sweep in range(plan.sweeps)]


def test_defaults_are_those_of_the_contract() -> None:
    assert Plan().model_dump() == {
        "kind": "calibration",
        "elevations_deg": None,
        "start_deg": -60,
        "stop_deg": 60,
        "step_deg": 10,
        "sweeps": 4,
        "order": "sweep",
        "jitter_deg": 0,
        "settle_s": 1,
        "dwell_s": 2,
        "rate_hz": 200,
        "target_std_deg": None,
        "velocity_dps": None,
        "wait_s": 0,
        "wait_temperature_c": None,
        "mounts_deg": [0.0],
        "mount_axis": "x",
        "revision": None,
        "until": None,
        "seed": 0,
    }
    assert Plan().elevations() == list(range(-60, 61, 10))
    assert len(Plan().poses(LIMITS)) == 52


@given(grids)
def test_a_grid_includes_both_ends_and_steps_evenly_between(grid: dict[str, float]) -> None:
    given_ends = grid["start_deg"], grid["stop_deg"]
    steps = Plan(**grid).elevations()
    assert (steps[0], steps[-1]) == given_ends
    sense = 1 if given_ends[0] <= given_ends[1] else -1
    between = [sense * (after - before) for before, after in pairwise(steps)]
    assert between[:-1] == pytest.approx([grid["step_deg"]] * len(between[:-1]))
    assert all(0 < step <= grid["step_deg"] * (1 + 1e-6) for step in between[-1:])  # what is left


@given(grids)
def test_a_grid_within_the_limits_is_never_refused(grid: dict[str, float]) -> None:
    limits = min(grid["start_deg"], grid["stop_deg"]), max(grid["start_deg"], grid["stop_deg"])
    plan = Plan(**grid, sweeps=1)
    assert sorted(targets(plan, limits)) == sorted(plan.elevations())


@pytest.mark.parametrize(("stop_deg", "step_deg", "count"), [(0.3, 0.1, 4), (0.7, 0.1, 8), (60.0, 0.1, 601)])
def test_a_grid_of_decimals_ends_exactly_where_it_was_told_to(
    stop_deg: float, step_deg: float, count: int
) -> None:
    steps = Plan(start_deg=0.0, stop_deg=stop_deg, step_deg=step_deg).elevations()
    assert (len(steps), steps[-1]) == (count, stop_deg)


@given(elevations, st.integers(1, 5))
def test_sweeps_go_up_and_down_in_turn(given_deg: list[float], count: int) -> None:
    for index, sweep in enumerate(sweeps(Plan(elevations_deg=given_deg, sweeps=count))):
        assert sweep == sorted(given_deg, reverse=index % 2 == 1)


def test_a_grid_from_above_to_below_begins_upward_all_the_same() -> None:
    assert sweeps(Plan(start_deg=20, stop_deg=0, sweeps=2)) == [[0, 10, 20], [20, 10, 0]]


@given(elevations, st.integers(1, 3))
def test_a_given_order_is_kept_in_every_sweep(given_deg: list[float], count: int) -> None:
    plan = Plan(elevations_deg=given_deg, sweeps=count, order="given")
    assert sweeps(plan) == [given_deg] * count


@given(elevations, st.integers(1, 3), st.integers(0, 2**63 - 1))
def test_a_random_order_visits_the_same_elevations(given_deg: list[float], count: int, seed: int) -> None:
    plan = Plan(elevations_deg=given_deg, sweeps=count, order="random", seed=seed)
    assert [sorted(sweep) for sweep in sweeps(plan)] == [sorted(given_deg)] * count


def test_random_orders_differ_from_sweep_to_sweep_and_from_seed_to_seed() -> None:
    orders = [tuple(s) for seed in (1, 2) for s in sweeps(Plan(order="random", seed=seed))]
    assert len(set(orders)) == len(orders) == 8


@given(jittered)
def test_jitter_stays_within_its_width_and_the_limits(plan: dict[str, Any]) -> None:
    exact = targets(Plan(**{**plan, "jitter_deg": 0.0, "order": "given"}))
    moved = targets(Plan(**{**plan, "order": "given"}))
    for planned, target in zip(exact, moved, strict=True):
        assert abs(target - planned) <= plan["jitter_deg"] + ROUNDING_DEG
        assert LIMITS[0] <= target <= LIMITS[1]


@given(st.floats(-80, 0, exclude_max=True), st.floats(0, 80, exclude_min=True), st.integers(0, 1000))
def test_no_target_is_beyond_the_limits_whatever_their_decimals(low: float, high: float, seed: int) -> None:
    plan = Plan(elevations_deg=[low, high], sweeps=4, jitter_deg=5.0, seed=seed)
    assert all(low <= target <= high for target in targets(plan, (low, high)))


def test_jitter_fills_its_width() -> None:
    moved = targets(Plan(elevations_deg=[0.0], sweeps=2000, jitter_deg=2.0))
    assert min(moved) < -1.9
    assert max(moved) > 1.9
    assert abs(sum(moved) / len(moved)) < 6 * 2.0 / math.sqrt(3 * 2000)


@given(jittered)
def test_the_same_seed_gives_the_same_poses(plan: dict[str, Any]) -> None:
    assert Plan(**plan).poses(LIMITS) == Plan(**plan).poses(LIMITS)


@given(jittered)
def test_poses_are_numbered_from_nought_and_sweeps_in_order(plan: dict[str, Any]) -> None:
    poses = Plan(**plan).poses(LIMITS)
    assert [pose.index for pose in poses] == list(range(len(poses)))
    each = len(plan["elevations_deg"])
    assert [pose.sweep for pose in poses] == [k // each for k in range(each * plan["sweeps"])]


@given(elevations, st.sampled_from([-90.0001, 90.0001, 180.0, -360.0]), st.floats(0, 45))
def test_an_elevation_beyond_the_limits_is_named_with_them(
    given_deg: list[float], beyond_deg: float, jitter_deg: float
) -> None:
    plan = Plan(elevations_deg=[*given_deg, beyond_deg], jitter_deg=jitter_deg)
    with pytest.raises(PlanError, match=r"-90° to 90°.*nothing was moved") as refused:
        plan.poses(LIMITS)
    assert f"{beyond_deg:g}°" in str(refused.value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"elevations_deg": [0.0] * 100_000},
        {"sweeps": 100_000},
        {"elevations_deg": [0.0, 1.0], "sweeps": MAX_POSES // 2 + 1},
        {"step_deg": 1e-3},
        {"step_deg": 5e-324},
        {"elevations_deg": []},
        {"sweeps": 0},
        {"sweeps": -1},
    ],
)
def test_a_plan_without_poses_or_with_too_many_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Plan(**wrong)


@pytest.mark.parametrize(
    "most",
    [
        {"elevations_deg": [0.0], "sweeps": MAX_POSES},
        {"start_deg": 0, "stop_deg": 9, "step_deg": 1, "sweeps": MAX_POSES // 10},
        {"start_deg": 0, "stop_deg": 9.5, "step_deg": 1, "sweeps": MAX_POSES // 11},
    ],
)
def test_a_plan_of_the_most_poses_is_taken(most: dict[str, Any]) -> None:
    assert MAX_POSES - 10 <= len(Plan(**most).poses(LIMITS)) <= MAX_POSES


def test_the_refusal_of_too_many_poses_counts_them_right() -> None:
    with pytest.raises(ValidationError, match=r"has 13000 poses.*10000"):
        Plan(sweeps=1000)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["start_deg", "stop_deg", "step_deg", "jitter_deg", "settle_s", "dwell_s"])
def test_what_is_no_number_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValidationError, match=name):
        Plan(**{name: value})


@pytest.mark.parametrize("value", [math.nan, math.inf, 361.0, "sixty", None])
def test_an_elevation_that_is_no_angle_is_refused(value: Any) -> None:
    with pytest.raises(ValidationError, match="elevations_deg"):
        Plan(elevations_deg=[0.0, value])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("elevation_deg", [0]),
        ("dwell", 2),
        ("kind", "holiday"),
        ("order", "backwards"),
        ("step_deg", 0),
        ("step_deg", -10),
        ("jitter_deg", -1),
        ("settle_s", -1),
        ("dwell_s", 0),
        ("rate_hz", 0),
        ("rate_hz", 200.5),
        ("target_std_deg", 0),
        ("velocity_dps", 0),
        ("velocity_dps", -5),
        ("wait_s", -1),
        ("seed", -1),
        ("seed", 2**63),
    ],
)
def test_an_unknown_field_or_a_value_out_of_range_is_named(name: str, value: Any) -> None:
    with pytest.raises(ValidationError, match=name):
        Plan(**{name: value})


def test_a_dwell_of_less_than_two_samples_is_refused() -> None:
    with pytest.raises(ValidationError, match="fewer than two samples"):
        Plan(dwell_s=0.1, rate_hz=10)
    assert Plan(dwell_s=0.2, rate_hz=10)


@given(jittered)
def test_a_plan_survives_json(plan: dict[str, Any]) -> None:
    before = Plan(**plan)
    assert Plan.model_validate_json(before.model_dump_json()) == before


def test_every_mount_is_visited_once_by_sweeps_that_begin_upward() -> None:
    plan = Plan(elevations_deg=[-20, 20], sweeps=2, mounts_deg=[0, 120, -120])
    poses = plan.poses(LIMITS)
    assert [pose.mount_deg for pose in poses[::4]] == [0, 120, -120]
    assert [pose.target_deg for pose in poses] == [-20, 20, 20, -20] * 3
    assert [pose.sweep for pose in poses] == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert [pose.index for pose in poses] == list(range(12))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ({"mounts_deg": []}, "at least 1 item"),
        ({"mounts_deg": [120, 0, 360]}, "0° and 360° are one mount"),
        ({"mounts_deg": [-120, 240.0]}, "-120° and 240° are one mount"),
        ({"mount_axis": "w"}, "mount_axis"),
        ({"mounts_deg": [0, 90], "sweeps": 500}, "the plan has 13000 poses"),
        ({"mounts_deg": [0, 90], "kind": "static"}, "it has one mount"),
        ({"mount_axis": "-x", "kind": "verification"}, "elevations about x"),
    ],
)
def test_mounts_that_cannot_be_meant_are_refused_by_name(plan: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Plan.model_validate(plan)


def test_a_sweep_dwells_at_its_ends_and_has_stretches_between_them():
    poses = Plan(kind="sweep", start_deg=-20, stop_deg=20, step_deg=10, sweeps=2).poses((-90.0, 90.0))
    assert [pose.target_deg for pose in poses] == [-20, -15, -5, 5, 15, 20, 15, 5, -5, -15, -20]
    assert [k for k, pose in enumerate(poses) if pose.stretch_deg is None] == [0, 5, 10]
    assert [pose.sweep for pose in poses] == [0] * 6 + [1] * 5
    for before, after in pairwise(poses[1:5]):
        assert before.stretch_deg is not None and after.stretch_deg is not None
        assert before.stretch_deg[1] == after.stretch_deg[0]


def test_a_sweep_begins_at_its_start():
    poses = Plan(kind="sweep", start_deg=20, stop_deg=-20, step_deg=20, sweeps=2).poses((-90.0, 90.0))
    assert [pose.target_deg for pose in poses] == [20, 10, -10, -20, -10, 10, 20]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"sweeps": 1}, "both directions"),
        ({"step_deg": 30}, "none longer than 20°"),
        ({"velocity_dps": 50}, "turn slower"),
        ({"mounts_deg": [0, 120]}, "one mount"),
        ({"mount_axis": "y"}, "one mount"),
        ({"elevations_deg": [-10, 10]}, "without stopping"),
        ({"order": "random"}, "without stopping"),
        ({"target_std_deg": 0.01}, "without stopping"),
        ({"jitter_deg": 5}, "a quarter"),
    ],
)
def test_what_a_sweep_cannot_do_is_said(given, said):
    with pytest.raises(ValidationError, match=said):
        Plan(kind="sweep", **given)
