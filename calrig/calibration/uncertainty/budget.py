"""Evaluate the uncertainty of a calibrated elevation (GUM): budget, U, errors over the range."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.line import Line
from calrig.calibration.uncertainty.coverage import COVERAGE, coverage_factor
from calrig.estimation.angles import FloatArray
from calrig.model.result import RangeErrors, Reference, ReferenceFigures


@dataclass(frozen=True, slots=True)
class ReferencePart:
    """What the stage's own uncertainty makes of a calibration: standard uncertainties of type B.

    Attributes:
        bias_deg: of the bias.
        scale: of the scale; None with all poses at one angle.
        elevation_deg: of a calibrated elevation, over the poses' elevations.
    """

    bias_deg: float
    scale: float | None
    elevation_deg: float


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard uncertainties of one calibrated reading, degrees; None where not known.

    Attributes:
        type_a_deg: from the scatter of the unit's own poses.
        type_b_deg: from elsewhere: what the reference is worth.
        reference_deg: the reference's share of it.
        expanded_deg: the two together, times `coverage_factor`.
        coverage_factor: k for `coverage`, by the distributions of the two; None with `expanded_deg`.
        coverage: the probability that the expanded uncertainty covers.
        bias_reference_std_deg: type B standard uncertainty of the bias, beside the line's own of type A.
        scale_reference_std: the same of the scale.
    """

    type_a_deg: float | None
    type_b_deg: float | None
    reference_deg: float | None
    expanded_deg: float | None
    bias_reference_std_deg: float | None = None
    scale_reference_std: float | None = None
    coverage_factor: float | None = None
    coverage: float = COVERAGE

    def to_dict(self) -> dict[str, float | None]:
        """The contract's `uncertainty`, and the reference's part of bias and scale."""
        return {
            "type_a_deg": self.type_a_deg,
            "type_b_deg": self.type_b_deg,
            "reference_deg": self.reference_deg,
            "reference_bias_deg": self.bias_reference_std_deg,
            "reference_scale": self.scale_reference_std,
        }


def uncertainty(
    line: Line, theta_deg: FloatArray, reference: Reference | None, scatter_deg: float | None = None
) -> Uncertainty:
    """Uncertainty of an elevation that the calibration gives from one reading.

    elevation = (reading − bias)/scale, hence by the law of propagation with bias and scale correlated (GUM,
    JCGM 100:2008, 5.2.2, as in its example H.3), s the scatter of a reading about the line:

        u²(θ) = (s² + var(bias) + 2·θ·cov(bias, scale) + θ²·var(scale))/scale²

    Beside a curve of the unit's the scale here is the line's `slope`; errors of its parameters are part of
    the same sum, with their correlations to bias and scale (`JointErrors`).

    One figure for the whole range is the mean of u² over it (F.2.4.5). This is type A (4.2). What the
    reference is worth is type B (4.3, `reference_part`). The two are uncorrelated (5.1.2) and combine to
    U = k·√(A² + B²), k for 95 % by `coverage_factor` (6.2.1). All of type A comes from the one scatter s, so
    that it has n − 2 degrees of freedom, less the line's `effect_parameters`. A mean over settings is as good
    as normal.

    Args:
        line: the fit.
        theta_deg: (n,) elevations of the poses it rests on; their lowest and highest are the range.
        reference: standard uncertainty of the stage's angle; None if it is not stated.
        scatter_deg: s of the reading, where it is not to be that of the poses about the line.
    """
    type_a = _type_a_deg(line, theta_deg, scatter_deg)
    if reference is None:
        return Uncertainty(type_a, None, None, None)
    part = reference_part(theta_deg, line.scale, reference)
    of_stage_deg = part.elevation_deg
    k = None
    if type_a is not None:
        freedom = len(theta_deg) - 2.0 - line.effect_parameters
        k = coverage_factor(type_a, freedom, of_stage_deg, reference.combined_distribution)
    return Uncertainty(
        type_a_deg=type_a,
        type_b_deg=of_stage_deg,
        reference_deg=of_stage_deg,
        expanded_deg=None if type_a is None or k is None else k * math.hypot(type_a, of_stage_deg),
        bias_reference_std_deg=part.bias_deg,
        scale_reference_std=part.scale,
        coverage_factor=k,
    )


