"""What a rig's reference made of a result, as the result keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from calrig.calibration.coverage import Distribution
from calrig.calibration.fit import Line
from calrig.calibration.over_range import frozen
from calrig.calibration.uncertainty import Covariance, Reference, ReferenceKind, reference_part
from calrig.estimation.angles import FloatArray


@dataclass(frozen=True, slots=True)
class ReferenceFigures:
    """What the rig says its stage is worth, and what that makes of bias and scale.

    Standard uncertainties of type B: `bias_std_deg` and `scale_std` of the result itself are of type A.
    `line_covariance` is that of `Reference`; None but for a stage's map.
    """

    std_deg: float
    kind: ReferenceKind
    bias_std_deg: float
    scale_std: float | None
    distribution: Distribution = "rectangular"
    line_covariance: Covariance | None = None

    @property
    def reference(self) -> Reference:
        """What the rig said."""
        return Reference(self.std_deg, self.kind, self.distribution, self.line_covariance)

    @classmethod
    def of(cls, theta_deg: FloatArray, line: Line, reference: Reference) -> ReferenceFigures:
        """Of a line fitted to poses at these elevations (n,)."""
        part = reference_part(theta_deg, line.scale, reference)
        known = reference.distribution, reference.line_covariance
        return cls(reference.std_deg, reference.kind, part.bias_deg, part.scale, *known)

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> ReferenceFigures:
        """What a result has of it; those of before have no distribution, or no covariance."""
        return cls(**{one.name: frozen(document[one.name]) for one in fields(cls) if one.name in document})
