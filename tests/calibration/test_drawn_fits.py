"""Fits of drawn responses beside generalised least squares done one by one."""

from __future__ import annotations

import numpy as np
import pytest
from studies.blind.cells import CELLS

from calrig.calibration.diagnosis.candidates import candidates_of, model_columns
from calrig.calibration.diagnosis.drawn_fits import DrawnFits
from calrig.calibration.regression.noise_model import (
    ITERATIONS,
    NoiseModel,
    fit,
    lagged_products,
    noise_of,
    stacked,
)
from calrig.calibration.regression.responses import Responses, responses_of


def step_by_step(
    r: Responses, values: np.ndarray, columns: np.ndarray, noise: NoiseModel, steps: int
) -> tuple[float, np.ndarray]:
    """The criterion and the coefficients after so many steps from a noise."""
    taken = max(1.0, columns.shape[2] / len(r.channels))
    for _ in range(steps):
        design, target = (stacked(noise, r.starts, x) for x in (columns, values[:, :, None]))
        beta = np.linalg.lstsq(design, target[:, 0], rcond=None)[0]
        residuals = values - columns @ beta
        products = lagged_products(residuals[None], r.starts, r.rounding)
        (rotation,), (rho,) = products.noises(taken)
        noise = NoiseModel(rotation, rho)
    return float(products.criterion(noise.rotation[None], noise.rho[None])[0]), beta


@pytest.mark.parametrize(("rho", "steps"), [(0.3, 1), (0.9, ITERATIONS)])
def test_fits_of_draws_are_those_of_one_after_the_other(rho: float, steps: int) -> None:
    r = responses_of([CELLS["backlash and periodic"].run(1).poses])
    candidates = candidates_of(r)
    rotation = noise_of(fit(r, r.base).residuals, r, 3.0).rotation
    noise = NoiseModel(rotation, np.array([-0.1, 0.0, 0.2, rho]))
    rng = np.random.default_rng(1)
    drawn = rng.standard_normal((5, len(r), len(r.channels)))
    values = noise.colour(drawn, r.starts) * r.known
    of_gyro = next(k for k, c in enumerate(candidates) if c.shape.replaces)
    chosen = np.column_stack([rng.integers(0, len(candidates), (5, 2)), np.full(5, of_gyro)])

    fits = DrawnFits(r, lambda more: model_columns(r, more), candidates, noise)
    criterion, own = fits.beside(values, np.repeat(np.arange(5), 3), chosen.ravel())

    assert fits.null(values) == pytest.approx([step_by_step(r, y, r.base, noise, steps)[0] for y in values])
    for pair, k in enumerate(chosen.ravel().tolist()):
        columns = model_columns(r, [candidates[k]])
        expected, beta = step_by_step(r, values[pair // 3], columns, noise, steps)
        assert criterion[pair] == pytest.approx(expected, abs=1e-6)
        assert own[pair] == pytest.approx(beta[-candidates[k].columns.shape[2] :], rel=1e-5)
