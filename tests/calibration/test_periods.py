"""Periods of a stage: orders of the turn, periods that the spacing confuses, how well each is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from posed import posed
from support import one_now

from calrig.calibration.diagnosis.candidate_fits import refined
from calrig.calibration.diagnosis.candidates import candidate_of, candidates_of, harmonics_of
from calrig.calibration.diagnosis.families import with_families, with_free_orphans
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.selection import search
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.effects import EFFECTS
from calrig.calibration.effects.stage_periodic import window_peaks
from calrig.calibration.packed_poses import packed
from calrig.calibration.regression.request import DiagnosisRequest
from calrig.calibration.regression.responses import responses_of
from calrig.estimation.angles import wrap_deg

NOISE_DEG = 0.05


def measured(targets_deg, waves, rng, *, seconds_a_pose=None):
    """Poses of a stage whose table is off by waves (period, amplitude, phase), read with noise."""
    table = targets_deg + sum(a * np.sin(np.radians(360.0 * targets_deg / p + f)) for p, a, f in waves)
    readings = 0.5 + table + rng.normal(0.0, NOISE_DEG, len(table))
    time_s = None if seconds_a_pose is None else seconds_a_pose * np.arange(len(table))
    return posed(target_deg=targets_deg, reading_deg=readings, time_s=time_s)


def effects_in(poses):
    return document(diagnose([poses], bootstraps=199, cross_fit=False), ["a run"])["effects"]


def periods_in(effects):
    """The period that each effect states, or 360 for what only order 1 explains."""
    return {e["parameters"].get("period_deg", {"value": 360.0})["value"] for e in effects}


def test_four_waves_a_turn_at_irregular_poses_are_order_4_of_the_turn():
    rng = np.random.default_rng(1)
    (effect,) = effects_in(measured(np.sort(rng.uniform(0.0, 360.0, 160)), [(90.0, 1.0, 30.0)], rng))
    assert (effect["name"], effect["verdict"]) == ("stage_periodic", "named")
    assert effect["parameters"]["period_deg"]["value"] == 90.0
    assert "order 4 of the turn" in effect["evidence"]


@pytest.mark.parametrize("first_deg", one_now([27.0, 207.0]))
def test_a_sensor_over_its_own_turn_has_its_orders_wherever_the_table_begins(first_deg):
    """Even steps; small orders beside large ones, as hand fits of a public encoder's table found them."""
    amplitudes_deg = {1: 1.542, 2: 0.125, 3: 0.037, 4: 0.044, 5: 0.013, 50: 0.035, 100: 0.038}
    truth_deg = np.arange(0.0, 360.0, 1.8)
    noise_deg = np.random.default_rng(7).normal(0.0, 0.0136, 200)
    error_deg = sum(a * np.sin(np.radians(k * truth_deg + 41.0 * k)) for k, a in amplitudes_deg.items())
    turned = np.roll(np.arange(200), -round(first_deg / 1.8))
    targets_deg = first_deg + 1.8 * np.arange(200)
    readings_deg = targets_deg + (error_deg + noise_deg)[turned]
    request = DiagnosisRequest("good")
    poses = posed(target_deg=targets_deg, reading_deg=readings_deg)
    found = document(diagnose([poses], request=request, bootstraps=199, cross_fit=False), ["a table"])
    orders = {
        round(360.0 / e["parameters"]["period_deg"]["value"], 6): e["parameters"]["amplitude_deg"]
        for e in found["effects"]
        if e["name"] == "stage_periodic"
    }
    assert orders.keys() >= {2.0, 3.0, 4.0, 5.0, 50.0}
    for order, amplitude in orders.items():
        assert abs(amplitude["value"] - amplitudes_deg.get(order, 0.0)) < 3.0 * amplitude["std"]


@pytest.mark.parametrize(("phase_deg", "decimals"), [(200.0, 9), (200.0, 4), (20.0, 4), (110.0, 2)])
def test_rounding_of_the_readings_is_no_period_of_the_axis(phase_deg, decimals):
    """At even poses errors of whole counts are waves, each many standard errors large."""
    there_deg = np.arange(0.0, 360.0, 5.0)
    targets_deg = np.concatenate([there_deg, there_deg[::-1]])
    count_deg = 360.0 / 512.0
    once_deg = 0.8 * np.sin(np.radians(targets_deg + phase_deg))
    readings_deg = count_deg * np.round((targets_deg + once_deg) / count_deg)
    printed_deg = readings_deg.round(decimals)
    poses = posed(target_deg=targets_deg, reading_deg=printed_deg, time_s=3.0 * np.arange(144))
    request = DiagnosisRequest("good")
    found = document(diagnose([poses], request=request, bootstraps=199, cross_fit=False), ["a table"])
    assert len(found["effects"]) == 1
    assert found["effects"][0]["name"] != "stage_periodic"


