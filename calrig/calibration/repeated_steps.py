"""Further steps of generalised least squares for many responses, the noise found anew before each.

Coefficients and a strongly correlated noise agree slowly. Each response has a noise of its own by then, but
whatever that is, it weighs the same lagged products of columns (`lagged_products`): those of the model's
columns are made once for all responses, those of a candidate's once for all that it was fitted to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.lagged_products import LaggedProducts, lagged_products
from calrig.calibration.noise_model import ITERATIONS
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

Intp = npt.NDArray[np.intp]


class Steps(NamedTuple):
    """What all steps leave of m responses: residuals (m, n·J), and their products.

    By how much coefficients changed since the first step: `inside` (m, q) those of the model, `more` (m, w)
    those beside it.
    """

    residuals: FloatArray
    products: LaggedProducts
    inside: FloatArray
    more: FloatArray


class RepeatedSteps:
    """Steps on from the first, for a model's columns (q, n·J), none of them nothing."""

    def __init__(self, r: Responses, model: FloatArray) -> None:
        self._r = r
        self._model = model
        self._lagged = _lagged(self._model[None], r)[0]
        self._own = _products(self._lagged[None], self._model[None], r)[0]

    def steps(self, left: FloatArray, beside: FloatArray, at: Intp, taken: float) -> Steps:
        """All steps.

        Args:
            left: (m, n·J) what the first step leaves.
            beside: (k, w, n·J) columns beside the model.
            at: (m,) which of them.
            taken: parameters that a fit takes per channel.
        """
        r, q, w = self._r, len(self._model), beside.shape[1]
        lagged = _lagged(beside, r)
        crossed = _products(np.broadcast_to(self._lagged, (len(beside), *self._lagged.shape)), beside, r)
        own = _products(lagged, beside, r)
        of_left = np.concatenate(
            [
                _products(np.broadcast_to(self._lagged, (len(left), *self._lagged.shape)), left[:, None], r),
                _products(lagged[at], left[:, None], r),
            ],
            axis=2,
        )
        residuals, inside = left, np.zeros((len(left), q + w))
        products = lagged_products(residuals.reshape(-1, *r.values.shape), r.starts, r.rounding)
        for _ in range(ITERATIONS - 1):
            weights = _weights(*products.noises(taken))
            gram = np.empty((len(left), q + w, q + w))
            gram[:, :q, :q] = (weights[:, 0] @ self._own).reshape(len(left), q, q)
            gram[:, :q, q:] = (weights @ crossed[at]).reshape(len(left), q, w)
            gram[:, q:, :q] = np.swapaxes(gram[:, :q, q:], 1, 2)
            gram[:, q:, q:] = (weights @ own[at]).reshape(len(left), w, w)
            power = np.einsum("mii->mi", gram)
            power += power == 0.0  # of nothing the coefficient is 0
            inside = np.linalg.solve(gram, np.swapaxes(weights @ of_left, 1, 2))[:, :, 0]
            residuals = left - inside[:, :q] @ self._model
            residuals -= (inside[:, None, q:] @ beside[at])[:, 0]
            products = lagged_products(residuals.reshape(-1, *r.values.shape), r.starts, r.rounding)
        return Steps(residuals, products, inside[:, :q], inside[:, q:])


def _weights(rotation: FloatArray, rho: FloatArray) -> FloatArray:
    """(m, 1, 3·J·J) what a noise multiplies lagged products by, of innovations to make the products."""
    white = 1.0 - rho**2
    of_channel = np.stack([np.ones_like(rho), -rho / white, rho**2 / white], axis=1)
    weighed = (rotation[:, None] * of_channel[:, :, None, :]) @ np.swapaxes(rotation, 1, 2)[:, None]
    return np.asarray(weighed.reshape(len(rho), 1, -1), dtype=np.float64)


def _lagged(rows: FloatArray, r: Responses) -> FloatArray:
    """(k, 3·w·J, n) what columns (k, w, n·J) are multiplied by for their same, lagged and inner products."""
    follows = ~r.starts
    follows[0] = False
    k, w = rows.shape[:2]
    channels = np.swapaxes(rows.reshape(k, w, *r.values.shape), 2, 3)
    lagged, inner = np.zeros((2, *channels.shape))
    after, before = channels[..., 1:] * follows[1:], channels[..., :-1] * follows[1:]
    lagged[..., 1:] += before
    lagged[..., :-1] += after
    inner[..., 1:] += after
    inner[..., :-1] += before
    return np.stack([channels, lagged, inner], axis=1).reshape(k, 3 * w * len(r.channels), len(r))


def _products(lagged: FloatArray, rows: FloatArray, r: Responses) -> FloatArray:
    """(k, 3·J·J, v·w) products of columns as `_lagged` gives them with others (k, w, n·J)."""
    (k, w), (n, channels) = rows.shape[:2], r.values.shape
    v = lagged.shape[1] // (3 * channels)
    others = np.swapaxes(rows.reshape(k, w, n, channels), 1, 2).reshape(k, n, w * channels)
    found = (lagged @ others).reshape(k, 3, v, channels, w, channels)
    return np.moveaxis(found, (3, 5), (2, 3)).reshape(k, 3 * channels * channels, v * w)