def reference_part(theta_deg: FloatArray, scale: float | None, reference: Reference) -> ReferencePart:
    """What an error d of the stage's angle, of standard uncertainty u, does to bias, scale and elevation.

    The stage says θ where the elevation is θ − d(θ), so that reading = bias + scale·θ − scale·d: the fit
    takes the least-squares line through −scale·d as if it were the unit's. With X = [1 θ] and
    G = (XᵀX)⁻¹Xᵀ that line has the covariance scale²·G·cov(d)·Gᵀ (GUM 5.2.2), and a calibrated elevation
    is wrong by the line through d itself. By kind:

    - `common`: d is one unknown constant. G·1 = (1, 0): the bias has scale·u, the scale nothing, the
      elevation u, whatever the number of poses.
    - `harmonic`: d = A·sin θ + B·cos θ, with E[A²] = E[B²] = u², so that d has u at every θ: an axis off its
      scale's centre. (bias, scale) have scale²·u²·(g gᵀ + h hᵀ), g = G·sin θ, h = G·cos θ: more poses on the
      same arc change nothing. The elevation is given the whole of u. The line takes up at most that (a
      projection lengthens nothing; over ±60° it takes 98 %), and the rest is in no calibrated reading's
      power to show.
    - `setting`: each pose has a d of its own. cov(d) = u²·1 gives scale²·u²·(XᵀX)⁻¹, and the elevation the
      mean of u²·(1 θ)(XᵀX)⁻¹(1 θ)ᵀ over the range: this alone falls with √n, for the line is an average over
      n settings and a reading in use involves no stage. The scatter about the line shows these errors
      too, so that type A holds them once more: on the safe side, since s² − u² of a few poses may be
      negative. (Where θ is what an encoder with such an error reports, the scale is also too small by u²
      over the variance of θ, 7·10⁻⁵ for 0.29° over ±60°: not corrected.)
    - `map`: propagated through these poses already (`line_covariance`).

    Args:
        theta_deg: (n,) elevations of the poses, n >= 1.
        scale: of the fit; None with all poses at one angle, counts as 1.
        reference: u, and which of the kinds.
    """
    std_deg, kind = reference.std_deg, reference.kind
    factor = 1.0 if scale is None else abs(scale)
    if reference.line_covariance is not None:
        (of_offset, _), (_, of_slope) = reference.line_covariance
        of_scale = None if scale is None else factor * math.sqrt(of_slope)
        return ReferencePart(factor * math.sqrt(of_offset), of_scale, std_deg)
    design = np.ones((len(theta_deg), 1))
    if scale is not None:
        design = np.column_stack([design, theta_deg])
    to_line = np.linalg.pinv(design)
    if kind == "setting":
        line = to_line
    elif kind == "harmonic":
        angle = np.radians(theta_deg)
        line = to_line @ np.column_stack([np.sin(angle), np.cos(angle)])
    else:
        line = np.eye(design.shape[1])[:, :1]
    covariance = np.asarray(std_deg**2 * line @ line.T, dtype=np.float64)
    of_elevation = math.sqrt(mean_over_range(covariance, theta_deg)) if kind == "setting" else std_deg
    return ReferencePart(
        bias_deg=factor * math.sqrt(covariance[0, 0]),
        scale=None if scale is None else factor * math.sqrt(covariance[1, 1]),
        elevation_deg=of_elevation,
    )


def mean_over_range(covariance: FloatArray, theta_deg: FloatArray) -> float:
    """Mean of (1 θ)·covariance·(1 θ)ᵀ over the range of the elevations; the bias' alone where it is 1×1."""
    if len(covariance) == 1:
        return float(covariance[0, 0])
    low, high = float(theta_deg.min()), float(theta_deg.max())
    mean, mean_square = (low + high) / 2.0, (low * low + low * high + high * high) / 3.0
    return float(covariance[0, 0] + 2.0 * mean * covariance[0, 1] + mean_square * covariance[1, 1])


def trapezoids(theta_deg: FloatArray) -> FloatArray:
    """Return (m,) weights by which smooth errors at ascending elevations have their mean over the range."""
    if len(theta_deg) == 1:
        return np.ones(1)
    between_deg = np.diff(theta_deg)
    return np.asarray(0.5 * (np.append(between_deg, 0.0) + np.append(0.0, between_deg)) / between_deg.sum())


def _type_a_deg(line: Line, theta_deg: FloatArray, scatter_deg: float | None) -> float | None:
    if line.scale is None or line.covariance is None or line.residual_std_deg is None:
        return None
    if not line.follows:
        return None
    scatter_deg = line.residual_std_deg if scatter_deg is None else scatter_deg
    if line.errors is not None:
        return math.hypot(scatter_deg / (line.slope or line.scale), line.errors.mean_variance_deg2**0.5)
    of_line = mean_over_range(np.array(line.covariance), theta_deg)
    return math.sqrt(scatter_deg**2 + of_line) / abs(line.slope or line.scale)


