"""The best straight line of an axis' curve holds its quartic term as well."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.export.triads import accelerometer_of


def test_a_quartic_term_is_in_the_best_straight_line():
    effect = {"name": "axis_nonlinearity", "parameters": {"z_mg_per_g4": 20.0}}
    document = {"effects": [effect], "range_deg": [-60.0, 60.0], "bias_deg": 0.0, "scale": 1.0}
    found = accelerometer_of(document)
    u = np.cos(np.radians(np.linspace(-60.0, 60.0, 721)))
    slope, offset = np.polyfit(u, 0.02 * u**4, 1)
    assert found.bias_g[2] == pytest.approx(offset, rel=1e-6)
    assert found.matrix[2, 2] == pytest.approx(1.0 / (1.0 + slope), rel=1e-6)
