"""The correction table: interpolated linearly, it gives what `calrig apply` gives; integers too."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import calrig, reason
from issued_documents import WARM, issued, whole

from calrig.calibration.regression.effect import ApplyError
from calrig.export.formats.table import correction_table
from calrig.loaded import Calibration

ECCENTRIC = ("stage_eccentricity", {"amplitude_deg": 0.97, "phase_deg": 64.0})
ORDER_4 = ("stage_periodic", {"amplitude_deg": 1.74, "phase_deg": 55.0, "period_deg": 90.0})
WARM_BIAS = ("temperature_bias", {"deg_per_c": 0.02, "reference_c": 24.3})
FULL_TURN = {"bias_deg": -259.3, "scale": 1.002, "range_deg": [258.0, 617.0]}


def rows_of(text):
    """The comment, the names of the columns, and the (n, 3) numbers of a table."""
    comment, header, *rows = text.splitlines()
    return comment, header.split(","), np.array([row.split(",") for row in rows], dtype=np.float64)


@pytest.mark.parametrize("changes", [{}, FULL_TURN], ids=["part of a turn", "full turn"])
def test_the_table_interpolated_linearly_is_what_apply_gives(changes):
    document = issued([ECCENTRIC, ORDER_4, WARM_BIAS], **changes)
    comment, names, table = rows_of(correction_table(document, step_deg=0.5))
    assert names == ["reading_deg", "correction_deg", "correction_std_deg"]
    assert "24.3 °C" in comment
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.5)

    low, high = document["range_deg"]
    calibration = Calibration(document)
    reading_deg = np.random.default_rng(1).uniform(table[1, 0], table[-2, 0], 500)
    elevation_deg = reading_deg + np.interp(reading_deg, table[:, 0], table[:, 1])
    # of a wave of order k, linear interpolation is off by amplitude·(k·step)²/8 at most
    within_deg = 1.1 * 1.74 * np.radians(4 * 0.5) ** 2 / 8
    exact_deg = calibration.elevation_deg(reading_deg, temperature_c=24.3)
    assert (low - 0.5 < exact_deg).all() and (exact_deg < high + 0.5).all()
    np.testing.assert_allclose(elevation_deg, exact_deg, atol=within_deg)
    assert np.abs(elevation_deg - exact_deg).max() > within_deg / 20, "so the step is seen"
    std_deg = calibration.elevation_std_deg(table[5:-5, 0], temperature_c=24.3)
    np.testing.assert_allclose(table[5:-5, 2], std_deg, atol=1e-6)


def test_rows_cover_the_range_and_the_table_says_how_good_the_interpolation_is():
    document = issued([ORDER_4])
    for step_deg in (0.7, 5.0):
        comment, _, table = rows_of(correction_table(document, step_deg))
        elevations_deg = table[[0, -1], 0] + table[[0, -1], 1]
        assert elevations_deg[0] <= -60.0 and elevations_deg[1] >= 60.0
        within_deg = float(comment.split("within ")[1].split("°")[0])
        readings_deg = np.linspace(table[0, 0], table[-1, 0], 3001)
        exact_deg = Calibration(document).elevation_deg(readings_deg)
        found_deg = readings_deg + np.interp(readings_deg, table[:, 0], table[:, 1])
        assert np.abs(found_deg - exact_deg).max() == pytest.approx(within_deg, rel=0.2)


def test_integers_are_of_the_stated_step_and_round_by_half_of_it():
    lsb_deg = 360.0 / 16384
    document = issued([ECCENTRIC, ORDER_4], **FULL_TURN)
    comment, names, table = rows_of(correction_table(document, step_deg=1.0, lsb_deg=lsb_deg))
    assert names == ["reading_lsb", "correction_lsb", "correction_std_lsb"]
    assert f"{lsb_deg:.10g}°" in comment
    assert (table == np.rint(table)).all()
    assert set(np.diff(table[:, 0])) == {round(1.0 / lsb_deg)}
    reading_deg = table[2:-2, 0] * lsb_deg
    exact_deg = Calibration(document).elevation_deg(reading_deg) - reading_deg
    np.testing.assert_allclose(table[2:-2, 1] * lsb_deg, exact_deg, atol=lsb_deg / 2 + 1e-6)


def test_what_is_not_known_is_an_empty_cell():
    text = correction_table(issued([ORDER_4], uncertainty=None, temperature_c=None))
    assert text.splitlines()[0].startswith("# reference temperature not known")
    assert all(row.endswith(",") for row in text.splitlines()[2:])


@pytest.mark.parametrize(
    ("document", "why"),
    [
        (whole(), "accelerations"),
        (issued([("stage_periodic", {"amplitude_deg": 5.0, "phase_deg": 0.0, "period_deg": 20.0})]), "many"),
    ],
)
def test_what_a_table_cannot_hold_is_refused(document, why):
    with pytest.raises(ApplyError, match=why):
        correction_table(document)


def test_a_table_that_would_be_endless_is_refused():
    with pytest.raises(ValueError, match="at most 100000"):
        correction_table(issued(), step_deg=1e-6)


def test_the_command_line_takes_the_steps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "unit.json").write_text(json.dumps(issued([ORDER_4, WARM])))
    table = ("export", "unit.json", "--format", "table")
    _, _, coarse = rows_of(calrig(*table).stdout)
    _, names, fine = rows_of(calrig(*table, "--step", "0.25", "--lsb", "0.01").stdout)
    assert names[0] == "reading_lsb"
    assert (np.diff(coarse[:, 0]) == 1.0).all() and (np.diff(fine[:, 0]) == 25.0).all()
    assert "--step" in reason(*table, "--step", "0", status=2)
    assert "--lsb" in reason("export", "unit.json", "--format", "c-header", "--lsb", "0.1", status=2)
