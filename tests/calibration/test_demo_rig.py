"""The demo rig has four effects at once, each of which alone leaves others that look like wandering noise."""

from __future__ import annotations

import pytest
from studies.demo import judged, measured
from virtual_time.clock import VirtualClock


@pytest.mark.statistical
@pytest.mark.parametrize("seed", [9])
def test_all_four_effects_are_found_where_they_hide_each_other(seed, tmp_path):
    result = judged(measured(seed, tmp_path, VirtualClock()))
    assert (result["held"], result["wrong"]) == (4, []), result
