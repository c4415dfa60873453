"""The model: bias, scale and the effects accepted so far, as columns of one regression."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.candidates import Candidate, base_without
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray


def model_columns(r: Responses, accepted: Sequence[Candidate]) -> FloatArray:
    """(n, J, p) columns of bias and scale, then of the accepted candidates in their order."""
    return np.concatenate([base_without(r, replaced(accepted)), *[c.columns for c in accepted]], axis=2)


def replaced(accepted: Sequence[Candidate]) -> str | None:
    """The base column that one of the candidates takes the place of."""
    return next((c.shape.replaces for c in accepted if c.shape.replaces), None)


def own_columns(columns: FloatArray, accepted: Sequence[Candidate]) -> list[slice]:
    """Where each accepted candidate's own columns lie among those of `model_columns`."""
    ends = np.cumsum([c.columns.shape[2] for c in accepted])
    base = columns.shape[2] - int(ends[-1]) if accepted else 0
    return [
        slice(base + int(end) - c.columns.shape[2], base + int(end))
        for c, end in zip(accepted, ends, strict=True)
    ]


def side_by_side(models: Sequence[FloatArray]) -> FloatArray:
    """(m, n, J, p) of models (n, J, ≤ p); narrower ones end in zeros."""
    width = max(columns.shape[2] for columns in models)
    padded = np.zeros((len(models), *models[0].shape[:2], width))
    for k, columns in enumerate(models):
        padded[k, :, :, : columns.shape[2]] = columns
    return padded
