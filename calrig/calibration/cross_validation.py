"""Error before and after on poses that neither search nor fit had seen.

Either folds of the same runs, search and fit repeated for each (cross-validation), or poses of a fresh run
that did not serve to decide (confirmation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate, rebuilt
from calrig.calibration.channels import SCALE_UNIT_DEG
from calrig.calibration.experiment_design import predicted
from calrig.calibration.fit import rms
from calrig.calibration.known_noise import Noises
from calrig.calibration.model import model_columns
from calrig.calibration.near_rivals import Rivals
from calrig.calibration.noise_model import fit
from calrig.calibration.pose import Pose
from calrig.calibration.progress import Progress, unheard
from calrig.calibration.responses import Responses, responses_of
from calrig.calibration.run_changes import with_free_levels
from calrig.calibration.search import Findings, search
from calrig.calibration.sensor_model import fitted_model, linear_about
from calrig.estimation.angles import FloatArray

FOLDS = 4
BOOTSTRAPS = 270
"""Enough to tell ¾ % from more, one draw of noise beyond it allowed; the p-value that is reported comes from
the search over all poses.
"""


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Errors (n,) in degrees of elevation of held-out poses: neither search nor fit had seen them."""

    base_deg: FloatArray
    final_deg: FloatArray
    folds: int


def cross_validate(
    r: Responses,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    rivals: Rivals | None = None,
    noises: Noises = MappingProxyType({}),
    progress: Progress = unheard,
) -> CrossValidation:
    """Predicts every pose once, by a search and a fit over the other folds; base on the same folds.

    Args:
        r: the responses.
        candidates: of these poses.
        rng: of the gate's bootstrap.
        rivals: what a search of all poses found, to be held against again in each fold.
        noises: what noise gained in that search: likelihood ratios, which know no pose's reading.
        progress: is told the share of folds done before each.
    """
    fold = folds_of(r)
    base = np.zeros(len(r))
    final = np.zeros(len(r))
    folds = int(fold.max()) + 1
    for k in range(folds):
        progress(k / folds)
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        seen = r.rows(train)
        base[test] = errors_deg(r, (), fit(seen, seen.base).beta, test)
        of_fold = [c.rows(train) for c in candidates]
        findings = search(
            seen, of_fold, rng, bootstraps=BOOTSTRAPS, decide_only=True, rivals=rivals, noises=noises
        )
        if not findings.found:
            final[test] = base[test]
            continue
        # a fold's model in all poses; a refined period exists in the fold's alone
        whole = [rebuilt(f.candidate, r) or f.candidate for f in findings.found]
        final[test] = errors_deg(*linear_about(r, whole, findings.fitted.beta), findings.fitted.beta, test)
    return CrossValidation(base, final, folds)


def folds_of(r: Responses) -> npt.NDArray[np.intp]:
    """(n,) fold of each pose, dealt out in turn along each approach's elevations.

    So every fold has both approaches, all elevations, and poses from early and late.
    """
    approach = np.zeros(len(r)) if r.approach is None else r.approach
    order = np.lexsort((np.arange(len(r)), np.round(r.theta_deg, 1), approach))
    fold = np.empty(len(r), dtype=np.intp)
    fold[order] = np.arange(len(r)) % FOLDS
    return fold


def errors_deg(
    r: Responses, accepted: Sequence[Candidate], beta: FloatArray, test: npt.NDArray[np.intp]
) -> FloatArray:
    """(m,) reading less prediction of some poses, over the scale, in degrees of elevation.

    Args:
        r: all poses.
        accepted: the effects in the model, in all poses.
        beta: (p,) as fitted elsewhere.
        test: (m,) the poses to predict.
    """
    scale_at = r.base_names.index("reading.scale") if "reading.scale" in r.base_names else None
    scale = 1.0 if scale_at is None else 1.0 + beta[scale_at] / SCALE_UNIT_DEG
    columns = model_columns(r, accepted)[test, 0, :]
    return np.asarray((r.values[test, 0] - columns @ beta) / scale, dtype=np.float64)


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
    r = with_free_levels(responses_of([*runs, fresh]))
    before = len(r) - len(fresh)
    test = np.array([before + k for k in range(len(fresh)) if k not in set(deciding)], dtype=np.intp)
    effects = [predicted(f.candidate, r) for f in findings.found]
    accepted = [effect for effect in effects if effect is not None]
    if len(test) == 0 or len(accepted) < len(effects) or len(r) != sum(map(len, runs)) + len(fresh):
        return None
    train = np.setdiff1d(np.arange(len(r)), test)
    seen = r.rows(train)
    errors = []
    for effects_in in ((), accepted):
        beta = fitted_model(seen, [effect.rows(train) for effect in effects_in]).fitted.beta
        errors.append(errors_deg(*linear_about(r, effects_in, beta), beta, test))
    return Confirmation(rms(errors[0]), rms(errors[1]), len(test))
