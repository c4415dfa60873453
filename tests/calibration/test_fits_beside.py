"""Candidates fitted together beside one model, and each by a fit of its own; what a fold asks of again."""

from __future__ import annotations

import numpy as np
import pytest
from studies.blind.cells import CELLS

from calrig.calibration.diagnosis.candidate_fits import fit_candidates
from calrig.calibration.diagnosis.candidates import candidates_of, model_columns
from calrig.calibration.diagnosis.reselection import competing_candidates, near_among
from calrig.calibration.diagnosis.selection import search
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import responses_of


def test_fits_beside_a_model_are_those_of_one_after_the_other() -> None:
    """Of every width at once, and of those that take the place of a column of the base.

    But for the degrees of freedom of their noise, which are those of the widest: a thousandth of the noise.
    """
    r = responses_of([CELLS["backlash and periodic"].run(1).poses])
    candidates = candidates_of(r)
    of_each_width = {c.columns.shape[2]: c for c in candidates}
    some = [*candidates[::40], *of_each_width.values(), next(c for c in candidates if c.shape.replaces)]
    assert of_each_width.keys() >= {1, 2, 5}

    together = fit_candidates(r, lambda more: model_columns(r, more), some)

    for k, candidate in enumerate(some):
        alone = fit(r, model_columns(r, [candidate]))
        assert together.criterion[k] == pytest.approx(alone.criterion, abs=1e-2)
        assert together.residuals[k] == pytest.approx(alone.residuals, abs=1e-3 * alone.residuals[:, 0].std())
        assert together.beta[k] == pytest.approx(alone.beta, rel=1e-2, abs=1e-4)


def test_a_fold_asks_again_of_what_was_found_and_of_what_came_near() -> None:
    r = responses_of([CELLS["backlash and temperature"].run(1).poses])
    candidates = candidates_of(r)
    findings = search(r, candidates, np.random.default_rng(1), bootstraps=99)
    backlash = next(f for f in findings.found if f.candidate.name == "backlash")

    rivals = competing_candidates(r, candidates, findings.found)
    near = {c.label for c in near_among(candidates, backlash, rivals)}

    assert {f.candidate.label for f in findings.found} <= near < {c.label for c in candidates}
    assert near_among(candidates, backlash, None) == candidates
