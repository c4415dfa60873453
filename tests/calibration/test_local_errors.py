"""Local errors of a stage lie where they lie, wherever the dial's count begins."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calrig.calibration.separation.local_errors import _cores, _within
from calrig.calibration.separation.stage_map import Region, inside_regions


@pytest.mark.parametrize("begin_deg", [-180.0, -175.0, 0.0, 90.0])
def test_a_tooth_at_the_turns_end_is_one_region(begin_deg):
    """180 poses round the dial, those within 3° of 180° off by six standard deviations."""
    on_turn = begin_deg + np.arange(180) * 2.0
    dial_deg = on_turn + 360.0 * (np.arange(180) % 2)
    near = np.abs(np.mod(on_turn, 360.0) - 180.0) <= 3.0
    z = np.random.default_rng(0).standard_normal(180) + 6.0 * near
    one = np.zeros(180, dtype=int)
    table = SimpleNamespace(dial_deg=dial_deg, size_g=np.ones(180), mount=one, source=one, sources=("a",))
    ((low, high),) = _cores(table, z, 0.0)
    assert 0.0 < high - low <= 6.0
    assert _within(dial_deg, [(low, high)], 0.0).sum() == near.sum()
    assert (inside_regions(dial_deg, [Region(low, high, 0.1)]) >= near).all()


def test_a_lone_pose_is_in_its_own_region_whatever_its_angle_rounds_to():
    dial_deg = np.sort(np.random.default_rng(1).uniform(-180.0, 540.0, 200))
    z = np.zeros(200)
    z[77] = 30.0
    one = np.zeros(200, dtype=int)
    table = SimpleNamespace(dial_deg=dial_deg, size_g=np.ones(200), mount=one, source=one, sources=("a",))
    ((low, high),) = _cores(table, z, 0.0) or [(np.nan, np.nan)]
    assert _within(dial_deg, [(low, high)], 0.0)[77]
