"""Findings in words and numbers: CONTRACT section 5's `effects`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calrig.calibration.candidates import Candidate, rebuilt
from calrig.calibration.effects import UNNAMED
from calrig.calibration.model import model_columns, own_columns
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.ranking import MARGIN, Found
from calrig.calibration.responses import CHANNELS, Responses
from calrig.calibration.run_changes import in_words
from calrig.calibration.search import Findings

FAR_WORSE = 40.0
"""So far behind in −2 log likelihood that odds would suggest more precision than there is."""


def effect_documents(r: Responses, findings: Findings) -> list[dict[str, Any]]:
    """Each effect found, with parameters from a fit of all of them together."""
    whole = [_whole_form(r, f.candidate) for f in findings.found]
    columns = model_columns(r, whole)
    fitted = fit(r, columns)
    own = own_columns(columns, whole)
    return [
        {**_document(r, one, candidate, fitted, at), "least_p_value": findings.least_p_value}
        for one, candidate, at in zip(findings.found, whole, own, strict=True)
    ]


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
    if behind > FAR_WORSE:
        return "explains these poses far worse"
    return f"explains these poses worse: odds about 1 : {math.exp(behind / 2.0):,.0f}"


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
    if candidate.named and math.isfinite(found.lead):
        if found.rivals:
            names = ", ".join(rival.name for rival in found.rivals)
            said.append(f"indistinguishable from {names} by these poses: {found.candidate.effect.apart}")
        else:
            said.append(
                f"the next best name is worse by {found.lead:.1f} in −2 log likelihood with penalties"
            )
    return [*said, *candidate.effect.evidence(r, candidate.shape)]
