"""Stretches of a sweep against its dwells: what a motor does to the accelerometer, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from calrig.calibration.motor_vibration import Ends, UnreportedTurn, disturbing, end_differences
from calrig.calibration.poses import Pose
from calrig.plan import Plan

NOISE_DEG = 0.012


def sweep(seed: int, shaken_g: tuple[float, float] = (0.0, 0.0), backlash_deg: float = 0.1) -> list[Pose]:
    """A sweep's poses of a unit with offsets and gains, by its accelerometer's vector.

    `shaken_g` is what turning adds to the mean of y and z.
    """
    rng = np.random.default_rng(seed)
    poses, sense = [], -1
    for planned in Plan(kind="sweep").poses((-90.0, 90.0)):
        if planned.stretch_deg is not None:
            sense = 1 if planned.stretch_deg[1] > planned.stretch_deg[0] else -1
        angle = np.radians(planned.target_deg + backlash_deg * sense / 2)
        y = 1.01 * np.sin(angle) + 0.05 + shaken_g[0] * (planned.stretch_deg is not None)
        z = 0.99 * np.cos(angle) - 0.06 + shaken_g[1] * (planned.stretch_deg is not None)
        poses.append(
            Pose(
                target_deg=planned.target_deg,
                stage_deg=planned.target_deg,
                reading_deg=float(np.degrees(np.arctan2(y, z))) + rng.normal(0.0, NOISE_DEG),
                approach=sense,
                settle_s=1.0 if planned.stretch_deg is None else None,
            )
        )
    return poses


def test_a_bias_of_the_turning_motor_is_told_with_its_size():
    ends = end_differences(sweep(1, shaken_g=(0.0, 0.003)))
    low, high = ends.differences
    assert (low.elevation_deg, high.elevation_deg) == (-60.0, 60.0)
    # δθ = −sin θ·δz, in radians for 1 g
    for end in (low, high):
        expected_deg = -np.degrees(0.003) * np.sin(np.radians(end.elevation_deg))
        assert end.difference_deg == pytest.approx(expected_deg, abs=3 * end.std_deg)
    worst = disturbing(ends, 1e-4)
    assert worst is not None and abs(worst.difference_deg) > 0.1


def test_what_biases_both_ends_is_found_where_neither_alone_would_tell():
    found = [end_differences(sweep(k, shaken_g=(0.0, 0.0013))) for k in range(100)]
    both = sum(disturbing(ends, 1e-4) is not None for ends in found)
    alone = sum(min(end.p_value for end in ends.differences) < 1e-4 / 2 for ends in found)
    assert both > alone + 5


def test_offsets_gains_and_play_are_no_fault_of_the_motor():
    ends = [end_differences(sweep(k)) for k in range(300)]
    differences = np.array([[end.difference_deg / end.std_deg for end in both.differences] for both in ends])
    assert np.abs(differences.mean(axis=0)).max() < 0.7  # the second order of 60 mg is no harmonic's
    assert differences.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.15)
    assert all(disturbing(end_differences(sweep(k)), 1e-4) is None for k in range(100))


def test_by_chance_both_ends_together_differ_at_their_nominal_rate():
    """Of readings that are right but for noise the p-value is uniform."""
    rng = np.random.default_rng(6)
    planned = sweep(0)
    p_values = []
    for _ in range(200):
        noise_deg = rng.normal(0.0, NOISE_DEG, len(planned))
        read = [replace(p, reading_deg=p.target_deg + off) for p, off in zip(planned, noise_deg, strict=True)]
        p_values.append(end_differences(read).p_value)
    assert kstest(p_values, "uniform").pvalue > 1e-3


def test_what_the_table_turned_by_the_gyros_account_is_no_vibration():
    catches_up_deg, gyro_deg = 0.12, 0.01
    noise = np.random.default_rng(5)
    poses = [
        replace(pose, reading_deg=pose.reading_deg + catches_up_deg * (pose.approach or 0))
        if pose.settle_s is not None
        else pose
        for pose in sweep(5)
    ]
    felt = [
        UnreportedTurn(sense, catches_up_deg * sense + noise.normal(0.0, gyro_deg), gyro_deg)
        for sense in (1, -1, 1, -1)
    ]
    assert disturbing(end_differences(poses), 1e-4) is not None
    assert disturbing(end_differences(poses, felt), 1e-2) is None
    stood_still = [UnreportedTurn(one.sense, noise.normal(0.0, gyro_deg), gyro_deg) for one in felt]
    shaken = end_differences(sweep(5, shaken_g=(0.0, 0.003)), stood_still)
    assert disturbing(shaken, 1e-4) is not None


def test_the_first_pass_tells_its_own_end_and_a_few_stretches_none():
    first = sweep(3)[:14]
    (end,) = end_differences(first).differences
    assert end.elevation_deg == 60.0
    assert end_differences(first[:4]) == Ends()
    assert disturbing(Ends(), 1e-4) is None
