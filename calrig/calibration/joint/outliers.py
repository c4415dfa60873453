"""Poses that have gone wrong alone: found by fits in which those far off count less, then left out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from calrig.calibration.joint.linearised import Linearised
from calrig.calibration.joint.table import BoolArray, Table
from calrig.calibration.outliers import most_outliers
from calrig.estimation.angles import FloatArray

OUTLIER_STD = 7.0
"""Standard deviations from the model, beyond which noise takes no pose."""
ROUNDS = 4
GROSS_G = 0.5
"""A vector whose length is off by more is none of gravity."""
TOLD = 5
"""Of the poses that were left out, how many are named."""


FitT = TypeVar("FitT", bound=Linearised)


def fitted_without_outliers(
    fitting: Callable[[FloatArray, FloatArray | None, bool], FitT],
    distances: Callable[[FitT], FloatArray],
    size_g: FloatArray,
) -> tuple[FitT, FloatArray]:
    """A fit, and the weights (n,) of the poses: 0 of those that have gone wrong alone.

    Where many are far off it is the model that is wrong, and none is left out.

    Args:
        fitting: of the problem, by weights (n,), where to begin (p,), and whether poses far off count less.
        distances: (n,) how far each pose lies from what the others say of it, in standard deviations.
        size_g: (n,) of each pose's vector; NaN of a reading alone.
    """
    gross = np.abs(size_g - 1.0) > GROSS_G
    weights = np.where(gross, 0.0, 1.0)
    fit = fitting(weights, None, True)
    for _ in range(ROUNDS):
        outlying = gross | (distances(fit) > OUTLIER_STD)
        if outlying.sum() > most_outliers(len(outlying)):
            weights = np.where(gross, 0.0, 1.0)
            break
        if (outlying == (weights == 0.0)).all():
            break
        weights = np.where(outlying, 0.0, 1.0)
        fit = fitting(weights, fit.parameters, True)
    return fitting(weights, fit.parameters, False), weights


def outliers_said(table: Table, kept: BoolArray, distances: FloatArray) -> list[str]:
    """Poses that were left out, each by its place; and how many (n,) lie as far off and were not."""
    said = []
    left_out = np.flatnonzero(~kept)
    if len(left_out):
        listed = ", ".join(
            f"{table.mounts[table.mount[k]].name} at {table.dial_deg[k]:g}°" for k in left_out[:TOLD]
        )
        said.append(f"{len(left_out)} outliers were left out: {listed}")
    far = int((distances[kept] > OUTLIER_STD).sum())
    if far:
        said.append(f"{far} poses lie far from the model, too many to be left out: something else moved")
    return said
