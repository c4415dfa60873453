"""The error left of a calibrated elevation over its range, and how well it is known: limits rest on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from calrig.calibration.fit import Line
from calrig.calibration.uncertainty import Reference, uncertainty
from calrig.estimation.angles import FloatArray

STRETCHES = 12
"""Of the range: ±60° in steps of 10° have one about each elevation, and its two ends have one each."""
DECIMALS = 6
"""A microdegree; a result is kept and sent with every run."""


@dataclass(frozen=True, slots=True)
class OverRange:
    """The line that was found and, over the range, the error that is left once everything is applied.

    Attributes:
        bias_deg, scale: as found, beside all effects accepted.
        covariance: of bias and scale, type A; None where too few poses tell.
        freedom: degrees of freedom of the scatter that it is from.
        expanded_uncertainty_deg: of one calibrated elevation; None where the reference is not known.
        error_expanded_uncertainty_deg: of the errors below, which are not their own uncertainty: the noise of
            a reading stands in it where that of an elevation has all that is left. None likewise.
        coverage_factor: its k, for the probability `coverage`.
        elevation_deg: (m,) in the middle of stretches of the range, ascending.
        lowest_error_deg: (m,) of the poses in each stretch, calibrated elevation less θ.
        highest_error_deg: (m,) likewise.
        mean_error_deg: over the range; what a fit leaves has about none, what is verified may.
    """

    bias_deg: float
    scale: float | None
    covariance: tuple[tuple[float, float], tuple[float, float]] | None
    freedom: int
    expanded_uncertainty_deg: float | None
    error_expanded_uncertainty_deg: float | None
    coverage_factor: float | None
    coverage: float
    elevation_deg: tuple[float, ...]
    lowest_error_deg: tuple[float, ...]
    highest_error_deg: tuple[float, ...]
    mean_error_deg: float

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {name: _thawed(value) for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> OverRange:
        """What `to_dict` gave; further keys of the document are not looked at."""
        return cls(**{one.name: frozen(document[one.name]) for one in fields(cls)})


def frozen(value: Any) -> Any:
    """Lists as tuples, all the way down."""
    return tuple(map(frozen, value)) if isinstance(value, (list, tuple)) else value


def _thawed(value: Any) -> Any:
    return list(map(_thawed, value)) if isinstance(value, tuple) else value


def over_range(
    theta_deg: FloatArray,
    error_deg: FloatArray,
    line: Line,
    reference: Reference | None,
    noise_deg: float | None,
) -> OverRange | None:
    """Gathers what limits need. Errors are not averaged: what approach or time do to a pose would cancel.

    Args:
        theta_deg: (n,) elevations of the poses.
        error_deg: (n,) what is left of each, calibrated elevation less θ.
        line: fitted to these poses.
        reference: what the stage's own angle is worth.
        noise_deg: standard error of one reading, from within the dwells; None where it is not known.

    Returns:
        None where the reading does not follow the stage, so that there is no calibrated elevation.
    """
    if not np.isfinite(error_deg).all():
        return None
    low, width = float(theta_deg.min()), float(np.ptp(theta_deg)) / STRETCHES
    if line.scale is None:  # what a stage scatters by about one elevation is no range
        low, width = float(theta_deg.mean()), 0.0
    places = np.rint((theta_deg - low) / width).astype(int) if width > 0.0 else np.zeros(len(theta_deg), int)
    stretches = np.unique(places)
    of_each = [error_deg[places == place] for place in stretches]
    worth = uncertainty(line, theta_deg, reference)
    of_error = uncertainty(line, theta_deg, reference, noise_deg or None)
    expanded = [u for u in (worth.expanded_deg, of_error.expanded_deg) if u is not None]
    return OverRange(
        bias_deg=line.bias_deg,
        scale=line.scale,
        covariance=line.covariance,
        freedom=len(theta_deg) - (1 if line.scale is None else 2),
        expanded_uncertainty_deg=worth.expanded_deg,
        error_expanded_uncertainty_deg=min(expanded, default=None),
        coverage_factor=worth.coverage_factor,
        coverage=worth.coverage,
        elevation_deg=tuple(round(low + width * place, DECIMALS) for place in stretches.tolist()),
        lowest_error_deg=tuple(round(float(errors.min()), DECIMALS) for errors in of_each),
        highest_error_deg=tuple(round(float(errors.max()), DECIMALS) for errors in of_each),
        mean_error_deg=float(np.mean([errors.mean() for errors in of_each])),
    )
