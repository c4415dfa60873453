"""What the diagnosis says in other worlds than the first board's: of each cell a run, pooled.

`python -m tests.studies.blind --worlds` makes the whole table.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.line import fit_line, residuals_deg

from .layout import timeline
from .limits import AT_THE_LIMIT, TIMES_THE_LIMIT, distance
from .world_board import WorldJudgement, WorldTask, judge_world
from .worlds import HARD, NULLS, WORLDS, World

BOOTSTRAPS = 199
EVERY_OTHER = 2
"""Cells of the share that CI judges."""


@cache
def share() -> tuple[list[WorldJudgement], list[WorldJudgement]]:
    """One run of every other cell with effects, and one of white noise alone, of all worlds but the dear."""
    cells = [(w.name, c) for w in WORLDS.values() if not w.dear for c in w.cells if (w.name, c) not in HARD]
    tasks = [WorldTask(*at, 0, False, BOOTSTRAPS) for at in cells[::EVERY_OTHER]]
    nulls = [WorldTask(w.name, "nothing", 0, False, BOOTSTRAPS) for w in WORLDS.values() if not w.dear]
    return [judge_world(task) for task in tasks], [judge_world(task) for task in nulls]


@pytest.mark.statistical
@pytest.mark.timeout(600)
def test_effects_of_five_times_the_limit_are_found_and_named() -> None:
    judged, _ = share()
    assert sum(j.found for j in judged) >= len(judged) - 2
    assert sum(j.held for j in judged) >= len(judged) - 2
    assert sum(j.wrong_name for j in judged) <= 2


@pytest.mark.statistical
@pytest.mark.timeout(600)
def test_sets_are_no_larger_than_an_oracles_that_knows_the_noise() -> None:
    judged, _ = share()
    assert np.mean([j.set_excess for j in judged if j.set_excess is not None]) <= 0.3


@pytest.mark.statistical
@pytest.mark.timeout(600)
def test_of_noise_alone_no_world_makes_an_effect() -> None:
    _, nulls = share()
    assert sum(j.said != "nothing" for j in nulls) <= 2  # of 17 at about 1 %


@pytest.mark.parametrize("world", ["first board", "eleven turns", "constant speed, one way", "noise 0.3°"])
def test_an_effect_is_five_times_as_large_as_the_least_that_shows(world: str) -> None:
    chosen = WORLDS[world]
    cell = next(iter(chosen.cells))
    run = chosen.run(cell, 4)
    target_deg = np.array([pose.target_deg for pose in run.poses])
    found = distance(run.truths[0].shape_deg, target_deg, chosen.noise)
    assert found == pytest.approx(TIMES_THE_LIMIT**2 * AT_THE_LIMIT, rel=0.05)


def test_the_same_seed_gives_the_same_run_and_one_cause_of_it_the_same_noise() -> None:
    world = WORLDS["several units"]
    cell = "backlash, each with its tempco"
    run, again, first = world.run(cell, 2), world.run(cell, 2), world.run(cell, 2, only=0)
    assert [p.reading_deg for p in run.poses] == [p.reading_deg for p in again.poses]
    left = np.array([p.reading_deg - q.reading_deg for p, q in zip(run.poses, first.poses, strict=True)])
    assert left == pytest.approx(run.truths[1].shape_deg, abs=1e-4)


@pytest.mark.parametrize(
    "world", [world for world in WORLDS.values() if not world.dear], ids=lambda w: w.name
)
def test_noise_is_all_that_a_null_leaves(world: World) -> None:
    poses = world.run("nothing", 1).poses
    theta, reading = (np.array([getattr(p, name) for p in poses]) for name in ("theta_deg", "reading_deg"))
    line = fit_line(theta, reading)
    left_deg = residuals_deg(theta, reading, line.bias_deg, line.scale)
    assert left_deg.std() == pytest.approx(world.noise.reading_deg, rel=0.5)
    assert set(world.nulls) <= set(NULLS)


def test_read_on_the_move_time_and_angle_are_one_thing() -> None:
    when = timeline(WORLDS["constant speed, one way"].layout(np.random.default_rng(0)))
    assert np.corrcoef(when.begin_s, when.target_deg)[0, 1] == pytest.approx(1.0, abs=1e-9)


def test_a_slip_that_a_warm_up_hides_is_found_with_it() -> None:
    run = WORLDS["first board"].run("slip against temperature", 0)
    found = document(diagnose([run.poses], bootstraps=BOOTSTRAPS, cross_fit=False), ["1"])
    assert {"mount_slip", "temperature_bias"} <= {effect["name"] for effect in found["effects"]}


def test_a_slip_of_20_degrees_is_one_though_the_gyro_feels_it_by_its_own_gain() -> None:
    run = WORLDS["20° beside 0.02°"].run("slip of 20°, temperature", 1)
    found = document(diagnose([run.poses], bootstraps=BOOTSTRAPS, cross_fit=False), ["1"])
    slips = [e["parameters"]["step_deg"] for e in found["effects"] if e["name"] == "mount_slip"]
    (true,) = (t.parameters["step_deg"] for t in run.truths if t.cause.name == "mount_slip")
    (slip,) = slips
    assert slip["value"] == pytest.approx(true, abs=4.0 * slip["std"])