def test_a_temperature_is_found_in_readings_rounded_as_coarsely():
    """A drift of 0.04° beside readings printed to 0.1°."""
    rng = np.random.default_rng(3)
    targets_deg, celsius = np.tile(np.arange(-60.0, 61.0, 5.0), 8), np.linspace(20.0, 40.0, 200)
    readings_deg = (targets_deg + 0.003 * (celsius - 30.0) + rng.normal(0.0, 0.02, 200)).round(1)
    poses = posed(target_deg=targets_deg, reading_deg=readings_deg, temperature_c=celsius)
    assert any(e["covariate"] == "temperature_c" for e in effects_in(poses))


@pytest.mark.parametrize("jitter_deg", one_now([0.5, 0.6]))
def test_jitter_carries_a_worm_from_either_side(jitter_deg):
    rng = np.random.default_rng(8)
    up_deg = np.arange(-60.0, 60.1, 5.0)
    targets_deg = np.tile(np.concatenate([up_deg, up_deg[::-1]]), 2)
    targets_deg += rng.uniform(-jitter_deg, jitter_deg, len(targets_deg))
    (effect,) = effects_in(measured(targets_deg, [(7.2, 0.2, 0.0)], rng, seconds_a_pose=4.0))
    assert effect["parameters"]["period_deg"]["value"] == pytest.approx(7.2, rel=0.01)


def turned_once(rng, *, over_deg=360.0):
    """Columns of 160 poses of an axis with order 4, its reading and its accelerometer of equal noise."""
    targets = rng.uniform(-over_deg / 2.0, over_deg / 2.0, 160)
    table = targets + np.sin(np.radians(4.0 * targets + 30.0))
    seen = table + rng.normal(0.0, NOISE_DEG, 160)
    gravity = {"accel_y_g": np.sin(np.radians(seen)), "accel_z_g": np.cos(np.radians(seen))}
    readings = 0.5 + table + rng.normal(0.0, NOISE_DEG, 160)
    return {"target_deg": targets, "reading_deg": readings, **gravity}, seen


@pytest.mark.parametrize("seed", one_now(range(6)))
def test_an_angle_of_the_accelerometer_that_wraps_takes_neither_the_scale_nor_the_turns_order(seed):
    columns, seen = turned_once(np.random.default_rng(200 + seed))
    found = document(diagnose([posed(**columns, accel_deg=wrap_deg(seen))], bootstraps=199), ["a run"])
    (effect,) = found["effects"]
    assert "order 4 of the turn" in effect["evidence"]
    assert found["final"]["held_out_rms_deg"] <= 0.06
    assert any("accel_deg" in said for said in found["warnings"])


def test_a_stages_report_within_one_turn_is_taken_on_the_turn_of_its_target():
    columns, _ = turned_once(np.random.default_rng(206), over_deg=1100.0)
    poses = posed(**columns, stage_deg=wrap_deg(columns["target_deg"] + 0.1))
    theta_deg = [pose.theta_deg for pose in poses]
    assert theta_deg == pytest.approx(columns["target_deg"] + 0.1)
    assert packed({"a run": poses}).theta_deg.tolist() == theta_deg


def test_a_series_of_more_orders_than_a_search_takes_effects_is_found_whole():
    rng = np.random.default_rng(2)
    orders = (1, 2, 3, 4, 8, 12, 16)
    waves = [(360.0 / k, 0.4, 50.0 * k) for k in orders]
    effects = effects_in(measured(rng.uniform(0.0, 360.0, 160), waves, rng))
    assert periods_in(effects) == {360.0 / k for k in orders}


def test_orders_at_nearly_even_poses_are_not_taken_for_what_the_spacing_makes_of_them():
    rng = np.random.default_rng(3)
    targets = 6.0 * np.arange(60) + rng.uniform(-0.3, 0.3, 60)
    effects = effects_in(measured(targets, [(90.0, 1.0, 10.0), (45.0, 0.5, 80.0)], rng))
    assert periods_in(effects) == {90.0, 45.0}


