"""A run that ends as soon as it is good enough, across an interruption; and what it leaves behind."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from run_rigs import TruthRig, begin, plan, until_written

from calrig.analysis.amendments import Records
from calrig.analysis.errors import Invalid
from calrig.calibration.plan_design.design_problem import Goals
from calrig.plan import Plan, Until
from calrig.runs.plan_designs import Designed, DesignRequest, answer, question
from calrig.runs.service import RunService
from calrig.store import Store

PLAN = plan(
    elevations_deg=[-40, -30, -20, -10, 0, 10, 20, 30, 40],
    sweeps=4,
    dwell_s=0.5,
    until={"expanded_uncertainty_deg": 0.55, "bias_std_deg": 0.05},
)


def test_a_run_ends_once_it_is_good_enough_and_everything_follows_from_the_same_scatter(
    bench: TruthRig, serve: Callable[..., RunService], store: Store
) -> None:
    first = serve(bench)
    run = begin(first, PLAN)
    until_written(lambda: store.poses.count(run.id) >= 3, "3 poses")
    first.close()
    again = serve(bench)
    again.resume(run.id)
    ended = again.wait(run.id, 60)
    assert (ended.status, ended.error) == ("completed", None)
    result = ended.result
    assert result is not None and result.stopped_by == "until"
    assert 9 <= result.n_poses < 36
    assert ended.progress.fraction == 1.0 and ended.progress.remaining_s == 0.0
    assert ended.progress.poses_total == len(store.poses.of(run.id)) == result.n_poses
    (revision,) = [one for one in store.revisions.of("AS-1") if one.run_id == run.id]
    stated_deg = revision.document["expanded_uncertainty_deg"]
    assert stated_deg == result.over_range.expanded_uncertainty_deg <= 0.55
    assert revision.document["covariance"][0][0] ** 0.5 == pytest.approx(result.bias_std_deg)
    assert result.bias_std_deg <= 0.05

    left = Records(store).exclude_pose(run.id, 4, "touched").result
    assert left is not None and left.stopped_by == "until"
    back = Records(store).include_pose(run.id, 4).result
    assert back is not None and back.bias_std_deg == pytest.approx(result.bias_std_deg)

    def designed(wanted: DesignRequest) -> Designed:
        return answer(question(wanted, Plan(), bench.settings, "AS-1", store, {}))

    shown = designed(DesignRequest(Goals(0.6), trace=False))
    assert shown.plan.settle_s == pytest.approx(0.2, abs=0.1)
    assert "vibration ended" in " ".join(shown.says)
    goes = designed(DesignRequest(Goals(0.6), trace=False, until=Until(expanded_uncertainty_deg=0.6)))
    assert goes.plan.until == Until(expanded_uncertainty_deg=0.6)
    assert goes.design.duration_s <= goes.whole.duration_s
    assert "ends when it reaches the target" in " ".join(goes.says)


def test_a_rig_that_states_no_reference_cannot_wait_for_an_uncertainty(
    bench: TruthRig, serve: Callable[..., RunService]
) -> None:
    bench.settings = bench.settings.model_copy(update={"reference": None})
    with pytest.raises(Invalid, match="has no `reference`"):
        begin(serve(bench), PLAN)
