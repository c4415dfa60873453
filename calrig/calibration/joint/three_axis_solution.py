"""Stage, mounts and whole units from a set of poses, with how many orders the map has chosen by the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.joint.order_choice import Choice, always, chosen, offered
from calrig.calibration.joint.outliers import outliers_said
from calrig.calibration.joint.stage_map import TURN_DEG
from calrig.calibration.joint.table import Mounted, Table
from calrig.calibration.joint.three_axis_fit import (
    ThreeAxisFit,
    fitted_whole,
    noise_of_axes,
    vector_correlation,
    vector_distances,
    without_outlying_vectors,
)
from calrig.calibration.joint.three_axis_problem import ThreeAxisProblem
from calrig.calibration.joint.three_axis_table import ThreeAxisTable, three_axis_table
from calrig.calibration.pose import DiagnosisError
from calrig.calibration.progress import Progress, unheard

FEWEST_SPARE = 12
"""Responses beside the parameters, which the noise is found from."""
MOST_TILT_DEG = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class ThreeAxisSolution:
    """Stage, mounts and whole units.

    Attributes:
        fit: of the model that the data carry.
        choice: how that model was chosen.
        warnings: what a person should know of the poses.
    """

    fit: ThreeAxisFit
    choice: Choice
    warnings: tuple[str, ...]

    @property
    def of(self) -> ThreeAxisTable:
        """The poses."""
        return self.fit.problem.of

    @property
    def table(self) -> Table:
        """The same as of mounts about x."""
        return self.fit.problem.table

    @property
    def noise_deg(self) -> float:
        """Standard deviation of one pose's angle."""
        return float(np.degrees(self.fit.noise))


def solve_whole(
    lots: Sequence[Mounted],
    *,
    linear: bool = False,
    periods_deg: Sequence[float] = (),
    progress: Progress = unheard,
) -> ThreeAxisSolution:
    """Solves stage, mounts and units clamped by several faces at once; arguments as `solution.solve`.

    Raises:
        DiagnosisError: the poses are too few, or cannot be what they are said to be.
    """
    table, warnings = three_axis_table(lots)
    known = [TURN_DEG / period for period in periods_deg]
    shape = np.ones((len(table.seen.units), 3))
    problem = ThreeAxisProblem(table, always(linear, known), linear, shape)
    orders = offered(problem, 3 * len(problem.table), FEWEST_SPARE)
    rich, weights = without_outlying_vectors(replace(problem, orders=orders))
    progress(0.5)
    rich = noise_of_axes(rich)
    correlated = replace(rich.problem, correlation=vector_correlation(rich))
    progress(0.7)
    choice = chosen(fitted_whole(correlated, weights, rich.parameters), known)
    fit = fitted_whole(replace(correlated, orders=choice.orders), weights)
    _refuse_another_face(fit)
    said = outliers_said(table.seen, fit.kept, vector_distances(fit))
    return ThreeAxisSolution(fit, choice, (*warnings, *said))


def _refuse_another_face(fit: ThreeAxisFit) -> None:
    for mount, named in enumerate(fit.problem.table.mounts):
        tilt_deg = float(np.degrees(np.abs(fit.parameters[fit.problem.tilts_at(mount)]).max()))
        if tilt_deg > MOST_TILT_DEG:
            raise DiagnosisError(
                f"mount {named.name} of unit {fit.problem.table.units[named.unit]}: mount_axis is "
                f"{fit.problem.of.faces[mount]}, but that axis lies {tilt_deg:.0f}° from the stage's"
            )