def test_a_worm_between_the_steps_of_an_exact_grid_is_one_of_a_set_the_longest_first():
    """On a grid of 5° the waves of 9° and 11.25° are one: 1/9 + 1/11.25 = 1/5."""
    rng = np.random.default_rng(4)
    grid = np.tile(np.arange(-60.0, 60.1, 5.0), 4)
    (effect,) = effects_in(measured(grid, [(9.0, 0.2, 0.0)], rng))
    assert (effect["verdict"], effect["confusable_with"]) == ("ambiguous", ["stage_periodic"])
    stated = effect["parameters"]["period_deg"]
    assert stated["value"] == pytest.approx(11.25, abs=5.0 * stated["std"])
    (said,) = (said for said in effect["evidence"] if "would look the same" in said)
    longest_but_one = float(said.removeprefix("a period of ").partition("°")[0])
    assert longest_but_one == pytest.approx(9.0, abs=0.05)


def test_one_pose_off_a_nearly_even_spacing_does_not_make_a_wave_its_alias():
    """Every 2° a wave of 55.5° is one of 2.0748°, from which only the pose a fifth of a step off tells it."""
    rng = np.random.default_rng(8)
    targets, wave = 2.0 * np.arange(200) + rng.normal(0.0, 0.01, 200), (55.5, 0.2, 0.0)
    targets[55] += 0.4
    alias_deg = -0.2 * np.sin(2.0 * np.pi * targets[55] * (1.0 / 2.0 - 1.0 / 55.5))
    poses = measured(targets, [wave], rng)
    poses[55] = replace(poses[55], reading_deg=0.5 + targets[55] + alias_deg)
    (effect,) = effects_in(poses)
    assert (effect["verdict"], effect["confusable_with"]) == ("ambiguous", ["stage_periodic"])
    assert effect["parameters"]["period_deg"]["value"] == pytest.approx(55.5, abs=1.0)
    assert any("2.07" in said for said in effect["evidence"] if "would look the same" in said)


@pytest.mark.parametrize("jitter_deg", one_now([0.05, 0.0]))
def test_a_wave_of_twice_an_even_step_alternates_and_is_no_wave_of_any_amplitude(jitter_deg):
    rng = np.random.default_rng(10)
    targets = 3.0 * np.arange(60) + rng.uniform(-jitter_deg, jitter_deg, 60)
    waves = [(6.0, 0.3, 40.0)]
    found = document(diagnose([measured(targets, waves, rng)], bootstraps=199), ["a run"])
    (effect,) = found["effects"]
    stated = effect["parameters"]
    assert (effect["name"], stated["period"]["value"]) == ("unnamed", pytest.approx(6.0, rel=1e-3))
    assert stated["size_deg"]["value"] > 10.0 * stated["size_deg"]["std"]
    assert found["final"]["held_out_rms_deg"] < 1.2 * NOISE_DEG


def test_even_poses_carry_no_period_near_twice_their_spacing_and_none_beyond_the_arc():
    effect = EFFECTS["stage_periodic"]
    rng = np.random.default_rng(11)
    even, jitter = 5.0 * np.arange(40), rng.uniform(-2.0, 2.0, 40)
    nearest = 1.0 / (1.0 / 10.0 - 1.0 / 195.0)

    def carried(targets, period_deg):
        r = responses_of([measured(targets, [], rng)])
        (shape,) = effect.forms(r, {"period_deg": period_deg})
        return effect.carried(r, shape)

    assert not any(carried(even, period) for period in (10.0, 0.99 * nearest, 10.0 / 3.0, 5.0, 196.0, 361.0))
    assert carried(even, 1.01 * nearest)
    assert carried(even + jitter, 10.0)
    assert not carried(even + jitter, 210.0)


def test_a_table_of_even_readings_carries_no_period_near_their_step():
    """Its elevations are uneven by the error itself, which any wave near the step then follows."""
    rng = np.random.default_rng(14)
    readings = 1.8 * np.arange(200)
    targets = readings.copy()
    for _ in range(20):  # the elevations that are read so
        bump = 0.3 * np.exp(-(((targets - 130.0) / 30.0) ** 2))
        targets = readings - 0.6 * np.sin(np.radians(targets)) - bump
    poses = posed(target_deg=targets + rng.normal(0.0, 0.002, 200), reading_deg=readings)
    assert min(periods_in(effects_in(poses))) > 2.0 * 1.8


