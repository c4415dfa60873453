"""A few of the runs of `python -m tests.studies.sweeps`, on rigs twenty times faster than life."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.studies.sweeps.rigs import BIAS_DEG, CASES, swept


@pytest.mark.statistical
def test_sweeps_state_what_their_bias_is_worth_and_are_not_refused(tmp_path: Path) -> None:
    options = {**CASES["gyro wrong by 2.5 %"], "time_scale": 20.0}
    results = [swept(options, seed, tmp_path).run.result for seed in range(8)]
    off = [(r.bias_deg - BIAS_DEG) / r.bias_std_deg for r in results if r is not None]
    assert len(off) == 8
    assert float(np.mean(np.square(off))) < 3.0  # χ² of eight: one mean in 400 is above by chance
