"""Noise drawn beside a model in all poses, asked again in a fold beside the same effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from studies.blind.cells import CELLS

from calrig.calibration.diagnosis.candidates import Candidate, candidates_of, model_columns
from calrig.calibration.diagnosis.held_out import folds_of
from calrig.calibration.diagnosis.significance_test import (
    FEWEST,
    OTHER_RHO,
    FamilyTest,
    NullGains,
    Verdict,
    gate,
)
from calrig.calibration.regression.noise_model import NoiseModel, fit
from calrig.calibration.regression.responses import Responses, responses_of

LEVEL, OF_ALL, OF_FOLD = 0.0075, 999, 270


def judged(
    r: Responses,
    candidates: Sequence[Candidate],
    bootstraps: int = OF_FOLD,
    known: NullGains | None = None,
) -> Verdict:
    def columns_with(more: Sequence[Candidate]) -> np.ndarray:
        return model_columns(r, more)

    rng, base = np.random.default_rng(1), fit(r, r.base)
    decide_only = bootstraps == OF_FOLD
    return gate(
        r, columns_with, base, candidates, rng, bootstraps, LEVEL, known=known, decide_only=decide_only
    )


@pytest.mark.parametrize(("cell", "passes"), [("backlash 0.08°", True), ("null AR 0.6 each", False)])
def test_a_fold_decides_by_noise_drawn_in_all_poses_as_by_its_own(cell: str, passes: bool) -> None:
    r = responses_of([CELLS[cell].run(1).poses])
    candidates = candidates_of(r)
    whole = judged(r, candidates, OF_ALL)
    of_fold = np.flatnonzero(folds_of(r) != 0)
    fold, fewer = r.rows(of_fold), [c.rows(of_fold) for c in candidates]

    by_own, by_known = judged(fold, fewer), judged(fold, fewer, known=whole.drawn)

    assert by_own.passes == by_known.passes == whole.passes == passes
    assert by_own.drawn is not None
    assert by_known.drawn is None, "it drew noise again"
    if passes:  # what leads by far is fitted alone: no other candidate can beat it on the screen
        assert by_known.gain == pytest.approx(by_own.gain, rel=0.1)


def test_noise_of_another_correlation_or_without_a_label_tells_nothing() -> None:
    known = NullGains(("backlash", "settling"), np.arange(2.0 * FEWEST).reshape(FEWEST, 2), rho=0.5)
    alike, slower = (NoiseModel(np.eye(1), np.array([0.5 + more])) for more in (0.0, OTHER_RHO + 0.01))
    assert known.of(["settling"], alike) == pytest.approx(known.gains[:, 1:])
    assert known.of(["settling"], slower) is None
    assert known.of(["time_drift"], alike) is None
    assert known._replace(gains=known.gains[1:]).of(["settling"], alike) is None


@pytest.mark.parametrize(
    ("draws", "exceeded", "passes"),
    [
        pytest.param(199, 0, None, id="none of a few: open"),
        pytest.param(24, 3, False, id="an eighth of a few: clear"),
        pytest.param(999, 3, True, id="as many as a fold would draw, below the level"),
        pytest.param(999, 12, False, id="as many, above it"),
    ],
)
def test_draws_tell_what_the_p_value_is_sure_of(draws: int, exceeded: int, passes: bool | None) -> None:
    gains = np.full((draws, 1), 1.0)
    gains[:exceeded] = 50.0
    observed = np.array([40.0])
    found = FamilyTest(["unnamed time_s"], observed, gains, [np.array([True])])
    assert found.exceeded.tolist() == [exceeded]
    assert found.passes(LEVEL, margin=60.0, bootstraps=OF_FOLD) is passes
