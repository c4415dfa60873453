"""The level by reversal: the same face turned by 180° about the vertical, on a base that is out of level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calrig.calibration.poses import DiagnosisError
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve
from calrig.export.solution_documents import unit_document

from .cases import GRID, absolute_error_deg
from .rig import Bench, Design, drawn_stage, drawn_unit

SEAT_DEG = 0.02


def reversed_bench(
    seed: int, *, reversals: int = 1, seat_deg: float = SEAT_DEG, base_deg: float = 0.7, at: int = 0
) -> Bench:
    """A unit turned in its case by a degree or so, clamped at 0/120/240, and at one of them both ways round.

    Each clamping misses its seat by an error of its own; those after the first reversal are repetitions.
    """
    rng = np.random.default_rng([seed, 77])
    unit = replace(drawn_unit(rng), in_case_deg=float(rng.normal(0.0, 1.0)))
    visits = list(Design((0.0, 120.0, 240.0), n=36).visits(rng))
    for k in range(reversals):
        again = [] if k == 0 else [replace(visits[at], name=f"again {k}")]
        visits += [*again, replace(visits[at], name=f"reversed {k}", reversed=True)]
    seats = rng.normal(0.0, seat_deg, len(visits))
    missed = (replace(v, clamp_deg=v.clamp_deg + float(off)) for v, off in zip(visits, seats, strict=True))
    return Bench((unit,), drawn_stage(rng, 8), tuple(missed), base_deg=base_deg)


def measured(bench: Bench, seed: int = 0):
    return bench.measured(np.random.default_rng([seed, 78]))


def test_a_reversal_tells_the_level_whatever_the_base_does():
    for base_deg in (0.0, 0.7, 5.0):
        bench = reversed_bench(1, base_deg=base_deg)
        document = solution_document(solve(measured(bench), seat_std_deg=SEAT_DEG))
        level = document["units"][0]["level"]
        assert level["deg"]["value"] == pytest.approx(
            bench.units[0].in_case_deg, abs=3.0 * level["deg"]["std"]
        )
        assert SEAT_DEG / 2**0.5 < level["deg"]["std"] < SEAT_DEG, "a seat's error in each half of the sum"
        assert (document["level_known"], document["level_std_deg"]) == (True, level["deg"]["std"])
        assert document["separable"], "seats that scatter more than the poses are no ignorance of the stage"


@pytest.mark.parametrize("at", [1, 2])
def test_a_reversed_unit_has_the_angle_of_its_seat(at):
    bench = reversed_bench(8, at=at)
    document = solution_document(solve(measured(bench), seat_std_deg=SEAT_DEG))
    *_, mount = document["mounts"]
    assert (mount["mount_axis"], mount["mount_deg"]) == ("-x", 120.0 * at)
    assert np.cos(np.radians(mount["angle_deg"]["value"] - 120.0 * at)) > np.cos(np.radians(5.0))
    assert not [said for said in document["warnings"] if "gravity says" in said]
    level = document["units"][0]["level"]["deg"]
    assert level["value"] == pytest.approx(bench.units[0].in_case_deg, abs=3.0 * level["std"])


def test_the_calibration_then_is_of_the_elevation_itself():
    bench = reversed_bench(2)
    solution = solve(measured(bench), seat_std_deg=SEAT_DEG)
    document = unit_document(solution, 0)
    error = absolute_error_deg(bench, document)
    stated = document["elevation_std_deg"]
    std_deg = np.interp(GRID, stated["elevation_deg"], stated["std_deg"])
    assert (np.abs(error) < 3.0 * std_deg).all()
    assert document["level_known"] is True
    assert document["bias_deg"] == solution.levels[0].value_deg
    assert (std_deg >= 0.9 * document["level_std_deg"]).all(), "the level is in it"
    assert np.sqrt(document["covariance"][0][0]) >= 0.9 * document["level_std_deg"]
    assert document["uncertainty"]["type_b_deg"] > solution.uncertainties[0].rms_deg


def test_without_a_word_on_the_seat_the_level_is_not_known_and_that_is_said():
    document = solution_document(solve(measured(reversed_bench(3))))
    (unit,) = document["units"]
    assert (document["level_known"], document["level_std_deg"]) == (False, None)
    assert (unit["level"]["deg"]["std"], unit["level"]["seat_from"]) == (None, None)
    (said,) = [sentence for sentence in document["warnings"] if "--seat-std" in sentence]
    assert "unit U0 was reversed, which has its level at" in said
    assert max(unit["elevation_std_deg"]["std_deg"]) < 0.02, "of the elevation less its mean, as before"


def test_reversals_that_are_repeated_tell_how_well_seats_repeat():
    bench = reversed_bench(4, reversals=4)
    level = solve(measured(bench)).levels[0]
    assert level.seat_from == "repeats"
    assert level.seat_std_deg == pytest.approx(SEAT_DEG, rel=0.7), "of eight clampings on one seat"
    assert level.value_deg == pytest.approx(bench.units[0].in_case_deg, abs=3.0 * level.std_deg)
    stated = solution_document(solve(measured(bench), seat_std_deg=0.002))
    assert any("scatter more widely than 0.002° as stated" in said for said in stated["warnings"])


@pytest.mark.parametrize("reversals", [2, 4])
def test_the_level_of_repeated_reversals_is_students_t(reversals):
    """The closed form where the poses tell the angles exactly: clampings both ways round, of one variance.

    Seat and level take two degrees of freedom from the clampings; two standard errors hold the probability
    that two of a normal distribution hold.
    """
    seat_deg = 0.2  # the poses' own errors are far below it
    solution = solve(measured(reversed_bench(11, reversals=reversals, seat_deg=seat_deg)))
    angles_deg = [
        (mount["mount_axis"], (mount["angle_deg"]["value"] + 180.0) % 360.0 - 180.0)
        for mount in solution_document(solution)["mounts"]
        if mount["mount_deg"] == 0.0
    ]
    ways = [np.array([angle for axis, angle in angles_deg if axis == way]) for way in ("x", "-x")]
    assert [len(way) for way in ways] == [reversals, reversals]
    squares = sum(float(((way - way.mean()) ** 2).sum()) for way in ways)
    freedom = 2 * reversals - 2
    std_deg = np.sqrt(squares / freedom / (2 * reversals))
    expected_deg = stats.t.isf(0.5 * (1.0 - stats.chi2.cdf(4.0, 1)), freedom) * std_deg / 2.0
    assert solution.levels[0].std_deg == pytest.approx(expected_deg, rel=0.03)


def test_a_reversal_on_another_seat_tells_no_level():
    *upright, other = measured(reversed_bench(5))
    for stated_deg in (120.0, 90.0):  # of a seat where it does not stand, and of one that nobody else had
        found = solve([*upright, replace(other, nominal_deg=stated_deg)], seat_std_deg=SEAT_DEG)
        assert found.levels == (None,)


def test_a_mount_of_one_name_that_was_reversed_needs_another():
    lots = measured(reversed_bench(6))
    with pytest.raises(DiagnosisError, match="mount m0 of unit U0 has its axis x and its axis -x along"):
        solve([*lots[:-1], replace(lots[-1], mount="m0", source="second.csv")])


@pytest.mark.statistical
@pytest.mark.parametrize(("reversals", "stated"), [(1, SEAT_DEG), (2, None)])
def test_a_level_is_known_as_well_as_is_said(reversals, stated):
    within = []
    for seed in range(40):
        bench = reversed_bench(seed, reversals=reversals)
        level = solve(measured(bench, seed), seat_std_deg=stated).levels[0]
        within.append(abs(level.value_deg - bench.units[0].in_case_deg) < 2.0 * level.std_deg)
    assert np.mean(within) > 0.84, "95.4 %; 84 % of 40 in less than one case in two hundred"
