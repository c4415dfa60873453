"""Fits of the same responses with one model and each of many candidates beside it.

As `noise_model.fits` of all these models, without their common columns once for each: those are made
orthonormal once, a candidate's once beside them (Frisch & Waugh, Econometrica 1, 1933), and what a noise
weighs in every further step are products of columns that need no pose any more (`repeated_steps`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.noise_model import orthonormal
from calrig.calibration.repeated_steps import RepeatedSteps
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

NARROW = 2
"""Columns of most candidates: they are fitted as if all had so many, wider ones as if all had as many."""


class FitsBeside(NamedTuple):
    """Of k models: criterion (k,), coefficients (p,) each, the candidate's last, and residuals (k, n, J)."""

    criterion: FloatArray
    beta: list[FloatArray]
    residuals: FloatArray


def fits_beside(
    r: Responses,
    columns_with: Callable[[Sequence[Candidate]], FloatArray],
    candidates: Sequence[Candidate],
) -> FitsBeside:
    """Fits a model with each candidate beside it.

    Args:
        r: the responses.
        columns_with: (n, J, p) columns of the model with some candidates beside it.
        candidates: those.
    """
    count = len(candidates)
    found = FitsBeside(np.empty(count), [np.empty(0)] * count, np.empty((count, *r.values.shape)))
    alike: dict[str | None, list[int]] = {}
    for k, candidate in enumerate(candidates):
        alike.setdefault(candidate.shape.replaces, []).append(k)
    for those in alike.values():
        own = [candidates[k].columns for k in those]
        model = columns_with([candidates[those[0]]])[:, :, : -own[0].shape[2]]
        part = _fits_beside(r, model, own)
        found.criterion[those], found.residuals[those] = part.criterion, part.residuals
        for k, beta in zip(those, part.beta, strict=True):
            found.beta[k] = beta
    return found


def _fits_beside(r: Responses, model: FloatArray, candidates: Sequence[FloatArray]) -> FitsBeside:
    """Of columns (n, J, w) each beside a model (n, J, q)."""
    q, (n, channels) = model.shape[2], r.values.shape
    spread = np.hypot(r.values.std(axis=0), r.rounding)
    weight = np.broadcast_to(1.0 / spread, (n, channels)).ravel()  # white to begin with
    rows = model.reshape(-1, q).T
    turn = _orthonormal_turn((rows * weight)[None])[0]
    base = turn.T @ rows
    there = np.any(base != 0.0, axis=1)
    base, turn = base[there], turn[:, there]
    values = r.values.ravel()
    first = base @ (values * weight**2)
    alone = values - first @ base
    further = RepeatedSteps(r, base)
    taken = max(1.0, (q + max(c.shape[2] for c in candidates)) / channels)
    count = len(candidates)
    found = FitsBeside(np.empty(count), [np.empty(0)] * count, np.empty((count, n, channels)))
    narrow = [k for k, candidate in enumerate(candidates) if candidate.shape[2] <= NARROW]
    wide = [k for k, candidate in enumerate(candidates) if candidate.shape[2] > NARROW]
    for those in filter(None, (narrow, wide)):
        own = np.zeros((len(those), max(candidates[k].shape[2] for k in those), values.size))
        for place, k in enumerate(those):
            own[place, : candidates[k].shape[2]] = candidates[k].reshape(values.size, -1).T
        inside = own @ (base * weight**2).T
        left = own - inside @ base
        across = np.swapaxes(_orthonormal_turn(left * weight, own * weight), 1, 2)
        beside = across @ left
        along = beside @ (values * weight**2)
        residuals = (alone - (along[:, None] @ beside)[:, 0]) * r.known.ravel()
        steps = further.steps(residuals, beside, np.arange(len(those)), taken)
        found.criterion[those] = steps.products.criterion(*steps.products.noises(taken))
        found.residuals[those] = (steps.residuals * r.known.ravel()).reshape(-1, n, channels)
        of_own = ((along + steps.more)[:, None] @ across)[:, 0]
        of_model = (first + steps.inside - (of_own[:, None] @ inside)[:, 0]) @ turn.T
        for place, k in enumerate(those):
            found.beta[k] = np.concatenate([of_model[place], of_own[place, : candidates[k].shape[2]]])
    return found


def _orthonormal_turn(rows: FloatArray, before: FloatArray | None = None) -> FloatArray:
    """(k, w, w) what makes columns, in rows (k, w, n·J), orthonormal; `before` others were taken off them."""
    size = np.linalg.norm(rows if before is None else before, axis=2)
    return orthonormal(rows @ np.swapaxes(rows, 1, 2), size)
