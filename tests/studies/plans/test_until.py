"""A run that ends as soon as it is good enough: what it states covers as much as of one that goes on."""

from __future__ import annotations

import pytest

from . import coverage


@pytest.mark.statistical
@pytest.mark.parametrize(("times", "share"), [(2.5, 1.0), (2.0, 0.5)])
def test_ending_early_does_not_shrink_what_is_covered(times, share):
    found = coverage.covered(coverage.designed(28), times, share, 400, seed=3)
    chance = 3 * (0.95 * 0.05 / 400) ** 0.5
    assert found.early > 0.1
    assert min(found.elevation, found.bias, found.scale) > 0.95 - chance


@pytest.mark.statistical
def test_a_sweep_that_ends_early_has_turned_both_ways_and_covers_as_much():
    found = coverage.covered(coverage.turning(4), 2.5, 1.0, 400, seed=3)
    chance = 3 * (0.95 * 0.05 / 400) ** 0.5
    assert found.early > 0.5
    assert found.poses > 32  # two passes of 15 stretches, and their dwells
    assert min(found.elevation, found.bias, found.scale) > 0.95 - chance
