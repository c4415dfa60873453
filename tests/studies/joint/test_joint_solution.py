"""Poses as they come: wild ones, readings that wrap, mounts under wrong names, columns that are missing."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from calrig.calibration.poses import DiagnosisError
from calrig.calibration.separation.accelerometer import IN_PLANE, QUARTIC, plane_vector
from calrig.calibration.separation.least_squares import fitted
from calrig.calibration.separation.problem import DEVIATIONS, Problem
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve

from .cases import BOUNDS, SEVENTHS, TURN, Case, error_deg, solved
from .rig import ISSUE_UNIT, Bench, Design, Stage, Unit

THREE = BOUNDS["0/120/240, ±60°, cubic"]


@pytest.fixture
def bench():
    return THREE.bench(2)


@pytest.fixture
def lots(bench):
    return bench.measured(np.random.default_rng(2))


def told(lots, **options):
    return solution_document(solve(lots, **options))


def test_the_units_parameters_are_those_it_was_made_with():
    made = ISSUE_UNIT
    case = replace(THREE, gap_deg=0.05)
    rig = replace(case.bench(4), units=(made,))
    document = told(rig.measured(np.random.default_rng(4)))
    (unit,) = document["units"]
    truth = {
        "y_mg": made.bias_mg[0],
        "z_mg": made.bias_mg[1],
        "gain_pct": 100.0 * (1.03 / 0.98 - 1.0),
        "skew_deg": made.skew_deg,
        "y_mg_per_g2": made.quadratic_mg[0],
        "y_mg_per_g3": made.cubic_mg[0],
        "z_mg_per_g2": made.quadratic_mg[1],
        "z_mg_per_g3": made.cubic_mg[1],
    }
    for name, true in truth.items():
        found = unit["parameters"][name]
        assert found["value"] == pytest.approx(true, abs=4.0 * found["std"]), name
    play = document["stage"]["backlash_deg"]
    assert play["value"] == pytest.approx(-0.05, abs=4.0 * play["std"])
    for mount, visit in zip(document["mounts"], rig.visits, strict=True):
        apart = (mount["angle_deg"]["value"] - visit.clamp_deg + 180.0) % 360.0 - 180.0
        # against the stage's map the mounts have its mean over the arc, of some tenths of a degree
        assert abs(apart) < 0.5
    assert document["final"]["held_out_rms_deg"] < 0.2 * document["before"]["held_out_rms_deg"]


def test_the_map_is_the_stages_own():
    case = Case(Design(SEVENTHS, TURN), highest=8)
    rig = case.bench(5)
    document = told(rig.measured(np.random.default_rng(5)))
    on_map = document["stage"]["map"]
    dial = np.array(on_map["stage_deg"])
    true = rig.stage.table_deg(dial, np.zeros(len(dial))) - dial
    wrong = np.array(on_map["error_deg"]) - (true - true.mean())
    assert np.abs(wrong / np.array(on_map["std_deg"])).max() < 5.0
    by_order = {harmonic["order"]: harmonic for harmonic in document["stage"]["harmonics"]}
    waves = [wave for wave in rig.stage.waves if wave[0] in by_order]
    assert len(waves) >= 4
    for order, amplitude_deg, phase_deg in waves:
        harmonic = by_order[order]
        found = cmath.rect(harmonic["amplitude_deg"], math.radians(harmonic["phase_deg"]))
        true = cmath.rect(amplitude_deg, math.radians(phase_deg))
        assert abs(found - true) < 5.0 * harmonic["std_deg"]
        assert harmonic["separable"]


def test_a_gear_of_a_known_period_is_in_the_map():
    rig = Bench(
        (ISSUE_UNIT,), Stage(((2, 0.2, 30.0), (50, 0.05, 10.0))), Design((0.0, 120.0, 240.0), TURN).visits()
    )
    rig = replace(
        rig, visits=tuple(replace(v, dial_deg=v.dial_deg + 0.7 * k) for k, v in enumerate(rig.visits))
    )
    found = told(rig.measured(np.random.default_rng(0)), periods_deg=[7.2])["stage"]["harmonics"]
    (worm,) = [harmonic for harmonic in found if harmonic["order"] == 50.0]
    assert worm["amplitude_deg"] == pytest.approx(0.05, abs=4.0 * worm["std_deg"])


def test_derivatives_are_those_of_the_vector():
    rng = np.random.default_rng(0)
    own, elevation, warmer = rng.normal(0.0, 0.03, 13), rng.uniform(-3.0, 3.0, 20), rng.normal(0.0, 2.0, 20)
    whole = plane_vector(own, elevation, warmer)
    step = 1e-6
    for k, change in enumerate(step * np.eye(13)):
        slope = (
            plane_vector(own + change, elevation, warmer).vector_g
            - plane_vector(own - change, elevation, warmer).vector_g
        )
        np.testing.assert_allclose(whole.by_parameters[:, :, k], slope / (2.0 * step), atol=1e-8)
    slope = (
        plane_vector(own, elevation + step, warmer).vector_g
        - plane_vector(own, elevation - step, warmer).vector_g
    )
    np.testing.assert_allclose(whole.by_elevation, slope / (2.0 * step), atol=1e-8)


def test_wild_poses_are_left_out_and_said(lots, bench):
    for place, off in ((5, 0.02), (30, -0.5), (61, 2.0)):
        lots[1].poses[place] = replace(lots[1].poses[place], accel_y_g=lots[1].poses[place].accel_y_g + off)
    solution = solve(lots)
    assert (~solution.fit.kept).sum() == 3
    assert any("3 outliers were left out" in sentence for sentence in solution.warnings)
    assert np.sqrt(np.mean(error_deg(bench, solution) ** 2)) < 3.0 * solution.uncertainties[0].rms_deg


def test_the_order_of_files_and_readings_on_another_turn_change_nothing(lots):
    straight = told(lots)
    turned = [
        replace(lot, poses=[replace(p, reading_deg=p.reading_deg + 360.0 * (k % 2)) for p in lot.poses])
        for k, lot in enumerate(lots)
    ]
    again = told([turned[0], *turned[:0:-1]])  # a unit's offsets are those of its first mount
    first, second = (found["units"][0]["parameters"]["y_mg"]["value"] for found in (straight, again))
    assert second == pytest.approx(first, abs=1e-4)


def test_without_the_accelerometer_less_is_told_and_that_is_said(bench):
    document = told(bench.measured(np.random.default_rng(1), accel=False))
    with_it = told(bench.measured(np.random.default_rng(1)))
    known, better = (max(found["units"][0]["elevation_std_deg"]["std_deg"]) for found in (document, with_it))
    assert known > 1.3 * better
    assert any("accel_y_g" in sentence for sentence in document["warnings"])
    assert document["noise"]["std_deg"] == pytest.approx(bench.noise_deg, rel=0.2)


def test_offsets_that_follow_temperature_are_solved_for():
    unit = Unit((20.0, -30.0), (1.0, 0.0), 0.2, mg_per_c=(0.4, -0.7))
    rig = Bench((unit,), THREE.bench(0).stage, THREE.design.visits(warm_c=5.0))
    found = told(rig.measured(np.random.default_rng(3)))["units"][0]["parameters"]
    for name, true in (("y_mg_per_c", 0.4), ("z_mg_per_c", -0.7)):
        assert found[name]["value"] == pytest.approx(true, abs=4.0 * found[name]["std"])


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_noise_that_is_correlated_from_pose_to_pose_makes_an_elevation_worth_less(bench, correlation):
    document = told(replace(bench, correlation=correlation).measured(np.random.default_rng(8)))
    assert document["noise"]["lag1_correlation"] == pytest.approx(correlation, abs=0.15)
    said = max(document["units"][0]["elevation_std_deg"]["std_deg"])
    best = max(told(bench.measured(np.random.default_rng(8)))["units"][0]["elevation_std_deg"]["std_deg"])
    assert (said > 1.4 * best) == (correlation > 0.0)


def test_a_table_without_an_order_has_no_noise_that_follows_on_itself(bench):
    lots = [
        replace(lot, poses=[replace(p, approach=None, time_s=None) for p in lot.poses])
        for lot in replace(bench, correlation=0.6).measured(np.random.default_rng(8))
    ]
    assert told(lots)["noise"]["lag1_correlation"] == 0.0


@pytest.mark.parametrize("scale", [0.1, 10.0])
def test_the_noise_is_found_and_shrinks_with_the_poses(bench, scale):
    rig = replace(bench, noise_deg=0.03 * scale)
    solution = solved(rig, 0, linear=False)
    assert solution.noise_deg == pytest.approx(rig.noise_deg, rel=0.12)
    assert solution.fit.freedom == pytest.approx(
        2 * 216 - 9 - 3 - 2 * len(solution.choice.orders) - 1, abs=8.0
    )


def test_a_parameter_that_the_data_tell_is_not_held_back_by_what_was_known_before(bench):
    solution = solved(bench, 0, linear=False)
    free = solution.fit.problem.free
    own = np.flatnonzero(free[: IN_PLANE.searchsorted(QUARTIC.start)])
    stds = np.sqrt(np.diag(solution.fit.covariance_at(own)))
    assert (stds < 0.02 * solution.fit.problem.widths()[own]).all()


def test_many_units_cost_no_more_than_their_poses():
    table = solve(
        Bench(
            tuple([ISSUE_UNIT] * 12),
            THREE.bench(0).stage,
            tuple(
                replace(visit, unit=unit, name=f"{unit}/{k}")
                for unit in range(12)
                for k, visit in enumerate(Design((0.0, 120.0, 240.0), n=24).visits())
            ),
        ).measured(np.random.default_rng(0))
    ).table
    fit = fitted(Problem(table, tuple(range(1, 9))), np.ones(len(table)))
    assert fit.parameters.shape == (12 * len(IN_PLANE) + 36 * (DEVIATIONS + 1) + 17,)
    assert np.degrees(fit.noise) == pytest.approx(0.03, rel=0.1)


# --- Bad input: an error or a warning that says which ---


def test_mounts_that_overlap_in_name_and_not_in_angle_are_refused(lots):
    second = replace(lots[1], mount=lots[0].mount, source="other.csv", nominal_deg=lots[0].nominal_deg)
    with pytest.raises(
        DiagnosisError, match=r"mount m0 of unit U0 stands at .*° and at .*° by gravity \(rig, other"
    ):
        solve([lots[0], second, lots[2]])
    with pytest.raises(DiagnosisError, match=r"mount m0 of unit U0 was clamped at 0° and at 120°"):
        solve([lots[0], replace(second, nominal_deg=120.0), lots[2]])


def test_a_mount_of_one_name_that_was_clamped_anew_is_told_of(bench):
    again = replace(bench.visits[0], clamp_deg=bench.visits[0].clamp_deg + 0.3)
    rig = replace(bench, visits=(*bench.visits, again))
    *lots, other = rig.measured(np.random.default_rng(5))
    found = told([*lots, replace(other, source="second.csv")])
    assert any("mount m0 of unit U0: in second.csv it stands" in sentence for sentence in found["warnings"])


def test_poses_that_were_given_twice_are_refused(lots):
    with pytest.raises(DiagnosisError, match=r"b\.csv .* holds the very same poses as rig .* given twice"):
        solve([*lots, replace(lots[1], source="b.csv", mount="b", unit="other")])


def test_most_poses_of_a_file_in_another_are_refused_whatever_it_is_called(lots):
    part = [replace(p, accel_y_g=None, accel_z_g=None) for p in lots[1].poses[:30]]
    own = [replace(p, reading_deg=p.reading_deg + 0.02) for p in lots[1].poses[30:40]]
    with pytest.raises(
        DiagnosisError, match=r"b\.csv .* holds 30 of the same poses as rig \(unit U0, mount m1\)"
    ):
        solve([*lots, replace(lots[1], source="b.csv", mount="b", unit="other", poses=[*part, *own])])


def test_two_units_of_one_name_are_told_of(lots, bench):
    other = replace(bench, units=(Unit((-40.0, 30.0)),)).measured(np.random.default_rng(9))
    two = [
        replace(lot, poses=[*lot.poses, *(replace(p, time_s=p.time_s + 30.0) for p in more.poses)])
        for lot, more in zip(lots, other, strict=True)
    ]
    said = told(two)["warnings"]
    assert any("mount m0 of unit U0: at 30 s its stage stands at -49" in sentence for sentence in said)
    assert any("as no unit at rest does" in sentence for sentence in said)


def test_a_mount_of_one_pose_is_left_out_and_said(lots):
    found = told([*lots, replace(lots[0], mount="lone", poses=[replace(lots[0].poses[0], reading_deg=9.0)])])
    assert any("mount lone of unit U0 has 1 pose" in sentence for sentence in found["warnings"])
    assert [mount["mount"] for mount in found["mounts"]] == ["m0", "m1", "m2"]


def test_a_mount_that_stands_elsewhere_than_was_said_is_told_of(lots):
    found = told([replace(lots[0], nominal_deg=None), replace(lots[1], nominal_deg=90.0), lots[2]])
    said = [sentence for sentence in found["warnings"] if "gravity says" in sentence]
    assert len(said) == 1
    assert said[0].startswith("mount m1 of unit U0: mount_deg is 90, gravity says 1")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: replace(p, reading_deg=-p.reading_deg, accel_y_g=-p.accel_y_g), "turn against the stage"),
        (lambda p: replace(p, reading_deg=np.radians(p.reading_deg)), "m0: .*(radians|no single angle)"),
        (lambda p: replace(p, accel_z_g=9.81 * p.accel_z_g, accel_y_g=9.81 * p.accel_y_g), r"1 g\b"),
    ],
)
def test_readings_that_cannot_be_meant_are_refused(lots, change, words):
    with pytest.raises(DiagnosisError, match=words):
        solve([replace(lots[0], poses=[change(p) for p in lots[0].poses]), *lots[1:]])


def test_too_few_poses_and_other_axes_are_refused(lots):
    with pytest.raises(DiagnosisError, match="4 poses are too few: at least 8"):
        solve([replace(lots[0], poses=lots[0].poses[:4])])
    with pytest.raises(DiagnosisError, match="12 poses are too few for 20 parameters"):
        solve([replace(lot, poses=lot.poses[:4]) for lot in lots])
    with pytest.raises(DiagnosisError, match=r"m0 .*other way round \(mount_axis x\)"):
        solve([replace(lots[0], axis="-x"), *lots[1:]])
    with pytest.raises(DiagnosisError, match="m0: 72 poses lack accel_x_g"):
        solve([replace(lots[0], axis="z"), *lots[1:]])
    with pytest.raises(DiagnosisError, match="mount m1 of unit U0: mount_axis is 'left', which is none of"):
        solve([lots[0], replace(lots[1], axis="left"), lots[2]])


def test_few_angles_of_the_dial_are_told_of_where_the_map_has_as_many_terms():
    bench = replace(THREE, highest=12).bench(0)
    up = np.linspace(-60.0, 60.0, 13)
    dial, approach = np.concatenate([up, up[::-1]]), np.repeat([1.0, -1.0], 13)
    visits = tuple(
        replace(visit, dial_deg=dial, approach=approach, die_c=np.full(26, visit.die_c[0]))
        for visit in bench.visits
    )
    few = told(replace(bench, visits=visits).measured(np.random.default_rng(0)))
    assert any("13 angles of the dial, as few as the map has terms" in said for said in few["warnings"])


def on_a_grid(bench, jitter_deg, rng):
    """The same mounts in four sweeps over 13 elevations."""
    up = np.linspace(-60.0, 60.0, 13)
    approach = np.repeat([1.0, -1.0, 1.0, -1.0], 13)
    return replace(
        bench,
        visits=tuple(
            replace(
                visit,
                dial_deg=np.concatenate([up, up[::-1]] * 2) + rng.uniform(-jitter_deg, jitter_deg, 52),
                approach=approach,
                die_c=np.full(52, visit.die_c[0]),
            )
            for visit in bench.visits
        ),
    )


def test_between_the_angles_of_a_grid_the_map_is_null():
    bench, rng = replace(THREE, highest=12).bench(2), np.random.default_rng(2)
    for jitter_deg, has_gaps in ((0.0, True), (5.0, False)):
        document = told(on_a_grid(bench, jitter_deg, rng).measured(rng))
        found = document["stage"]["map"]
        dial_deg, error, std = (
            np.array(found[key], dtype=np.float64) for key in ("stage_deg", "error_deg", "std_deg")
        )
        known = np.isfinite(error)
        assert (known == np.isfinite(std)).all()
        on_grid = np.abs(dial_deg - 10.0 * np.rint(dial_deg / 10.0)) < 0.5
        assert (known == on_grid).all() if has_gaps else known.all()
        error = error - bench.stage.table_deg(dial_deg, np.zeros(len(dial_deg))) + dial_deg
        error -= error[known].mean()
        assert np.mean(np.abs(error[known]) < 2.0 * std[known]) > 0.8
        assert any("null there" in said for said in document["warnings"]) is has_gaps
