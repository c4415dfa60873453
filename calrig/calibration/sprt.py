"""Deciding between suspects while poses come in: Wald's sequential probability ratio test."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calrig.calibration.experiment_design import ambiguous_of, predicted
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import fit
from calrig.calibration.pose import Pose
from calrig.calibration.responses import responses_of
from calrig.calibration.run_changes import with_free_levels
from calrig.calibration.search import Findings

ERROR_RATE = 0.01
"""Of naming the wrong one of two suspects, either way."""
DECIDED = 2.0 * math.log((1.0 - ERROR_RATE) / ERROR_RATE)
"""In −2 log likelihood (Wald, Sequential Analysis, 1947: A = (1 − β)/α, B = β/(1 − α))."""
FEWEST_POSES = 3


class SequentialTest:
    """Holds the suspects of a diagnosis against each other with every new pose.

    The likelihoods are maximised over all other parameters, so that the error rates hold for many poses and
    nearly so for the few of a follow-up.
    """

    def __init__(self, runs: Sequence[Sequence[Pose]], findings: Findings) -> None:
        self._runs = [list(run) for run in runs]
        found = ambiguous_of(findings)
        self._suspects = () if found is None else (found.candidate, *found.rivals)
        self._others = [f.candidate for f in findings.found if f is not found]

    def decided(self, poses: Sequence[Pose]) -> bool:
        """Whether one suspect leads all others by more than the test's bound, with the new poses taken in."""
        if len(poses) < FEWEST_POSES or len(self._suspects) < 2:
            return False
        r = with_free_levels(responses_of([*self._runs, list(poses)]))
        others = [again for other in self._others if (again := predicted(other, r)) is not None]
        criteria = sorted(
            fit(r, model_columns(r, [*others, suspect])).criterion
            for candidate in self._suspects
            if (suspect := predicted(candidate, r)) is not None
        )
        return len(criteria) > 1 and criteria[1] - criteria[0] > DECIDED
