"""What the unit's own gyro says of a run: its bias in the dwells, and the moves between them."""

from __future__ import annotations

from dataclasses import dataclass, field

from calrig.calibration.poses import GYRO_MOVES
from calrig.calibration.results import GyroFigures
from calrig.estimation.gyro import GyroBias, dwell_bias, felt_move_deg, gyro_scale, run_bias
from calrig.instruments.types import Samples


@dataclass
class OwnGyro:
    """The gyro over a run.

    Attributes:
        along: which axis lies along the stage's, 0 to 2.
        biases: from each dwell.
    """

    along: int
    biases: list[GyroBias] = field(default_factory=list)

    def dwelt(self, dwell: Samples) -> float | None:
        """Takes a dwell; standard error of its bias about the stage's axis."""
        self.biases.append(dwell_bias(dwell.gyro_dps))
        return self.biases[-1].bias_std_dps[self.along]

    def felt_deg(
        self, move: Samples, period_s: float, lasts_s: float, axis: int | None = None
    ) -> float | None:
        """The turn over the move into the last dwell about an axis, by the bias of the dwells beside it."""
        k = self.along if axis is None else axis
        bias_dps = self.bias_beside_dps(k)
        if bias_dps is None:
            return None
        return felt_move_deg(move.time_s, move.gyro_dps[:, k], bias_dps, period_s, lasts_s)

    def bias_beside_dps(self, axis: int) -> float | None:
        """The mean bias of the last two dwells; None where they do not tell."""
        return _mean_dps(self.biases[-2:], axis)

    def bias_with_dps(self, dwell: Samples) -> float:
        """About the stage's axis, the mean of the last dwell and of one that has not been taken yet."""
        biases = [*self.biases[-1:], dwell_bias(dwell.gyro_dps)]
        return _mean_dps(biases, self.along) or 0.0

    def felt_about_axes_deg(self, move: Samples, period_s: float, lasts_s: float) -> dict[str, float | None]:
        """The turns over the move into the last dwell about each axis, as a pose's covariates."""
        return {name: self.felt_deg(move, period_s, lasts_s, axis) for axis, name in enumerate(GYRO_MOVES)}

    def figures(self, moves: list[tuple[float, float]]) -> GyroFigures:
        """What dwells and moves say; `moves` pairs what the unit turned with what it felt, degrees."""
        if not self.biases:
            return GyroFigures()
        bias = run_bias(self.biases)
        turned_deg, felt_deg = zip(*moves, strict=True) if moves else ((), ())
        scale = gyro_scale(turned_deg, felt_deg)
        return GyroFigures(
            bias.bias_dps,
            bias.bias_std_dps,
            None if scale is None else scale.scale,
            None if scale is None else scale.scale_std,
        )


def _mean_dps(biases: list[GyroBias], axis: int) -> float | None:
    known = [bias_dps for bias in biases if (bias_dps := bias.bias_dps[axis]) is not None]
    return sum(known) / len(known) if known else None
