"""What the choice of orders and the map's figures need of a fit, of planes or of whole units alike."""

from __future__ import annotations

from typing import Protocol

from calrig.calibration.joint.table import BoolArray, Intp, Table
from calrig.estimation.angles import FloatArray


class NormalEquations(Protocol):
    """Weighted, about some parameters: JᵀWJ and JᵀWr."""

    @property
    def matrix(self) -> FloatArray: ...  # noqa: D102
    @property
    def gradient(self) -> FloatArray: ...  # noqa: D102


class Parameters(Protocol):
    """Where a model's parameters are; the mounts' angles, then the orders, then the play are the last."""

    @property
    def table(self) -> Table: ...  # noqa: D102
    @property
    def orders(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def linear(self) -> bool: ...  # noqa: D102
    @property
    def first_mount(self) -> int: ...  # noqa: D102
    @property
    def first_order(self) -> int: ...  # noqa: D102
    @property
    def size(self) -> int: ...  # noqa: D102
    @property
    def map_at(self) -> slice: ...  # noqa: D102
    @property
    def free(self) -> BoolArray: ...  # noqa: D102
    @property
    def blocks(self) -> tuple[Intp, ...]: ...  # noqa: D102
    def widths(self) -> FloatArray: ...  # noqa: D102
    def start(self) -> FloatArray: ...  # noqa: D102


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