def test_orders_side_by_side_in_a_table_by_counts_are_each_found_and_no_alias_of_theirs():
    """Of 64 counts a turn: what looks like 6½ cycles is orders 6 and 7, and 21 is not 64 − 21."""
    rng = np.random.default_rng(16)
    readings = 5.625 * np.arange(64)
    sizes = {1: 0.3, 2: 0.3, 4: 0.15, 6: 0.1, 7: 0.1, 21: 0.08}
    targets = readings.copy()
    for _ in range(20):  # the elevations that are read so
        waves = sum(size * np.sin(np.radians(k * targets + 50.0 * k)) for k, size in sizes.items())
        targets = readings - waves
    poses = posed(target_deg=targets + rng.normal(0.0, 0.01, 64), reading_deg=readings)
    assert periods_in(effects_in(poses)) == {360.0 / order for order in sizes}


@pytest.mark.parametrize(("arc_deg", "verdict"), [(140.0, "ambiguous"), (356.0, "named")])
def test_a_period_of_the_turn_is_preferred_to_its_alias_at_even_steps(arc_deg, verdict):
    rng = np.random.default_rng(13)
    targets = np.arange(-arc_deg / 2.0, arc_deg / 2.0 + 0.1, 4.0)
    (effect,) = effects_in(measured(np.tile(targets, 2), [(90.0, 0.3, 0.0)], rng))
    assert (effect["verdict"], effect["parameters"]["period_deg"]["value"]) == (verdict, 90.0)
    assert any("3.83" in said for said in effect["evidence"] if "would look the same" in said)


def test_jitter_tells_the_same_worm_from_its_aliases():
    rng = np.random.default_rng(5)
    targets = np.tile(np.arange(-60.0, 60.1, 5.0), 4) + rng.uniform(-2.0, 2.0, 100)
    (effect,) = effects_in(measured(targets, [(9.0, 0.2, 0.0)], rng))
    assert (effect["verdict"], effect["confusable_with"]) == ("named", [])
    stated = effect["parameters"]["period_deg"]
    assert stated["value"] == pytest.approx(9.0, abs=5.0 * stated["std"])


def family_of(r, *known_deg):
    """The periods that are offered without a scan, by the series that they are terms of."""
    r = replace(r, known_periods_deg=known_deg)
    offered = [c for c in candidates_of(r) if c.name == "stage_periodic" and "harmonic" in c.shape.at]
    return r, offered


def test_a_known_period_and_its_harmonics_are_candidates_that_pay_for_no_scan():
    rng = np.random.default_rng(14)
    _, offered = family_of(responses_of([measured(rng.uniform(-60.0, 60.0, 80), [], rng)]), 9.3)
    alone = [c for c in offered if c.beside is None]
    assert [c.shape.at["period_deg"] for c in alone] == pytest.approx([9.3 / k for k in range(1, 9)])
    assert [c.parameters for c in alone] == [2] * 8
    assert [len(c.members) for c in offered if c.beside is not None] == [2, 3, 4, 5, 6, 7, 8]


def test_harmonics_of_even_poses_end_where_their_spacing_takes_them_for_longer_ones():
    rng = np.random.default_rng(14)
    _, offered = family_of(responses_of([measured(np.arange(-60.0, 60.1, 1.5), [], rng)]), 9.3)
    alone = [c.shape.at["period_deg"] for c in offered if c.beside is None]
    assert alone == pytest.approx([9.3 / k for k in (1, 2, 3)])  # a quarter would be less than 3°


@pytest.mark.parametrize("known_deg", [(), (9.3,)])
def test_a_worm_too_weak_to_be_found_among_all_periods_is_found_where_it_is_known(known_deg):
    rng = np.random.default_rng(15)
    targets = rng.uniform(-60.0, 60.0, 120)
    poses = measured(targets, [(9.3, 0.028, 20.0), (4.65, 0.028, 60.0), (3.1, 0.028, 100.0)], rng)
    r, _ = family_of(responses_of([poses]), *known_deg)
    found = search(r, candidates_of(r), np.random.default_rng(0), bootstraps=199).found
    harmonics = [9.3 / f.candidate.shape.at["period_deg"] for f in found]
    assert bool(harmonics) is bool(known_deg)
    assert set(harmonics) <= {1.0, 2.0, 3.0}


