"""What makes a new calibration doubtful, compared with the one in force: its residual, and a changed bias."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from calrig.calibration.uncertainty.doubts import (
    Line,
    clamping_doubts,
    displacement_doubts,
    remount_doubts,
    residual_doubts,
)

NOISE_DEG = 0.005
IN_FORCE = "revision 1 in force"


def result(rms_deg, n_poses=20, noise_deg=NOISE_DEG, scale=1.0):
    """As much of a run's result as is compared."""
    return SimpleNamespace(rms_calibrated_deg=rms_deg, n_poses=n_poses, noise_deg=noise_deg, scale=scale)


def test_a_residual_far_above_the_one_in_force_names_both_figures():
    (doubt,) = residual_doubts(result(0.0064, 10), result(0.297, 10), IN_FORCE)
    assert doubt.kind == "residual"
    assert "0.30°" in doubt.says
    assert f"that of {IN_FORCE} is 0.0064°" in doubt.says


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (result(0.005), result(0.012)),  # less than three times as much
        (result(0.3), result(0.6)),  # effects that neither line corrects
        (result(0.005), result(0.1, noise_deg=0.1)),  # a shorter dwell, or a noisier board
        (result(0.005, noise_deg=0.1), result(0.1)),  # a residual that was small by chance
        (result(0.005, 3), result(0.3, 3)),  # one degree of freedom each
        (result(0.0), result(0.01, noise_deg=None)),  # counts of the accelerometer
        (result(0.005, 2), result(0.3)),  # nothing left over to tell
        (result(None), result(0.3)),
    ],
)
def test_a_residual_that_may_have_another_reason_is_no_doubt(before, now):
    assert residual_doubts(before, now, IN_FORCE) == []


@pytest.mark.parametrize("n_poses", [3, 4, 6, 10])
def test_runs_of_one_unit_are_hardly_ever_doubted_by_chance(n_poses):
    """Where the noise is not known, so that F alone decides: 2e4 pairs, of which 1e-4 would be two."""
    scatter = np.random.default_rng(n_poses).standard_normal((20_000, 2, n_poses - 2))
    rms_deg = np.sqrt((scatter**2).sum(axis=2) / n_poses)
    doubted = sum(
        bool(residual_doubts(result(a, n_poses, None), result(b, n_poses, None), IN_FORCE))
        for a, b in rms_deg.tolist()
    )
    assert doubted <= 8


def test_the_scatter_of_a_new_run_does_not_excuse_its_bias():
    """A slip of 3° in mid-run: half of it in the bias, and as much again in its standard uncertainty."""
    before, slipped = Line(0.8, 1.0, 0.002, 1e-4), Line(2.3, 1.0, 0.5, 0.01)
    (doubt,) = remount_doubts(before, slipped, (-40.0, 40.0), 1.0, IN_FORCE)
    assert doubt.kind == "changed"
    assert remount_doubts(before, Line(1.6, 1.0, 0.5, 0.01), (-40.0, 40.0), 1.0, IN_FORCE) == []


ZERO_G_DEG = math.degrees(math.asin(0.080))
"""The largest zero-g output of the data sheet, 80 mg, as an elevation."""


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("known_deg", [None, 12.0])
@pytest.mark.parametrize("remount_deg", [1.0, 3.0])
def test_a_bias_is_a_clamping_angle_beyond_the_zero_g_output_and_remounting(sign, known_deg, remount_deg):
    expected_deg, allowed_deg = known_deg or 0.0, ZERO_G_DEG + remount_deg
    for share, kinds in ((0.98, []), (1.02, ["clamping"])):
        found = clamping_doubts(expected_deg + sign * share * allowed_deg, known_deg, remount_deg)
        assert [doubt.kind for doubt in found] == kinds


@pytest.mark.parametrize(("share", "is_doubted"), [(0.99, False), (1.01, True)])
def test_two_standard_uncertainties_come_on_top_of_what_remounting_adds(share, is_doubted):
    """Of the bias 0.3° twice, of the scale 0.01 twice at 40°: the root of the sum of squares, twice."""
    most_deg = 0.5 + 2.0 * math.sqrt(2.0 * 0.3**2 + 2.0 * (40.0 * 0.01) ** 2)
    before, now = Line(0.0, 1.0, 0.3, 0.01), Line(share * most_deg, 1.0, 0.3, 0.01)
    assert bool(remount_doubts(before, now, (-40.0, 20.0), 0.5, IN_FORCE)) is is_doubted


@pytest.mark.parametrize(
    ("before", "now", "range_deg"),
    [
        (Line(0.2, 1.00, 0.0, 0.0), Line(0.7, 1.01, 0.0, 0.0), (-10.0, 60.0)),
        (Line(0.7, 1.01, 0.0, 0.0), Line(0.2, 1.00, 0.0, 0.0), (-10.0, 60.0)),
        (Line(0.2, 1.00, 0.0, 0.0), Line(0.7, 0.98, 0.0, 0.0), (-45.0, 30.0)),
    ],
)
def test_two_lines_are_compared_where_they_differ_most(before, now, range_deg):
    """By the readings that both lines predict at elevations over the range."""
    theta = np.linspace(*range_deg, 1001)
    readings = [line.bias_deg + line.scale * theta for line in (before, now)]
    most_deg = max(readings[1] - readings[0], key=abs)
    (doubt,) = remount_doubts(before, now, range_deg, 0.98 * abs(most_deg), IN_FORCE)
    assert f"{most_deg:+.2f}°".replace("-", "−") in doubt.says
    assert remount_doubts(before, now, range_deg, 1.02 * abs(most_deg), IN_FORCE) == []


def document(expanded_deg, *effects, is_solved=False):
    """As much of a calibration document as is compared."""
    return {
        "expanded_uncertainty_deg": expanded_deg,
        "effects": [{"name": name} for name in effects],
        "provenance": {"solution": {"id": "1"} if is_solved else None},
    }


@pytest.mark.parametrize(
    ("before", "now", "kinds"),
    [
        (document(0.05, is_solved=True), document(0.2), ["solution_in_force"]),
        (document(0.05, is_solved=True), document(None), ["solution_in_force"]),
        (document(0.05, is_solved=True), document(0.2, is_solved=True), []),
        (document(0.2, is_solved=True), document(0.05), []),  # better than what it replaces
        (document(None, is_solved=True), document(0.2), []),
        (document(0.05), document(0.2), []),
        (document(0.05, "temperature_bias"), document(0.2), ["effects_lost"]),
        (document(0.05, "temperature_bias"), document(0.2, "temperature_bias"), []),
        (document(0.05, "nonlinearity"), document(0.2), []),  # revoked since
    ],
)
def test_what_a_worse_calibration_would_replace_is_a_doubt(before, now, kinds):
    found = displacement_doubts(before, now, ["temperature_bias", "axis_mismatch"], IN_FORCE)
    assert [doubt.kind for doubt in found] == kinds
    lost = [doubt.says for doubt in found if doubt.kind == "effects_lost"]
    assert all("bias that follows temperature" in says for says in lost)
