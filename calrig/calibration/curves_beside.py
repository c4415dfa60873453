"""Fits of candidates beside what is in the model already, through atan2 where they bend (`sensor_model`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.fits_beside import fits_beside
from calrig.calibration.model import model_columns, side_by_side
from calrig.calibration.noise_model import fit, fits
from calrig.calibration.responses import Responses
from calrig.calibration.sensor_model import NEGLIGIBLE, STEPS, Curve, fitted_model
from calrig.estimation.angles import FloatArray

LEFT_BEHIND = 60.0
"""Of the criterion: so far behind, a fit that bends by the noise stays linear: it is worth 12 at most."""


def fitted_beside(
    r: Responses, accepted: Sequence[Candidate], shortlist: Sequence[Candidate]
) -> list[tuple[float, FloatArray]]:
    """Criterion and own coefficients of each of several candidates beside the accepted effects.

    All are fitted at once, linear about what is accepted; once more, and again, those that bend.
    """
    at = fitted_model(r, accepted)
    curves = [Curve(r, [*accepted, candidate]) for candidate in shortlist]
    penalties = [float(np.log(len(r))) * candidate.parameters for candidate in shortlist]

    def columns_with(more: Sequence[Candidate]) -> FloatArray:
        return model_columns(at.responses, [*at.accepted, *more])

    straight = fits_beside(at.responses, columns_with, shortlist)
    fitted = list(zip(straight.criterion.tolist(), straight.beta, straight.residuals, strict=True))
    found = [(criterion, beta) for criterion, beta, _ in fitted]
    bent = list(range(len(shortlist)))
    for step in range(1 + STEPS):
        if step > 0:
            fitted = _fitted_straightened(r, [curves[k].straightened(found[k][1]) for k in bent])
        for k, (criterion, beta, _) in zip(bent, fitted, strict=True):
            found[k] = criterion, beta[: curves[k].width]
        least = min(criterion + penalty for (criterion, _), penalty in zip(found, penalties, strict=True))
        bent = [
            k
            for k, (criterion, _, residuals) in zip(bent, fitted, strict=True)
            if _bends_yet(curves[k], found[k][1], residuals, criterion + penalties[k] - least)
        ]
        if not bent:
            break
    for k in bent:  # it does not come to rest: the linear fit
        linear = fit(r, model_columns(r, [*accepted, shortlist[k]]))
        found[k] = linear.criterion, linear.beta
    return [(criterion, beta[curve.own[-1]]) for (criterion, beta), curve in zip(found, curves, strict=True)]


def _fitted_straightened(
    r: Responses, steps: Sequence[tuple[Responses, Sequence[Candidate]]]
) -> list[tuple[float, FloatArray, FloatArray]]:
    """Criterion, coefficients (≥ p,) and residuals (n, J) of several linear models, each of its responses."""
    values = np.stack([straight.values for straight, _ in steps])
    fitted = fits(r, values, side_by_side([model_columns(*step) for step in steps]))
    return list(zip(fitted.criterion.tolist(), fitted.beta, fitted.residuals, strict=True))


def _bends_yet(curve: Curve, beta: FloatArray, residuals: FloatArray, behind: float) -> bool:
    """Whether a linear fit (p,), with residuals (n, J), is worth another about its coefficients.

    Not one so far behind the best, in its penalised criterion, that bending so little does not matter.
    """
    if not curve.bends:
        return False
    by = curve.bent_by(beta, residuals)
    return by >= NEGLIGIBLE and behind < LEFT_BEHIND * max(by, 1.0) and curve.is_possible(beta)
