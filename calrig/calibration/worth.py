"""Whether an effect is worth a name: what it does to the reading, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.candidates import Candidate, companions_of
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import fit
from calrig.calibration.ranking import Found
from calrig.calibration.responses import Responses

LEAST_SHARE = 0.05
"""An effect whose part of the reading is smaller than this share of its noise is not worth a correction."""
LEAST_STANDARD_ERRORS = 4.0
"""Of the parameters that reach the reading, together: what a witness alone shows is not named."""
LEAST_OF_A_COMPANION = 3.0
"""The same of one of the two or three effects declared to come with what is in the model: noise gives
one of three so many standard errors in 0.8 %, one of a hundred candidates four in 0.6 %.
"""


def is_worth_a_name(r: Responses, accepted: Sequence[Candidate], step: Found) -> bool:
    """Whether what a step adds to the reading, bias and scale taken off, is worth a correction, and sure.

    What a witness alone shows, names no effect of the reading: parameters that reach the reading are some
    standard errors large, and where the effect is named, the reading is not left worse than without it.
    """
    candidate = step.candidate
    before = fit(r, model_columns(r, accepted))
    fitted = fit(r, model_columns(r, [*accepted, candidate]))
    own = np.arange(-candidate.columns.shape[2], 0)
    part = candidate.columns[:, 0, :] @ fitted.beta[own]
    line = np.column_stack([np.ones(len(r)), r.theta_deg])
    part = part - line @ np.linalg.lstsq(line, part, rcond=None)[0]
    left_deg, left_before_deg = (
        float(np.hypot(one.residuals[:, 0].std(), r.rounding[0])) for one in (fitted, before)
    )
    reaching = own[np.ptp(candidate.columns[:, 0, :], axis=0) > 0.0]
    beta, covariance = fitted.beta[reaching], fitted.covariance[np.ix_(reaching, reaching)]
    sure = float(np.sqrt(beta @ np.linalg.pinv(covariance, hermitian=True) @ beta))
    least = LEAST_OF_A_COMPANION if candidate.label in companions_of(accepted) else LEAST_STANDARD_ERRORS
    helps = step.verdict != "named" or left_deg <= left_before_deg
    return part.std() >= LEAST_SHARE * left_deg and sure >= least and helps
