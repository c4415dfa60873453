"""Findings in words and numbers: CONTRACT section 5's `effects`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calrig.calibration.candidates import Candidate, rebuilt
from calrig.calibration.channels import CHANNELS
from calrig.calibration.effects import UNNAMED
from calrig.calibration.model import own_columns
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.places import slope
from calrig.calibration.ranking import FAR_BEHIND, MARGIN, Found
from calrig.calibration.responses import Responses
from calrig.calibration.run_changes import in_words
from calrig.calibration.search import Findings
from calrig.calibration.sensor_model import Model, fitted_model
from calrig.calibration.standard_errors import covariance_of
from calrig.estimation.angles import FloatArray


def effect_documents(r: Responses, findings: Findings) -> list[dict[str, Any]]:
    """Each effect found, with parameters from a fit of all of them together."""
    whole = [_whole_form(r, f.candidate) for f in findings.found]
    model = fitted_model(r, whole)
    own = own_columns(model.columns, whole)
    fitted = replace(model.fitted, covariance=_covariance(model, own))
    return [
        {**_document(r, one, candidate, fitted, at), "least_p_value": findings.least_p_value}
        for one, candidate, at in zip(findings.found, whole, own, strict=True)
    ]


def _covariance(model: Model, own: Sequence[slice]) -> FloatArray:
    """That of the coefficients, with what the places add that were refined and may lie a little elsewhere."""
    slopes = [
        slope(model.responses, candidate, model.fitted.beta[at])
        for candidate, at in zip(model.accepted, own, strict=True)
        if candidate.effect.place in candidate.shape.at_std
    ]
    r, columns, fitted = model.responses, model.columns, model.fitted
    if slopes:
        columns = np.concatenate([columns, *slopes], axis=2)
        fitted = fit(r, columns)
    return covariance_of(r, columns, fitted)


def model_words(findings: Findings) -> str:
    """The final model, such as `reading = bias + scale·θ + backlash`."""
    names = [
        f.candidate.label.replace("unnamed ", "f(") + ("" if f.candidate.named else ")")
        for f in findings.found
    ]
    return " + ".join(["reading = bias + scale·θ", *names])


def _whole_form(r: Responses, candidate: Candidate) -> Candidate:
    """The form with all of an effect's parameters, where one of its parts sufficed to find it."""
    whole = candidate.shape.part_of and rebuilt(candidate, r, candidate.shape.part_of)
    return whole or candidate


def _document(r: Responses, found: Found, candidate: Candidate, fitted: Fit, at: slice) -> dict[str, Any]:
    effect = candidate.effect
    beta, covariance = fitted.beta[at], fitted.covariance[at, at]
    return {
        "name": candidate.name,
        "verdict": found.verdict,
        "origin": effect.origin,
        "covariate": candidate.covariate,
        "parameters": effect.documented(candidate.shape, beta, covariance),
        "p_value": found.p_value,
        "changed": candidate.changed and {"from": candidate.changed.before, "to": candidate.changed.after},
        "confusable_with": list(dict.fromkeys(rival.name for rival in found.rivals)),
        "evidence": _evidence(r, found, candidate),
        "remedy": effect.remedy,
        "considered": [
            {"name": label, "behind": behind, "why": _why(found, label, behind)}
            for label, behind in found.considered
        ],
        "accepted_at": None,
    }


def _why(found: Found, label: str, behind: float) -> str:
    """Why a candidate was chosen, or lost."""
    if label == found.candidate.label:
        return "the best, not claimed" if found.rivals else "explains these poses best"
    if label in {rival.label for rival in found.rivals}:
        return "indistinguishable from it by these poses"
    if behind < MARGIN and label.startswith(UNNAMED):
        return "fits as well, but a cause with a name goes first"
    if behind > FAR_BEHIND:
        return "explains these poses far worse"
    return f"explains these poses worse: odds about 1 : {math.exp(behind / 2.0):,.0f}"


def _same_elsewhere(found: Found, candidate: Candidate) -> list[str]:
    """The same effect at other places that these poses cannot tell from its own."""
    place = candidate.effect.place
    values = sorted((other.shape.at[place] for other in found.alike), reverse=True)
    if not values:
        return []
    parameter = next(p for p in candidate.effect.parameters if p.name == place)
    listed = ", ".join(f"{value:.4g}{parameter.unit}" for value in values)
    own = f"{candidate.shape.at[place]:.4g}{parameter.unit}"
    return [f"a {parameter.title.lower()} of {listed} would look the same as {own} at these poses"]


def _evidence(r: Responses, found: Found, candidate: Candidate) -> list[str]:
    said = [f"family-wise p-value {found.p_value:.3g}: the chance of so strong an effect in noise alone"]
    witnesses = [
        CHANNELS[c] for k, c in enumerate(r.channels) if k and np.ptp(candidate.columns[:, k, :]) > 0.0
    ]
    if witnesses:
        said.append(f"seen by {', '.join(witnesses)} as well as by the reading, as it must be")
    if candidate.changed is not None:
        said.append(f"changed{in_words(candidate.changed)}: the values are the later less the earlier ones")
    if candidate.shape.says:
        said.append(candidate.shape.says)
    said += _same_elsewhere(found, candidate)
    if candidate.named and math.isfinite(found.lead):
        if found.rivals:
            names = ", ".join(dict.fromkeys(rival.name for rival in found.rivals))
            said.append(f"indistinguishable from {names} by these poses: {found.candidate.effect.apart}")
        else:
            said.append(f"ΔBIC of the next best candidate: {found.lead:.1f}")
    return [*said, *found.doubts, *candidate.effect.evidence(r, candidate.shape)]
