"""Outliers: a pose so far from what the model says of it that no effect and no noise explains it.

A pose is judged against the model and what the other poses leave of it, not by its neighbours: a slip moves
all poses after it, an error of angle all near it, and at the ends of a range or where the sense of motion
changes the neighbours lie on one side (Chen & Liu, Journal of the American Statistical Association 88, 1993,
who part outliers from level shifts by one likelihood).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import fit
from calrig.calibration.responses import Responses
from calrig.estimation.robust import robust_std

OUTLIER_STD = 12.0
"""Robust standard deviations (by the median absolute deviation) from the model without the pose."""
MOST_SHARE = 0.03
SUSPECTS = 3


def most_outliers(n: int) -> int:
    """How many of n poses may be left out; where more are far off, the model is to blame."""
    return max(1, int(MOST_SHARE * n))


def outlier(r: Responses, accepted: Sequence[Candidate], gain_to_beat: float = 0.0) -> int | None:
    """The pose that is best explained by having gone wrong alone; None where there is none.

    Args:
        r: the responses.
        accepted: the effects in the model.
        gain_to_beat: of the best effect that could enter instead, in −2 log likelihood with penalties.
    """
    columns = model_columns(_with_first_poses(r), accepted)
    fitted = fit(r, columns)
    residuals = fitted.residuals[:, 0]
    most, best = gain_to_beat, None
    for k in np.argsort(-np.abs(residuals), kind="stable")[:SUSPECTS]:
        # each channel of the pose lies where it will: as if it had not been taken
        freed = np.zeros((len(r), len(r.channels), len(r.channels)))
        freed[k] = np.diag(r.known[k].astype(float))
        without = fit(r, np.concatenate([columns, freed], axis=2))
        others = np.delete(without.residuals[:, 0], k)
        spread_deg = robust_std(others)
        distance_deg = abs(float(without.beta[columns.shape[2]]))
        gain = fitted.criterion - without.criterion - float(np.log(len(r))) * (len(r.channels) + 2)
        is_outlier = distance_deg > OUTLIER_STD * max(spread_deg, float(r.rounding[0]))
        if is_outlier and gain > most:
            most, best = gain, int(k)
    return best


def _with_first_poses(r: Responses) -> Responses:
    """The responses with the first pose of each run bound to the model like any other."""
    bound = [k for k, name in enumerate(r.base_names) if not name.endswith(".first")]
    return replace(r, base=r.base[:, :, bound], base_names=tuple(r.base_names[k] for k in bound))
