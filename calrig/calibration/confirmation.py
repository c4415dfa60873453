"""Before and after on poses of a fresh run that did not serve to decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.cross_validation import errors_deg
from calrig.calibration.experiment_design import predicted
from calrig.calibration.fit import rms
from calrig.calibration.noise_model import fit
from calrig.calibration.pose import Pose
from calrig.calibration.responses import responses_of
from calrig.calibration.search import Findings, model_columns


@dataclass(frozen=True, slots=True)
class Confirmation:
    """RMS errors of the fresh poses in degrees of elevation, predicted without and with the effects."""

    before_rms_deg: float
    after_rms_deg: float
    n_poses: int


def confirm(
    runs: Sequence[Sequence[Pose]], fresh: Sequence[Pose], deciding: Sequence[int], findings: Findings
) -> Confirmation | None:
    """Fits base and final model to all poses but the confirming ones and predicts those.

    Args:
        runs: the earlier runs.
        fresh: the poses of the new run.
        deciding: indices of those that served to decide, and fix the new run's bias.
        findings: of the diagnosis of `runs` with the deciding poses.

    Returns:
        None where no pose is left to confirm with, or an effect cannot show in these poses.
    """
    r = responses_of([*runs, fresh])
    before = len(r) - len(fresh)
    test = np.array([before + k for k in range(len(fresh)) if k not in set(deciding)], dtype=np.intp)
    effects = [predicted(f.candidate, r) for f in findings.found]
    accepted = [effect for effect in effects if effect is not None]
    if len(test) == 0 or len(accepted) < len(effects) or len(r) != sum(map(len, runs)) + len(fresh):
        return None
    train = np.setdiff1d(np.arange(len(r)), test)
    seen = r.rows(train)
    errors = [
        errors_deg(r, columns, fit(seen, columns[train]).beta, test)
        for columns in (r.base, model_columns(r, accepted))
    ]
    return Confirmation(rms(errors[0]), rms(errors[1]), len(test))