def test_harmonics_of_a_period_that_was_found_are_offered_with_it():
    rng = np.random.default_rng(16)
    r = responses_of([measured(np.arange(-60.0, 60.1, 1.5), [], rng)])
    (shape,) = EFFECTS["stage_periodic"].forms(r, {"period_deg": 9.3})
    worm = candidate_of(r, EFFECTS["stage_periodic"], shape)
    offered = harmonics_of(r, [worm])
    assert [c.shape.at["period_deg"] for c in offered if c.beside is None] == pytest.approx([4.65, 3.1])
    assert len({c.shape.series for c in offered}) == 1
    assert len(harmonics_of(r, [worm, offered[0]])) < len(offered)


WORM_SIZES_DEG = {1: 0.03, 2: 0.004, 3: 0.0025, 4: 0.001, 5: 0.0008}


def worm_read_finely(worm_deg, seed):
    """Poses that jitter, and readings of a worm whose wave is 300 times their noise of 0.0001°."""
    rng = np.random.default_rng(seed)
    targets_deg = np.linspace(-60.0, 60.0, 360) + rng.uniform(-0.1, 0.1, 360)
    waves = (a * np.sin(2.0 * np.pi * k * targets_deg / worm_deg + k) for k, a in WORM_SIZES_DEG.items())
    return targets_deg, targets_deg + 0.3 + sum(waves) + rng.normal(0.0, 1e-4, 360)


@pytest.mark.parametrize("worm_deg", [2.7, 2.5])  # the latter is an order of the turn
@pytest.mark.parametrize("seed", one_now(range(4)))
def test_a_strong_worm_is_one_period_and_predicts_as_well_as_a_fit_by_who_knows_it(worm_deg, seed):
    targets_deg, readings_deg = worm_read_finely(worm_deg, seed)
    poses = posed(target_deg=targets_deg, reading_deg=readings_deg)
    found = document(diagnose([poses], bootstraps=199, request=DiagnosisRequest("good")), ["a run"])
    periods = [effect["parameters"]["period_deg"] for effect in found["effects"]]
    first = max(periods, key=lambda period: period["value"])
    assert sorted(period["value"] / first["value"] for period in periods) == pytest.approx(
        [1 / 5, 1 / 4, 1 / 3, 1 / 2, 1.0], rel=1e-12
    )
    assert first["value"] == pytest.approx(worm_deg, abs=4.0 * first["std"])
    if first["value"] != worm_deg:  # else an order of the turn, which is exact
        assert [p["std"] / p["value"] for p in periods] == pytest.approx([first["std"] / first["value"]] * 5)

    phases = 2.0 * np.pi * np.outer(targets_deg, np.arange(1, 6)) / worm_deg
    known = np.column_stack([np.ones(360), targets_deg, np.sin(phases), np.cos(phases)])
    fold, left_deg = np.arange(360) % 4, np.zeros(360)
    for k in range(4):
        beta = np.linalg.lstsq(known[fold != k], readings_deg[fold != k], rcond=None)[0]
        left_deg[fold == k] = readings_deg[fold == k] - known[fold == k] @ beta
    assert found["final"]["held_out_rms_deg"] < 1.1 * np.sqrt(np.mean(left_deg**2))


def waves_at(r, *places):
    effect = EFFECTS["stage_periodic"]
    shapes = [shape for at in places for shape in effect.forms(r, at)]
    return [SelectedEffect(candidate_of(r, effect, shape), (), 0.001, 9.0) for shape in shapes]


def places_in(found):
    return {f.candidate.shape.at["period_deg"]: f.candidate.shape.at.get("harmonic") for f in found}


@pytest.mark.parametrize("sequence", list(permutations([2.7003, 1.35007, 0.67497])))
def test_waves_become_harmonics_of_the_longest_in_whatever_sequence_they_were_found(sequence):
    targets_deg, readings_deg = worm_read_finely(2.7, 0)
    r = responses_of([posed(target_deg=targets_deg, reading_deg=readings_deg)])
    tied = with_families(r, waves_at(r, *({"period_deg": period_deg} for period_deg in sequence)))
    longest = max(places_in(tied))
    assert places_in(tied) == {longest: None, longest / 2.0: 2.0, longest / 4.0: 4.0}
    assert longest == pytest.approx(2.7, abs=1e-3)
    assert with_families(r, tied) is tied


