"""Names that stand without any one pose: what a single pose decides, these poses do not tell.

At a turning point one pose may be all that tells settling from backlash, and it is the pose where a stage
behaves least like itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.noise_model import Fit
from calrig.calibration.ranking import MARGIN, Found
from calrig.calibration.responses import Responses
from calrig.calibration.sensor_model import fitted_model

MOST_OF_A_LEAD = 0.5
"""Of a lead, what must be left without a pose: every pose has some part in it."""
DECISIVE = 2
"""Poses that speak loudest for a name against a rival, each left out in turn: the others decide less."""


def standing_without_one(r: Responses, found: Sequence[Found]) -> tuple[Found, ...]:
    """The same effects; a name that one pose alone tells from a runner-up becomes ambiguous with it.

    Args:
        r: the poses they were found in.
        found: all effects of the model.
    """
    return tuple(
        _doubted(r, one, [f.candidate for f in found if f is not one]) if one.verdict == "named" else one
        for one in found
    )


def _doubted(r: Responses, claimed: Found, others: Sequence[Candidate]) -> Found:
    doubted = claimed
    for rival in claimed.runners_up:
        pose = _decisive(r, others, claimed.candidate, rival)
        if pose is not None:
            told = f"only the pose at {r.theta_deg[pose]:.4g}° tells it from {rival.name}: the rest does not"
            doubted = doubted.against(rival, told)
    return doubted


def _decisive(
    r: Responses, others: Sequence[Candidate], claimed: Candidate, runner_up: Candidate
) -> int | None:
    """The pose that holds most of the lead, and without which it is less than `MARGIN`; None without one."""
    both = [[*others, claimed], [*others, runner_up]]
    ours, theirs = (fitted_model(r, effects).fitted for effects in both)
    penalty = float(np.log(len(r))) * (runner_up.parameters - claimed.parameters)
    lead = theirs.criterion - ours.criterion + penalty
    for pose in np.argsort(-_for_the_claim(r, ours, theirs), kind="stable")[:DECISIVE]:
        rest = np.delete(np.arange(len(r)), pose)
        seen = r.rows(rest)
        left = [fitted_model(seen, [c.rows(rest) for c in effects]).fitted for effects in both]
        if left[1].criterion - left[0].criterion + penalty < min(MARGIN, MOST_OF_A_LEAD * lead):
            return int(pose)
    return None


def _for_the_claim(r: Responses, ours: Fit, theirs: Fit) -> npt.NDArray[np.float64]:
    """(n,) by how much each pose's innovations are larger, in −2 log likelihood, under the rival's fit."""
    own, rival = (ours.noise.whiten(f.residuals, r.starts) ** 2 for f in (ours, theirs))
    variance = own.mean(axis=0)
    gained = np.divide(rival - own, variance, out=np.zeros_like(own), where=variance > 0.0)
    return np.asarray(gained.sum(axis=1), dtype=np.float64)
