"""What the choice of orders and the map's figures need of a fit, of planes or of whole units alike."""

from __future__ import annotations

from typing import Protocol

from calrig.calibration.joint.parameters import Parameters
from calrig.calibration.joint.table import BoolArray, Intp
from calrig.estimation.angles import FloatArray


class NormalEquations(Protocol):
    """Weighted, about some parameters: JᵀWJ and JᵀWr."""

    @property
    def matrix(self) -> FloatArray: ...  # noqa: D102
    @property
    def gradient(self) -> FloatArray: ...  # noqa: D102


class Linearised(Protocol):
    """A fit with its normal equations; attributes as `least_squares.Fit` has them."""

    @property
    def problem(self) -> Parameters: ...  # noqa: D102
    @property
    def parameters(self) -> FloatArray: ...  # noqa: D102
    def covariance_of(self, rows: FloatArray) -> FloatArray: ...  # noqa: D102
    def covariance_at(self, places: Intp) -> FloatArray: ...  # noqa: D102
    @property
    def noise(self) -> float: ...  # noqa: D102
    @property
    def freedom(self) -> float: ...  # noqa: D102
    @property
    def normal(self) -> NormalEquations: ...  # noqa: D102
    @property
    def kept(self) -> BoolArray: ...  # noqa: D102