def test_a_harmonic_whose_first_wave_has_left_has_a_period_of_its_own_and_its_standard_error():
    targets_deg, readings_deg = worm_read_finely(2.7, 0)
    r = responses_of([posed(target_deg=targets_deg, reading_deg=readings_deg)])
    (harmonic,) = waves_at(r, {"period_deg": 1.3501, "harmonic": 2.0, "of_deg": 2.7002})
    (free,) = with_free_orphans(r, [harmonic])
    assert free.candidate.shape.at.keys() == {"period_deg"}
    found_deg, std_deg = (of["period_deg"] for of in (free.candidate.shape.at, free.candidate.shape.at_std))
    assert found_deg == pytest.approx(1.35, abs=4.0 * std_deg)


@pytest.mark.statistical
def test_the_standard_error_of_a_worm_s_period_allows_for_its_harmonics():
    off = []
    for seed in range(20, 50):
        targets_deg, readings_deg = worm_read_finely(2.7, seed)
        poses = posed(target_deg=targets_deg, reading_deg=readings_deg)
        periods = [effect["parameters"]["period_deg"] for effect in effects_in(poses)]
        first = max(periods, key=lambda period: period["value"])
        off.append((first["value"] - 2.7) / first["std"])
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.4)  # three times 1/√(2·30)


@pytest.mark.parametrize("seed", one_now(range(3)))
def test_orders_of_an_axis_and_the_electrical_period_of_its_motor_are_found_at_once(seed):
    rng = np.random.default_rng(17 + seed)
    sizes = {1: 0.4, 2: 0.2, 4: 0.3, 8: 0.1, 50: 0.08}
    waves = [(360.0 / order, size, 40.0 * order) for order, size in sizes.items()]
    found = periods_in(effects_in(measured(rng.uniform(0.0, 360.0, 200), waves, rng)))
    assert sorted(found) == pytest.approx(sorted(360.0 / order for order in sizes), rel=0.005)


def test_at_constant_speed_a_wave_of_the_angle_is_no_cycle_of_time():
    rng = np.random.default_rng(6)
    targets = np.linspace(0.0, 720.0, 200)
    waves = [(180.0, 0.5, 20.0), (90.0, 0.3, 70.0)]
    effects = effects_in(measured(targets, waves, rng, seconds_a_pose=0.5))
    assert {e["covariate"] for e in effects} == {"target_deg"}
    assert periods_in(effects) == {180.0, 90.0}


@pytest.mark.statistical
def test_the_standard_error_of_a_period_is_its_scatter():
    rng = np.random.default_rng(7)
    effect = EFFECTS["stage_periodic"]
    targets = rng.uniform(-60.0, 60.0, 80)
    periods, errors = [], []
    for _ in range(60):
        r = responses_of([measured(targets, [(7.3, 0.2, 0.0)], rng)])
        (shape,) = effect.forms(r, {"period_deg": 7.25})
        ((_, _, found),) = refined(r, [], [candidate_of(r, effect, shape)])
        periods.append(found.shape.at["period_deg"])
        errors.append(found.shape.at_std["period_deg"])
    assert np.mean(periods) == pytest.approx(7.3, abs=4.0 * np.std(periods) / np.sqrt(60))
    assert np.std(periods) == pytest.approx(np.mean(errors), rel=0.3)


@pytest.mark.parametrize(("jitter_deg", "expected"), [(0.0, [0.2, 0.4]), (2.5, [])])
def test_the_spectral_window_shows_the_spacing_and_jitter_takes_it_away(jitter_deg, expected):
    rng = np.random.default_rng(8)
    targets = np.arange(-180.0, 180.0, 5.0) + rng.uniform(-jitter_deg, jitter_deg, 72)
    peaks, _ = window_peaks(targets, 0.5, 0.5)
    assert peaks == pytest.approx(expected, abs=1e-3)


