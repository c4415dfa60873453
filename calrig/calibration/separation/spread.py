"""Estimate what differs between mounts, and quartic terms of the units: variance components.

Clamping strain gives a unit other offsets in each mount, and a stage that was touched has another map. Both
are parameters of each mount, drawn from a normal distribution about those of all; so are the quartic terms of
the units' axes about 0. A standard deviation of 0 is the plain model.

Each standard deviation is found by restricted likelihood (Patterson & Thompson, Biometrika 58, 1971), over a
grid. Few mounts tell it badly, and its most likely value is often 0 where it is not. The mean over
the posterior distribution is taken instead, by a prior that has none with a chance of 0.7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from calrig.calibration.separation.least_squares import LEAST_SQUARES, Fit
from calrig.calibration.separation.problem import PLAIN, Problem, Spread

GRIDS: dict[str, Sequence[float]] = {
    "offset_g": (1e-4, 2e-4, 3e-4, 4.5e-4, 7e-4, 1e-3, 1.5e-3, 2.5e-3, 5e-3),
    "askew": (1e-4, 2e-4, 4e-4, 7e-4, 1e-3, 2e-3, 4e-3),
    "map_rad": tuple(np.radians([0.005, 0.01, 0.015, 0.025, 0.04, 0.06, 0.1, 0.2])),
    "quartic_g": (5e-4, 1e-3, 2e-3, 4e-3, 8e-3),
}
"""Standard deviations that are tried, in equal ratios about."""
NONE = 0.7
"""Chance before the data that a component is not there."""
AS_NONE = 1e-8
"""A standard deviation that fixes a parameter at 0."""
ROUNDS = 3
NEGLIGIBLE = 0.1
"""Of the least that is tried: such a standard deviation is taken as 0."""


def spread_of(fit: Fit) -> Spread:
    """Return the standard deviations, given a fit of the plain model to poses with their correlation.

    None of whole units.
    """
    names = _possible(fit.problem)
    if not names:
        return PLAIN
    likelihood, spread = _Likelihood(fit), PLAIN
    gains = {name: max(likelihood.over(name, spread)) for name in names}
    names.sort(key=lambda name: -gains[name])
    for _ in range(ROUNDS):
        before = spread
        for name in names:
            spread = _averaged(name, likelihood, spread)
        if spread == before:
            break
    return spread


def _possible(problem: Problem) -> list[str]:
    """Components that these poses can show at all."""
    table = problem.table
    if table.is_whole or not table.has_vector.any():
        return []
    several = len(table.mounts) > len(table.units)
    return [
        *(["offset_g", "askew", "map_rad"] if several else []),
        *([] if problem.linear else ["quartic_g"]),
    ]


def _averaged(name: str, likelihood: _Likelihood, spread: Spread) -> Spread:
    grid = GRIDS[name]
    log = np.array([likelihood.of(replace(spread, **{name: 0.0})), *likelihood.over(name, spread)])
    weights = np.exp(log - log.max()) * np.array([NONE, *[(1.0 - NONE) / len(grid)] * len(grid)])
    std = float(weights[1:] @ np.array(grid)) / float(weights.sum())
    return replace(spread, **{name: std if std > NEGLIGIBLE * grid[0] else 0.0})


class _Likelihood:
    """Log of the restricted likelihood of a spread, linear about a fit of the plain model."""

    def __init__(self, fit: Fit) -> None:
        everything = Spread(*[1.0] * len(fields(Spread)))
        self._fit, self._problem = fit, replace(fit.problem, spread=everything)
        self._normal = self._problem.normal(fit.parameters, fit.weights)
        self._widths = self._problem.widths()
        self._places = {
            field.name: np.flatnonzero(
                replace(self._problem, spread=replace(everything, **{field.name: 2.0})).widths()
                != self._widths
            )
            for field in fields(Spread)
        }
        self._found: dict[Spread, float] = {}

    def over(self, name: str, spread: Spread) -> list[float]:
        return [self.of(replace(spread, **{name: std})) for std in GRIDS[name]]

    def of(self, spread: Spread) -> float:
        if spread not in self._found:
            self._found[spread] = self._computed(spread)
        return self._found[spread]

    def _computed(self, spread: Spread) -> float:
        fit, normal, widths, drawn = self._fit, self._normal, self._widths.copy(), 0.0
        for name, places in self._places.items():
            widths[places] = max(getattr(spread, name), AS_NONE)
            drawn += 2.0 * float(np.log(widths[places]).sum())
        inverse = self._problem.inverse(normal.matrix.plus(fit.noise**2 * widths**-2.0))
        explained = float(normal.gradient @ inverse.solve(normal.gradient))
        squares = max(normal.squares - explained, LEAST_SQUARES)
        return -0.5 * (fit.freedom * float(np.log(squares)) + inverse.log_determinant + drawn)
