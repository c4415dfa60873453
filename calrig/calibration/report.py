"""Findings in words and numbers: CONTRACT section 5's `effects`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.effects.stage import grid_step_deg
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.responses import Responses
from calrig.calibration.search import Findings, Found, model_columns
from calrig.estimation.angles import FloatArray

SHORTEST_ALIAS_DEG = 1.0


def effect_documents(r: Responses, findings: Findings) -> list[dict[str, Any]]:
    """Each effect found, with parameters from a fit of all of them together."""
    whole = [_whole_form(r, f.candidate) for f in findings.found]
    columns = model_columns(r, whole)
    fitted = fit(r, columns)
    place = columns.shape[2] - sum(c.columns.shape[2] for c in whole)
    documents = []
    for one, candidate in zip(findings.found, whole, strict=True):
        width = candidate.columns.shape[2]
        documents.append(_document(r, one, candidate, fitted, slice(place, place + width)))
        place += width
    return documents


def model_words(findings: Findings) -> str:
    """The final model, such as `reading = bias + scale·θ + backlash`."""
    names = [
        f.candidate.label.replace("unnamed ", "f(") + (")" if f.candidate.effect is None else "")
        for f in findings.found
    ]
    return " + ".join(["reading = bias + scale·θ", *names])


def _whole_form(r: Responses, candidate: Candidate) -> Candidate:
    """The form with all of an effect's parameters, where one of its parts sufficed to find it."""
    if candidate.effect is None:
        return candidate
    for shape in candidate.effect.shapes(r):
        if shape.form == "both" and candidate.shape.form in shape.parameters:
            return Candidate(
                candidate.effect, candidate.covariate, shape, r.columns(shape.shares), candidate.family
            )
    return candidate


def _document(r: Responses, found: Found, candidate: Candidate, fitted: Fit, at: slice) -> dict[str, Any]:
    effect = candidate.effect
    beta, covariance = fitted.beta[at], fitted.covariance[at, at]
    return {
        "name": candidate.name,
        "verdict": found.verdict,
        "origin": "unknown" if effect is None else effect.origin,
        "covariate": candidate.covariate,
        "parameters": _parameters(candidate, beta, covariance),
        "p_value": found.p_value,
        "confusable_with": [rival.name for rival in found.rivals],
        "evidence": _evidence(r, found, candidate),
        "remedy": "look at what changes with this column" if effect is None else effect.remedy,
        "considered": [{"name": name, "behind": behind} for name, behind in found.considered],
        "accepted_at": None,
    }


def _parameters(candidate: Candidate, beta: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    shape = candidate.shape
    if candidate.effect is None:
        return _unnamed_parameters(candidate, beta, covariance)
    if shape.polar:
        document = _amplitude_and_phase(beta, covariance)
    else:
        document = {
            name: {"value": float(beta[k]), "std": math.sqrt(max(float(covariance[k, k]), 0.0))}
            for k, name in enumerate(shape.parameters)
        }
    for name, value in shape.at.items():
        if name != "pose":
            document[name] = {"value": float(value), "std": None}
    return document


def _amplitude_and_phase(beta: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    """A·sin(x + φ) of b₀·sin x + b₁·cos x, with errors by the law of propagation."""
    amplitude = float(np.hypot(*beta))
    along = beta / amplitude
    across = np.array([-along[1], along[0]])
    return {
        "amplitude_deg": {"value": amplitude, "std": math.sqrt(float(along @ covariance @ along))},
        "phase_deg": {
            "value": math.degrees(math.atan2(beta[1], beta[0])),
            "std": math.degrees(math.sqrt(float(across @ covariance @ across)) / amplitude),
        },
    }


def _unnamed_parameters(candidate: Candidate, beta: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    columns = candidate.columns[:, 0, :]
    fitted = columns @ beta
    high, low = int(np.argmax(fitted)), int(np.argmin(fitted))
    swing = columns[high] - columns[low]
    at = candidate.shape.at
    place = next((float(v) for k, v in at.items() if k not in ("period", "pose")), None)
    return {
        "size_deg": {
            "value": float(fitted[high] - fitted[low]),
            "std": math.sqrt(max(float(swing @ covariance @ swing), 0.0)),
        },
        "period": None if "period" not in at else {"value": float(at["period"]), "std": None},
        "at": None if place is None else {"value": place, "std": None},
    }


def _evidence(r: Responses, found: Found, candidate: Candidate) -> list[str]:
    said = [f"the whole search finds this much in noise alone with p = {found.p_value:.3g}"]
    witnesses = [c for k, c in enumerate(r.channels[1:], 1) if np.ptp(candidate.columns[:, k, :]) > 0.0]
    if witnesses:
        said.append(f"seen by {', '.join(witnesses)} as well as by the reading, as it must be")
    if candidate.shape.says:
        said.append(candidate.shape.says)
    if found.candidate.effect is not None and math.isfinite(found.lead):
        if found.rivals:
            names = ", ".join(rival.name for rival in found.rivals)
            said.append(f"these poses cannot tell it from {names}: {found.candidate.effect.apart}")
        else:
            said.append(
                f"the next best name is worse by {found.lead:.1f} in −2 log likelihood with penalties"
            )
    if candidate.effect is None:
        said.append(f"shape: {candidate.shape.form}; no effect of the catalogue explains it as well")
    period = candidate.shape.at.get("period_deg")
    if period is not None:
        said += _aliases(r, period)
    return said


def _aliases(r: Responses, period_deg: float) -> list[str]:
    step = grid_step_deg(r.theta_deg)
    if step is None:
        return []
    others = []
    for k in range(1, 6):
        for sign in (1.0, -1.0):
            frequency = abs(sign / period_deg + k / step)
            if 1.0 / frequency >= SHORTEST_ALIAS_DEG:
                others.append(1.0 / frequency)
    listed = ", ".join(f"{p:.2f}°" for p in sorted(set(others), reverse=True))
    return (
        [f"on this exact grid of {step:g}° periods of {listed} look the same: jitter the elevations"]
        if listed
        else []
    )