MOST_PLACES = 25
"""Elevations at which errors are gathered one by one; of more, in as many segments of the range."""
DECIMALS = 6
"""A microdegree; a result is kept and sent with every run."""


def frozen(value: Any) -> Any:
    """Lists as tuples, all the way down."""
    return tuple(map(frozen, value)) if isinstance(value, (list, tuple)) else value


def places_deg(theta_deg: FloatArray, nominal_deg: FloatArray) -> FloatArray:
    """Return (n,) elevations at which the errors of poses are gathered, for the verdict and for every table.

    Those commanded, if they are at most `MOST_PLACES`; else the middles of as many segments of the range.

    `theta_deg` and `nominal_deg` are (n,) elevations of the poses, and those that they were commanded to.
    """
    places = np.round(nominal_deg, 3)
    if len(np.unique(places)) <= MOST_PLACES:
        return np.asarray(places, dtype=np.float64)
    low, width = float(theta_deg.min()), float(np.ptp(theta_deg)) / (MOST_PLACES - 1)
    if width == 0.0:
        return np.full(len(theta_deg), low)
    return np.asarray(np.round(low + width * np.rint((theta_deg - low) / width), 2), dtype=np.float64)


def over_range(
    theta_deg: FloatArray,
    error_deg: FloatArray,
    line: Line,
    reference: Reference | None,
    noise_deg: float | None,
    nominal_deg: FloatArray | None = None,
) -> RangeErrors | None:
    """Gathers what limits need. Errors are not averaged: what approach or time do to a pose would cancel.

    Args:
        theta_deg: (n,) elevations of the poses.
        error_deg: (n,) what is left of each, calibrated elevation less θ.
        line: fitted to these poses.
        reference: what the stage's own angle is worth.
        noise_deg: standard error of one reading, from within the dwells; None where it is not known.
        nominal_deg: (n,) elevations that the poses were commanded to; None for `theta_deg`.

    Returns:
        None where the reading does not follow the stage, so that there is no calibrated elevation.
    """
    if not np.isfinite(error_deg).all():
        return None
    if line.scale is None:  # what a stage scatters by about one elevation is no range
        places = np.full(len(theta_deg), theta_deg.mean())
    else:
        places = places_deg(theta_deg, theta_deg if nominal_deg is None else nominal_deg)
    elevations = np.unique(places)
    of_each = [error_deg[places == place] for place in elevations]
    steps = None
    if line.errors is not None:
        at_places = [line.errors.elevation_deg[:, places == place].mean(axis=1) for place in elevations]
        steps = np.column_stack([line.errors.steps[:, :2], -np.array(at_places).T])
    worth = uncertainty(line, theta_deg, reference)
    of_error = uncertainty(line, theta_deg, reference, noise_deg or None)
    expanded = [u for u in (worth.expanded_deg, of_error.expanded_deg) if u is not None]
    return RangeErrors(
        bias_deg=line.bias_deg,
        scale=line.scale,
        covariance=line.covariance,
        freedom=len(theta_deg) - (1 if line.scale is None else 2) - line.effect_parameters,
        expanded_uncertainty_deg=worth.expanded_deg,
        error_expanded_uncertainty_deg=min(expanded, default=None),
        coverage_factor=worth.coverage_factor,
        coverage=worth.coverage,
        elevation_deg=tuple(round(place, DECIMALS) for place in elevations.tolist()),
        lowest_error_deg=tuple(round(float(errors.min()), DECIMALS) for errors in of_each),
        highest_error_deg=tuple(round(float(errors.max()), DECIMALS) for errors in of_each),
        mean_error_deg=float(np.mean([errors.mean() for errors in of_each])),
        error_steps=None if steps is None else frozen(steps.tolist()),
    )


def reference_figures(theta_deg: FloatArray, line: Line, reference: Reference) -> ReferenceFigures:
    """Return what the reference makes of a line fitted to poses at these elevations (n,)."""
    part = reference_part(theta_deg, line.scale, reference)
    return ReferenceFigures(
        std_deg=reference.std_deg,
        kind=reference.kind,
        bias_std_deg=part.bias_deg,
        scale_std=part.scale,
        distribution=reference.distribution,
        line_covariance=reference.line_covariance,
    )