def test_over_many_turns_an_order_is_found_and_what_is_not_searched_for_is_said():
    rng = np.random.default_rng(3)
    theta_deg = rng.uniform(0.0, 40.0 * 360.0, 900)
    error_deg = 0.05 * np.sin(np.radians(12.0 * theta_deg)) + rng.normal(0.0, 0.01, 900)
    run = posed(target_deg=theta_deg, reading_deg=theta_deg + error_deg)
    found = diagnose([run], request=DiagnosisRequest(reference="good"), bootstraps=99, cross_fit=False)
    assert [f.candidate.shape.at["period_deg"] for f in found.findings.found] == [30.0]
    assert any("up to 16 was searched" in said for said in found.warnings)
    in_a_turn = [replace(p, target_deg=p.target_deg / 40.0, reading_deg=p.reading_deg / 40.0) for p in run]
    assert not any(
        "up to 16 was searched" in said for said in diagnose([in_a_turn[::4]], cross_fit=False).warnings
    )


@pytest.mark.parametrize("seed", range(3))
def test_no_name_is_claimed_alone_of_a_curve_that_others_contain(seed):
    """A quartic over 140°: a cubic and an order of the turn, or an eccentricity, that undo each other."""
    rng = np.random.default_rng(seed)
    theta_deg = rng.uniform(0.0, 140.0, 150)
    u = theta_deg / 70.0 - 1.0
    error_deg = 6.0 * u**4 - 4.0 * u**3 + rng.normal(0.0, 0.08, 150)
    run = posed(target_deg=theta_deg, reading_deg=theta_deg + error_deg)
    found = document(diagnose([run], request=DiagnosisRequest(reference="good"), bootstraps=199), ["1"])
    assert len(found["effects"]) == 1 or all(e["verdict"] != "named" for e in found["effects"])
    assert found["final"]["held_out_rms_deg"] < 0.12


@pytest.mark.parametrize("amplitude_deg", [0.5, 1.05])
def test_a_wave_so_steep_that_readings_turn_back_is_found_and_no_correction(amplitude_deg: float) -> None:
    rng = np.random.default_rng(9)
    theta_deg = rng.uniform(0.0, 360.0, 150)
    error_deg = amplitude_deg * np.sin(2.0 * np.pi * theta_deg / 5.625) + rng.normal(0.0, 0.02, 150)
    run = posed(target_deg=theta_deg, reading_deg=theta_deg + error_deg)
    said = document(diagnose([run], request=DiagnosisRequest(reference="good"), bootstraps=199), ["1"])
    (wave,) = said["effects"]
    amplitude = wave["parameters"]["amplitude_deg"]
    assert abs(amplitude["value"] - amplitude_deg) < 4.0 * amplitude["std"]
    turns_back = 2.0 * np.pi * amplitude_deg > 5.625
    assert wave["corrects"] == (None if turns_back else "unit")
    assert any("turn back" in warning for warning in said["warnings"]) == turns_back
    assert said["final"]["held_out_rms_deg"] < 0.03


def test_poses_of_many_turns_at_the_same_few_degrees_carry_no_order_of_the_turn():
    """A laser at five places of as many turns: whatever bends there is a curve, of any order."""
    rng = np.random.default_rng(6)
    theta_deg = np.tile(3600.0 * np.arange(5) + np.array([0.0, 7.0, -4.0, -11.0, 9.0]), 10)
    theta_deg = theta_deg + rng.normal(0.0, 0.2, 50)
    bent_deg = 0.05 * (np.mod(theta_deg + 180.0, 360.0) - 180.0)
    run = posed(target_deg=theta_deg, reading_deg=theta_deg - bent_deg + rng.normal(0.0, 0.02, 50))
    found = diagnose([run], bootstraps=199, cross_fit=False).findings.found
    assert {f.candidate.covariate for f in found} == {"target_deg"}
    assert not any(f.candidate.named for f in found)


@pytest.mark.parametrize("seed", one_now([0, 2, 7]))
def test_orders_of_a_closed_turn_are_not_one_curve_beside_other_orders(seed: int) -> None:
    rng = np.random.default_rng(seed)
    theta_deg = np.sort(rng.uniform(0.0, 360.0, 200))
    orders = {1: (0.05, 4.71), 3: (0.08, 1.53), 4: (0.025, 5.08), 14: (0.17, 3.18)}
    readings_deg = theta_deg + 3.0 + rng.normal(0.0, 0.015, 200)
    for order, (size_deg, phase) in orders.items():
        readings_deg += size_deg * np.sin(np.radians(order * theta_deg) + phase)
    found = diagnose(
        [posed(target_deg=theta_deg, reading_deg=readings_deg)],
        request=DiagnosisRequest("good"),
        cross_fit=False,
    ).findings.found
    assert all(f.candidate.named for f in found)
    named = sorted(360.0 / f.candidate.shape.at.get("period_deg", 360.0) for f in found)
    assert named == pytest.approx(list(orders), rel=2e-3)


