"""Standard errors that know that the noise was estimated from the same poses.

Generalised least squares states what the coefficients would scatter by, were the noise known. Its
correlations are not: estimated from 100 poses they differ from channel to channel by chance, the fit leans on
those that look quiet, and the stated errors are too small by 10 to 30 % (Kackar & Harville, Journal of the
American Statistical Association 79, 1984). By how much, refits tell, of noise drawn from the model that was
found (the parametric bootstrap: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, section 6.5).
"""

from __future__ import annotations

import numpy as np

from calrig.calibration.noise_model import Fit, fits, noise_of
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

DRAWS = 100
"""Which tell an error to 7 % of itself."""


def covariance_of(r: Responses, columns: FloatArray, fitted: Fit, seed: int = 0) -> FloatArray:
    """(p, p) covariance of a fit's coefficients, each error as large as refits scatter, never smaller.

    Args:
        r: the responses.
        columns: (n, J, p) of the fit.
        fitted: the fit.
        seed: of the draws.
    """
    taken = max(1.0, columns.shape[2] / len(r.channels))
    noise = noise_of(fitted.residuals, r, taken, unbiased=True)
    drawn = np.random.default_rng(seed).standard_normal((DRAWS, *fitted.residuals.shape))
    again = fits(r, noise.colour(drawn, r.starts) * r.known, columns[None])
    stated = np.einsum("bpp->p", again.covariance) / DRAWS
    ratio = np.divide((again.beta**2).mean(axis=0), stated, out=np.ones_like(stated), where=stated > 0.0)
    widened = np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(fitted.covariance * widened * widened[:, None], dtype=np.float64)
