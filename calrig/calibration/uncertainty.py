"""What a calibrated elevation is worth: CONTRACT section 6's `uncertainty`, after the GUM."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calrig.calibration.fit import MIN_SCALE, Line

COVERAGE_FACTOR = 2
"""About 95 % of a normal distribution (GUM, JCGM 100:2008, 6.3.3)."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard uncertainties of one calibrated reading, degrees; None where not known.

    Attributes:
        type_a_deg: from the scatter of the unit's own poses.
        type_b_deg: from elsewhere: what the reference is worth.
        reference_deg: the reference's share of it.
        expanded_deg: the two together, times `COVERAGE_FACTOR`.
    """

    type_a_deg: float | None
    type_b_deg: float | None
    reference_deg: float | None
    expanded_deg: float | None

    def to_dict(self) -> dict[str, float | None]:
        """The contract's `uncertainty`."""
        return {
            "type_a_deg": self.type_a_deg,
            "type_b_deg": self.type_b_deg,
            "reference_deg": self.reference_deg,
        }


def uncertainty(line: Line, range_deg: tuple[float, float], reference_std_deg: float | None) -> Uncertainty:
    """Uncertainty of an elevation that the calibration gives from one reading.

    elevation = (reading − bias)/scale, hence by the law of propagation with bias and scale correlated (GUM,
    JCGM 100:2008, 5.2.2, as in its example H.3), s the scatter of a reading about the line:

        u²(θ) = (s² + var(bias) + 2·θ·cov(bias, scale) + θ²·var(scale))/scale²

    One figure for the whole range is the mean of u² over it (F.2.4.5). This is type A (4.2). The reference's
    standard uncertainty is type B (4.3) and common to all poses: no number of poses makes it smaller. The
    two are uncorrelated (5.1.2) and combine to U = k·√(A² + B²), k = 2 (6.2.1).

    Args:
        line: the fit.
        range_deg: lowest and highest calibrated elevation.
        reference_std_deg: what the stage's own angle is worth; None where nobody has said.
    """
    type_a = _type_a_deg(line, range_deg)
    expanded = None
    if type_a is not None and reference_std_deg is not None:
        expanded = COVERAGE_FACTOR * math.hypot(type_a, reference_std_deg)
    return Uncertainty(type_a, reference_std_deg, reference_std_deg, expanded)


def _type_a_deg(line: Line, range_deg: tuple[float, float]) -> float | None:
    if line.scale is None or line.covariance is None or line.residual_std_deg is None:
        return None
    if abs(line.scale) < MIN_SCALE:
        return None
    low, high = range_deg
    mean_theta = (low + high) / 2.0
    mean_theta_squared = (low * low + low * high + high * high) / 3.0
    (bias_variance, shared), (_, scale_variance) = line.covariance
    of_line = bias_variance + 2.0 * mean_theta * shared + mean_theta_squared * scale_variance
    return math.sqrt(line.residual_std_deg**2 + of_line) / abs(line.scale)
