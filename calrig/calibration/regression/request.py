"""What a person knows before a diagnosis: whether the reference may err, and periods of the axis."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

from calrig.calibration.poses import DiagnosisError

AssumedReference = Literal["stage", "good"]
ASSUMED = "reference"
"""Key of an imported run's provenance: which of these its import stated."""
LONGEST_PERIOD_DEG = 360.0
MOST_PERIODS = 20


@dataclass(frozen=True, slots=True)
class DiagnosisRequest:
    """What a diagnosis is to assume.

    Attributes:
        reference: `stage`: the reference angle may err, and periodic and smooth terms of it are the stage's.
            `good`: it does not, and they are the sensor's (CONTRACT section 5).
        periods_deg: known periods of the axis, such as a worm's, ascending; (0°, 360°].
        reference_std_deg: what is stated of the reference; None where nothing is. It decides nothing.

    Raises:
        DiagnosisError: a period is out of its limits, or there are too many.
    """

    reference: AssumedReference = "stage"
    periods_deg: tuple[float, ...] = ()
    reference_std_deg: float | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for period_deg in self.periods_deg:
            if not (math.isfinite(period_deg) and 0.0 < period_deg <= LONGEST_PERIOD_DEG):
                raise DiagnosisError(f"known period {period_deg:g}°: it must be above 0° and at most 360°")
        if len(self.periods_deg) > MOST_PERIODS:
            raise DiagnosisError(f"{len(self.periods_deg)} known periods: at most {MOST_PERIODS} are allowed")
        object.__setattr__(self, "periods_deg", tuple(sorted(set(map(float, self.periods_deg)))))

    @classmethod
    def of_document(cls, diagnosis: Mapping[str, Any]) -> Self:
        """Return what a stored diagnosis assumed; those of before have no such keys."""
        return cls(diagnosis.get("reference", "stage"), tuple(diagnosis.get("known_periods_deg", ())))

    @property
    def is_good(self) -> bool:
        """Whether the reference is taken as free of error."""
        return self.reference == "good"


AS_USUAL = DiagnosisRequest()
