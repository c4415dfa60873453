"""Partial residuals: what is left of the readings for one effect once everything else is taken out.

With reading − θ = base + Σ effects + e, the partial residual of effect k is its own fitted part plus e
(Larsen & McCleary, Technometrics 14, 1972): drawn against its covariate, with the fitted part through it, it
shows how good a description that effect is, and where it is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.candidates import Candidate, documented_forms
from calrig.calibration.correction import numbers_of
from calrig.calibration.effects import EFFECTS, covariate_of
from calrig.calibration.outliers import most_outliers, outlier
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.responses import Change, Responses, responses_of
from calrig.calibration.sensor_model import fitted_model, parts_deg
from calrig.estimation.angles import FloatArray

Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class PartialResidual:
    """The partial residual of one effect of a diagnosis, in the order measured.

    Attributes:
        covariate: what it was traced to (CONTRACT section 5).
        at: (n,) the covariate, in its own unit.
        theta_deg: (n,) elevation.
        residual_deg: (n,) reading less bias, scale and all other effects, degrees.
        effect_deg: (n,) what the effect adds to the reading, degrees.
    """

    covariate: str
    at: FloatArray
    theta_deg: FloatArray
    residual_deg: FloatArray
    effect_deg: FloatArray


def partial_residuals(
    runs: Sequence[Sequence[Pose]], effects: Sequence[Document], run_ids: Sequence[str] | None = None
) -> list[PartialResidual]:
    """The partial residual of each effect of a diagnosis, from one fit of all of them together.

    Args:
        runs: the poses that were diagnosed, as `diagnose` took them.
        effects: the `effects` of the document; what was scanned for is taken from it, not searched again.
        run_ids: of the runs, as the document has them where something changed between two.

    Raises:
        DiagnosisError: the poses cannot show an effect (any more).
    """
    r = responses_of(runs, run_ids)
    chosen = _chosen(r, [_forms(r, effect) for effect in effects])
    for _ in range(most_outliers(len(r))):
        model = fitted_model(r, chosen)
        if (apart := outlier(model.responses, model.accepted)) is not None:
            others = np.delete(np.arange(len(r)), apart)
            r, chosen = r.rows(others), [c.rows(others) for c in chosen]
    fitted = fitted_model(r, chosen).fitted
    partial = []
    for candidate, own in zip(chosen, parts_deg(r, chosen, fitted.beta), strict=True):
        at = _column(r, candidate.covariate)
        residual_deg = fitted.residuals[:, 0] + own
        partial.append(PartialResidual(candidate.covariate, at, r.theta_deg, residual_deg, own))
    return partial


def _chosen(r: Responses, forms: Sequence[Sequence[Candidate]]) -> list[Candidate]:
    """Of each effect the form with the best likelihood, penalised as the search does, beside the others."""
    chosen = [options[0] for options in forms]
    bic_penalty = math.log(len(r))
    for k, options in enumerate(forms):
        if len(options) > 1:
            criteria = [
                fitted_model(r, [*chosen[:k], option, *chosen[k + 1 :]]).fitted.criterion
                + bic_penalty * option.parameters
                for option in options
            ]
            chosen[k] = options[int(np.argmin(criteria))]
    return chosen


def _forms(r: Responses, document: Document) -> list[Candidate]:
    name, covariate = document["name"], document["covariate"]
    known = name in EFFECTS
    numbers = numbers_of(document["parameters"])
    forms = documented_forms(r, name, covariate, numbers, _change(r, document)) if known else []
    if not forms:
        raise DiagnosisError(f"these poses cannot show {name} against {covariate}: diagnose them again")
    return forms


def _change(r: Responses, document: Document) -> Change | None:
    """Between which of these runs an effect changed; DiagnosisError where they are others."""
    changed = document.get("changed")
    if changed is None:
        return None
    if changed["to"] not in r.run_ids:
        raise DiagnosisError(f"run {changed['to']}, in which {document['name']} changed, has no poses left")
    return Change(r.run_ids.index(changed["to"]), changed["from"], changed["to"])


def _column(r: Responses, covariate: str) -> FloatArray:
    column = covariate_of(covariate).of(r)
    if column is None:
        raise DiagnosisError(f"these poses have no {covariate}: diagnose them again")
    return column
