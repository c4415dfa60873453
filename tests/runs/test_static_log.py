"""A static plan: the stage stands, and what the board sends is kept."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from run_rigs import TruthRig, begin, until

from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.store import NotFound, Store

LOG = Plan(kind="static", settle_s=0.5, dwell_s=25.0)


def test_a_log_is_kept_whole_and_even_and_nothing_moves(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    before_s = bench.now_s
    run = service.wait(begin(service, LOG).id, 30)
    assert (run.status, run.error, run.result) == ("completed", None, None)
    log = store.samples.of(run.id)
    assert len(log) == 25 * LOG.rate_hz
    assert np.diff(log.time_s) == pytest.approx(1 / LOG.rate_hz, abs=2e-6)
    assert not bench.table_dps(before_s, bench.now_s).any()
    assert store.poses.of(run.id) == []
    done = {"poses_done": 0, "poses_total": 0, "fraction": 1.0, "remaining_s": 0.0, "waiting_for": None}
    assert run.progress.model_dump() == done
    assert len(store.samples.of(run.id, 0)) == len(log)
    with pytest.raises(NotFound, match="has no pose 1"):
        store.samples.of(run.id, 1)


def test_it_stands_at_the_elevation_that_the_plan_names(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = service.wait(
        begin(service, LOG.model_copy(update={"elevations_deg": [30.0], "dwell_s": 2.0})).id, 30
    )
    assert run.status == "completed"
    up_g = store.samples.of(run.id).accel_g.mean(axis=0)
    assert np.degrees(np.arctan2(up_g[1], up_g[2])) == pytest.approx(30.0 + 0.8, abs=0.1)


def test_an_aborted_log_is_kept_as_far_as_it_came(service: RunService, store: Store) -> None:
    run = begin(service, LOG.model_copy(update={"dwell_s": 3600.0}))
    until(lambda: len(store.samples.of(run.id)) > 0, "the first stretch of the log")
    service.abort(run.id)
    assert service.wait(run.id, 10).status == "aborted"
    assert len(store.samples.of(run.id)) % (10 * LOG.rate_hz) == 0


def test_a_static_plan_names_one_elevation_at_most() -> None:
    with pytest.raises(ValidationError, match="stands at one elevation"):
        Plan(kind="static", elevations_deg=[0.0, 10.0])
