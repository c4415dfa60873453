"""Partial residuals: what is left of the readings for one effect once everything else is taken out.

With reading − θ = base + Σ effects + e, the partial residual of effect k is its own fitted part plus e
(Larsen & McCleary, Technometrics 14, 1972): drawn against its covariate, with the fitted part through it, it
shows how good a description that effect is, and where it is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.effects import CATALOGUE, Effect, Shape
from calrig.calibration.effects.stage import periodic_shape
from calrig.calibration.noise_model import fit
from calrig.calibration.outliers import without_outliers
from calrig.calibration.pose import Pose
from calrig.calibration.responses import DiagnosisError, Responses, responses_of
from calrig.calibration.search import model_columns
from calrig.calibration.shapes import UNNAMED, unnamed_shapes
from calrig.estimation.angles import FloatArray

NOT_A_PLACE = ("period", "pose")
Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Traced:
    """One effect of a diagnosis in its poses, in the order measured.

    Attributes:
        covariate: what it was traced to (CONTRACT section 5).
        at: (n,) the covariate, in its own unit.
        theta_deg: (n,) elevation.
        left_deg: (n,) reading less bias, scale and all other effects, degrees.
        effect_deg: (n,) what the effect adds to the reading, degrees.
    """

    covariate: str
    at: FloatArray
    theta_deg: FloatArray
    left_deg: FloatArray
    effect_deg: FloatArray


def partial_residuals(runs: Sequence[Sequence[Pose]], effects: Sequence[Document]) -> list[Traced]:
    """The partial residual of each effect of a diagnosis, from one fit of all of them together.

    Args:
        runs: the poses that were diagnosed, as `diagnose` took them.
        effects: the `effects` of the document; what was scanned for is taken from it, not searched again.

    Raises:
        DiagnosisError: the poses cannot show an effect (any more).
    """
    r = responses_of(without_outliers(runs)[0])
    chosen = _chosen(r, [_forms(r, effect) for effect in effects])
    columns = model_columns(r, chosen)
    fitted = fit(r, columns)
    place = columns.shape[2] - sum(c.columns.shape[2] for c in chosen)
    traced = []
    for candidate in chosen:
        width = candidate.columns.shape[2]
        own = candidate.columns[:, 0, :] @ fitted.beta[place : place + width]
        at = _column(r, candidate.covariate)
        traced.append(Traced(candidate.covariate, at, r.theta_deg, fitted.residuals[:, 0] + own, own))
        place += width
    return traced


def _chosen(r: Responses, forms: Sequence[Sequence[Candidate]]) -> list[Candidate]:
    """Of each effect the form with the best likelihood, penalised as the search does, beside the others."""
    chosen = [options[0] for options in forms]
    bic_penalty = math.log(len(r))
    for k, options in enumerate(forms):
        if len(options) > 1:
            criteria = [
                fit(r, model_columns(r, [*chosen[:k], option, *chosen[k + 1 :]])).criterion
                + bic_penalty * option.parameters
                for option in options
            ]
            chosen[k] = options[int(np.argmin(criteria))]
    return chosen


def _forms(r: Responses, document: Document) -> list[Candidate]:
    """The forms an effect of the document may have had: those with its parameters, at its places."""
    name, covariate, parameters = document["name"], document["covariate"], document["parameters"]
    effect = next((e for e in CATALOGUE if e.name == name), None)
    if effect is not None:
        shapes = _catalogued(r, effect, parameters)
    else:
        shapes = _flexible(r, covariate, parameters) if name == UNNAMED else []
    if not shapes:
        raise DiagnosisError(f"these poses cannot show {name} against {covariate}: diagnose them again")
    return [Candidate(effect, covariate, shape, r.columns(shape.shares), name) for shape in shapes]


def _catalogued(r: Responses, effect: Effect, parameters: Document) -> list[Shape]:
    if "period_deg" in parameters:
        return [periodic_shape(r, parameters["period_deg"]["value"])]
    shapes = [
        shape
        for shape in effect.shapes(r)
        if {*shape.parameters, *shape.at} - set(NOT_A_PLACE) <= set(parameters)
    ]
    widest = max(map(_width, shapes), default=0)
    wanted = {name: given["value"] for name, given in parameters.items() if given is not None}
    return _nearest([shape for shape in shapes if _width(shape) == widest], wanted)


def _width(shape: Shape) -> int:
    """How many parameters a form has in a document."""
    return len({*shape.parameters, *shape.at} - set(NOT_A_PLACE))


def _flexible(r: Responses, covariate: str, parameters: Document) -> list[Shape]:
    """Shapes without a name against the covariate: cycles, places, or smooth ones, as the document says."""
    period, place = (given and given["value"] for given in (parameters["period"], parameters["at"]))
    shapes = [
        shape
        for against, shape in unnamed_shapes(r)
        if against == covariate
        and ("period" in shape.at) == (period is not None)
        and any(_places(shape)) == (place is not None)
    ]
    return _nearest(shapes, {"period": period, covariate: place})


def _places(shape: Shape) -> Iterator[str]:
    return (name for name in shape.at if name not in NOT_A_PLACE)


def _nearest(shapes: Sequence[Shape], wanted: Mapping[str, float | None]) -> list[Shape]:
    """Those whose scanned parameters lie nearest to the wanted ones."""

    def distance(shape: Shape) -> float:
        given = [(value, wanted.get(name)) for name, value in shape.at.items() if name != "pose"]
        return math.fsum(abs(value - aim) for value, aim in given if aim is not None)

    least = min(map(distance, shapes), default=0.0)
    return [shape for shape in shapes if distance(shape) <= least + 1e-9]


def _column(r: Responses, covariate: str) -> FloatArray:
    known = {
        "target_deg": r.theta_deg,
        "approach": r.approach,
        "temperature_c": r.temperature_c,
        "time_s": r.time_s,
        "move_deg": r.move_deg,
        "velocity": r.covariates.get("velocity_dps"),
    }
    column = known.get(covariate, r.covariates.get(covariate))
    if column is None:
        raise DiagnosisError(f"these poses have no {covariate}: diagnose them again")
    return column
