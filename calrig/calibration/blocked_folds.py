"""Held-out poses that lie apart: contiguous blocks in time, and in angle.

Held-out poses between the others are interpolation: a curve of time predicts them that says nothing of the
next hour (Roberts et al., Ecography 40, 2017). A block of neighbours left out asks more. What was found
in all poses is fitted again without each block; only bias, scale and the effects' coefficients are, so names
and places are those of a search that had seen the block. The interleaved folds repeat the search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.cross_validation import errors_deg
from calrig.calibration.fit import rms
from calrig.calibration.model import model_columns, own_columns
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.ranking import Found
from calrig.calibration.responses import Responses
from calrig.calibration.sensor_model import fitted_model, linear_about
from calrig.estimation.angles import FloatArray

BLOCKS = 4
UNSTABLE = 1e-3
"""Chance that the coefficients of a true effect differ as much between the whole and a part of the poses."""
ESTIMABLE = 1e-4
"""Of a column, what the others must leave of it: a slip in the block left out is a bias in all the others."""
WAVY, FORESEEN = 9, 0.03
"""Columns of a curve that has parts within one block; of the size of a part, what the others must show."""
KEPT = 16
"""Models whose errors may be asked for again: with all effects, and without each."""
Intp = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Blocked:
    """Errors (n,) in degrees of elevation of poses held out in blocks that are contiguous in one thing.

    Attributes:
        along: `time` or `angle`.
        base_deg, final_deg: without and with the effects found.
    """

    along: str
    base_deg: FloatArray
    final_deg: FloatArray

    @property
    def ratio(self) -> float:
        """RMS with the effects over that without."""
        base = rms(self.base_deg)
        return rms(self.final_deg) / base if base > 0.0 else 1.0


def blocked(r: Responses, accepted: Sequence[Candidate]) -> tuple[Blocked, ...]:
    """Predicts every pose once along time, and once along angle where the poses turn."""
    return tuple(Blocked(along, _errors(r, [], along), _errors(r, accepted, along)) for along in _folds(r))


def worse(several: Sequence[Blocked]) -> Blocked | None:
    """The one that the effects help least; None where there is none."""
    return max(several, key=lambda one: one.ratio, default=None)


def not_predictive(
    r: Responses, found: Sequence[Found], whole: Fit, offered: Sequence[Candidate]
) -> tuple[Found, ...]:
    """The same effects; a name that fails the blocks it has not seen is no longer claimed alone.

    It fails where the blocks' error is smaller without it and its coefficients, from the rest of the poses,
    contradict those from all of them (Hausman, Econometrica 46, 1978). A block that the rest cannot predict,
    the effect being true, contradicts nothing.

    Args:
        r: the poses.
        found: all effects of the model.
        whole: the fit of them all.
        offered: candidates of these poses; a shape without a name among them becomes the rival.
    """
    accepted = [f.candidate for f in found]
    folds = _folds(r)

    def judged(place: int, one: Found) -> Found:
        others = [c for c in accepted if c is not one.candidate]
        rival = _nameless(one.candidate, offered) if one.candidate.named else None
        if rival is None:
            return one
        for along, fold in folds.items():
            helps = rms(_errors(r, accepted, along)) < rms(_errors(r, others, along))
            if not helps and _contradicts(r, accepted, place, whole, fold):
                return one.against(rival, f"it does not predict poses of a block of {along} left out")
        return one

    return tuple(judged(place, one) for place, one in enumerate(found))


def _folds(r: Responses) -> dict[str, Intp]:
    """(n,) block of each pose, for each way to lay them: along every run, and over the elevations."""
    first = np.unique([0, *np.flatnonzero(r.starts)])  # what a run began with may have been left out
    length = np.diff([*first, len(r)])
    since = np.arange(len(r)) - np.repeat(first, length)
    folds = {}
    if length.min() >= 2 * BLOCKS:  # a table without history has none to part
        folds["time"] = since * BLOCKS // np.repeat(length, length)
    places = np.unique(np.round(r.theta_deg))
    if len(places) >= 2 * BLOCKS:
        edges = places[np.arange(1, BLOCKS) * len(places) // BLOCKS]
        folds["angle"] = np.searchsorted(edges, np.round(r.theta_deg), side="right")
    return folds


def _errors(r: Responses, accepted: Sequence[Candidate], along: str) -> FloatArray:
    return _errors_along(r, tuple(accepted), along)


@lru_cache(maxsize=KEPT)
def _errors_along(r: Responses, accepted: tuple[Candidate, ...], along: str) -> FloatArray:
    errors, fold = np.zeros(len(r)), _folds(r)[along]
    for k in range(BLOCKS):
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        shown = _shown(r, accepted, train)
        beta = fitted_model(r.rows(train), [c.rows(train) for c in shown]).fitted.beta
        errors[test] = errors_deg(*linear_about(r, shown, beta), beta, test)
    return errors


def _shown(r: Responses, accepted: Sequence[Candidate], train: Intp) -> list[Candidate]:
    """The effects that some of the poses can show beside bias, scale and the effects before."""
    shown: list[Candidate] = []
    for candidate in accepted:
        before = _flat(model_columns(r, shown)[train])
        own = _flat(candidate.columns[train])
        left = own - before @ np.linalg.lstsq(before, own, rcond=None)[0]
        if np.linalg.norm(left) > ESTIMABLE * np.linalg.norm(own):
            wavy = candidate.columns.shape[2] >= WAVY
            shown.append(_as_far_as_shown(candidate, train, before) if wavy else candidate)
    return shown


def _as_far_as_shown(curve: Candidate, train: Intp, before: FloatArray) -> Candidate:
    """A wavy curve less what it does where no pose is left: the spline would fly off there."""
    whole, _ = np.linalg.qr(_flat(curve.columns))
    directions = whole.reshape(*curve.columns.shape)
    own = _flat(directions[train])
    left = own - before @ np.linalg.lstsq(before, own, rcond=None)[0]
    _, seen, turn = np.linalg.svd(left, full_matrices=False)
    return replace(curve, columns=directions @ turn[seen > FORESEEN].T)


def _flat(columns: FloatArray) -> FloatArray:
    return columns.reshape(-1, columns.shape[2])


def _contradicts(r: Responses, accepted: Sequence[Candidate], place: int, whole: Fit, fold: Intp) -> bool:
    """Whether coefficients without some block differ from the whole's by more than their errors allow."""
    from scipy.special import chdtrc

    model = fitted_model(r, accepted)
    r, accepted, columns = model.responses, model.accepted, model.columns
    at = own_columns(columns, accepted)[place]
    for k in range(BLOCKS):
        train = np.flatnonzero(fold != k)
        if len(_shown(r, accepted, train)) < len(accepted):
            continue
        part = fit(r.rows(train), columns[train])
        change = part.beta[at] - whole.beta[at]
        # Var(change) = Var(part) − Var(whole), which errs with both: the first alone is on the safe side
        distance = float(change @ np.linalg.pinv(part.covariance[at, at], hermitian=True) @ change)
        if chdtrc(len(change), distance) < UNSTABLE:
            return True
    return False


def _nameless(claimed: Candidate, offered: Sequence[Candidate]) -> Candidate | None:
    """A shape without a name that follows the same column as the claimed effect, the smoothest first."""
    return next((c for c in offered if not c.named and c.covariate == claimed.covariate), None)
