"""The model as a whole, after an effect has entered: what cannot be, and what is not needed any more.

Forward steps alone keep what once helped: two curves of 222° and 243° that cancel, an offset of 2.8 g against
an eccentricity, a cycle of time that the angle has explained since.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.model import own_columns
from calrig.calibration.noise_model import Fit, stacked
from calrig.calibration.ranking import Found
from calrig.calibration.responses import Responses
from calrig.calibration.sensor_model import fitted_model
from calrig.estimation.angles import FloatArray

LARGEST_CONDITION = 30.0
"""Condition index beyond which coefficients say more of each other than of the poses (Belsley, Kuh & Welsch,
Regression Diagnostics, 1980, section 3.2)."""
SAME_THING = 1e3
"""Condition index beyond which two effects are one under two names."""
CANCELS = 3.0
"""Times its sum with the others that an effect's part of the reading may be."""


def tenable(r: Responses, accepted: Sequence[Candidate]) -> bool:
    """Whether effects can all be true together: as physics allows them, and not one against another.

    Args:
        r: the responses.
        accepted: the effects of a model.
    """
    model = fitted_model(r, accepted)
    columns, fitted, r = model.columns, model.fitted, model.responses
    own = own_columns(columns, accepted)
    if not all(c.is_possible(fitted.beta[at]) for c, at in zip(accepted, own, strict=True)):
        return False
    if len(accepted) < 2:
        return True
    condition = _condition(r, columns, fitted, own)
    cancels = condition > LARGEST_CONDITION and _cancel(columns, fitted, own)
    return condition < SAME_THING and not cancels


def _condition(r: Responses, columns: FloatArray, fitted: Fit, own: Sequence[slice]) -> float:
    """Largest over smallest singular value of what the effects do to all responses, beside bias and scale."""
    design = stacked(fitted.noise, r.starts, columns)
    base, effects = design[:, : own[0].start], design[:, own[0].start :]
    beside = effects - base @ np.linalg.lstsq(base, effects, rcond=None)[0]
    size = np.linalg.norm(beside, axis=0)
    values = np.linalg.svd(beside / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return float(values[0] / max(values[-1], float(np.finfo(np.float64).tiny)))


def _cancel(columns: FloatArray, fitted: Fit, own: Sequence[slice]) -> bool:
    """Whether two effects add to the reading many times what all of them add together."""
    parts = np.stack([columns[:, 0, at] @ fitted.beta[at] for at in own])
    base = columns[:, 0, : own[0].start]
    beside = parts - (base @ np.linalg.lstsq(base, parts.T, rcond=None)[0]).T
    together = float(beside.sum(axis=0).std())
    return int((beside.std(axis=1) > CANCELS * together).sum()) >= 2


def parted(r: Responses, found: Sequence[Found], known: int = 0) -> tuple[list[Found], list[str]]:
    """The effects that the others do not make superfluous, and the labels of those that they do.

    An effect is worth its place where the model without it is worse by more than log n a parameter. One
    that was dropped does not come back: so a search ends.

    Args:
        r: the responses.
        found: the effects of a model; the last to enter has passed the gate and stays.
        known: how many of the first were found in another base, and stay.
    """
    kept, dropped = list(found), []
    while len(kept) > 1:
        whole = fitted_model(r, [f.candidate for f in kept]).fitted.criterion
        followed = {f.candidate.follows for f in kept}
        free = [
            k
            for k, f in enumerate(kept[:-1])
            if k >= known and f.candidate.name not in followed and not f.candidate.effect.place
        ]
        worth = {k: _worth(r, kept, k, whole) for k in free}
        least = min(worth, key=worth.__getitem__, default=None)
        if least is None or worth[least] >= 0.0:
            break
        dropped.append(kept.pop(least).candidate.label)
    return kept, dropped


def _worth(r: Responses, found: Sequence[Found], place: int, whole: float) -> float:
    """By how much the penalised criterion would be worse without an effect."""
    without = [f.candidate for k, f in enumerate(found) if k != place]
    penalty = float(np.log(len(r))) * found[place].candidate.parameters
    return fitted_model(r, without).fitted.criterion - whole - penalty