@pytest.mark.parametrize("shift_deg", [0.0, 0.264])
def test_waves_that_are_an_offset_of_each_stroke_are_no_periods(shift_deg):
    """To and fro at one speed, read at even times: both strokes have steps of 1.44°, at other places."""
    there = np.arange(0.1, 360.0, 1.44)
    targets_deg = np.concatenate([there, there[::-1] + shift_deg])
    time_s = 0.04 * np.arange(len(targets_deg))
    r = responses_of([posed(target_deg=targets_deg, reading_deg=targets_deg, time_s=time_s)])
    periodic = EFFECTS["stage_periodic"]

    def carried(period_deg):
        (shape,) = periodic.forms(r, {"period_deg": period_deg})
        return periodic.carried(r, shape)

    assert not any(carried(1.44 / whole) for whole in (1, 2, 3, 4, 12))
    assert not any(carried(period_deg) for period_deg in (0.3598943, 0.480302, 0.721008, 0.1199648))
    assert all(carried(period_deg) for period_deg in (3.6, 7.2, 22.5))
    periods = [c.shape.at["period_deg"] for c in candidates_of(r) if c.name == periodic.name and not c.beside]
    assert all(abs(1.0 / one - 1.0 / 1.44) >= 1.0 / r.arc_deg for one in periods)


@pytest.mark.parametrize("share", one_now([0.37, 0.2, 0.55]))
def test_an_iron_beside_a_compass_is_an_eccentricity_with_its_orders(share):
    """Its field, a share of the Earth's, turns the needle by atan2; order k is shareᵏ/k rad (Fourier)."""
    rng = np.random.default_rng(3)
    heading_deg = np.linspace(0.0, 570.0, 300) + rng.uniform(-0.5, 0.5, 300)
    turned = np.exp(1j * np.radians(heading_deg)) + share
    reading_deg = np.degrees(np.unwrap(np.angle(turned))) + rng.normal(0.0, 0.3, 300)
    effects = effects_in(posed(target_deg=heading_deg, reading_deg=reading_deg))
    found = {
        round(360.0 / e["parameters"].get("period_deg", {"value": 360.0})["value"]): e["parameters"][
            "amplitude_deg"
        ]
        for e in effects
    }
    assert [e["name"] for e in effects if "period_deg" not in e["parameters"]] == ["stage_eccentricity"]
    for order in (1, 2, 3):
        expected_deg = np.degrees(share**order / order)
        if expected_deg > 0.5:
            assert found[order]["value"] == pytest.approx(
                expected_deg, abs=max(0.1, 4.0 * found[order]["std"])
            )


@pytest.mark.parametrize("range_deg", [4.5, 9.0])
def test_many_short_waves_are_found_over_a_few_degrees_as_over_many(range_deg):
    """300 poses to 4.5°: 18 waves, which three periods of a common motor would not fit into."""
    rng = np.random.default_rng(5)
    at = np.arange(0.0, range_deg, 0.015)
    reading = at + 0.02 * np.sin(2.0 * np.pi * at / 0.25) + rng.normal(0.0, 1e-4, len(at))
    (found,) = effects_in(posed(target_deg=at, reading_deg=reading, time_s=0.06 * np.arange(len(at))))
    assert found["parameters"]["period_deg"]["value"] == pytest.approx(0.25, rel=1e-4)


def test_a_wave_between_poses_close_together_is_said_to_look_the_same():
    """50 cycles a degree, seen every 0.015°: 50 − 1/0.015 = −16.67 cycles a degree."""
    rng = np.random.default_rng(6)
    at = 0.9 + 0.015 * np.arange(300)
    reading = at + 3e-4 * np.sin(2.0 * np.pi * 50.0 * at + 1.0) + rng.normal(0.0, 1e-4, len(at))
    (found,) = effects_in(posed(target_deg=at, reading_deg=reading))
    assert found["parameters"]["period_deg"]["value"] == pytest.approx(0.06, rel=1e-3)
    assert any("a period of 0.02° as the same" in said for said in found["evidence"])
