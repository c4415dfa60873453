"""A certificate's results, from the calibration document and the poses that it rests on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from calrig.calibration.uncertainty import coverage_factor
from calrig.export.certificate.content import DIGITS, Budget, Quantity, Results
from calrig.export.certificate.measured import Measured, effects_found, stated_reference
from calrig.model.result import Reference
from calrig.store.issued import Revision
from calrig.store.records import AcceptedEffect, Document, Run

FIGURES = (
    ("rms_raw_deg", "RMS error as the unit reads"),
    ("rms_calibrated_deg", "RMS error with bias and scale"),
    ("rms_with_effects_deg", "RMS error with accepted effects"),
)


def results_of(
    document: Document,
    run: Run,
    measured: Measured,
    budget: Budget,
    freedom: int | None,
    of_stage: Sequence[AcceptedEffect],
    came_with: Revision | None,
) -> Results:
    """The results of a revision.

    Args:
        document: CONTRACT section 6.
        run: that it is of.
        measured: its poses.
        budget: of its uncertainty.
        freedom: degrees of freedom of the scatter about its line; None where they are not known.
        of_stage: effects of the rig's that it rests on.
        came_with: the revision that the unit came with; None where it is found as it reads.
    """
    reference = stated_reference(document)
    elevation = None
    if budget.expanded_deg is not None:
        elevation = Quantity(
            "expanded_uncertainty_deg",
            "Calibrated elevation",
            0.0,
            "°",
            budget.combined_deg,
            budget.expanded_deg,
            budget.coverage_factor,
            budget.coverage,
        )
    over = ", over all runs of the solution" if "elevation_std_deg" in document else ""
    by = "the unit as it reads, without any calibration"
    if came_with is not None:
        by = f"revision {came_with.revision} of {came_with.issued_at:%Y-%m-%d}, with which the unit came"
    return Results(
        elevation=elevation,
        line=tuple(_line(document, reference, freedom)),
        effects=effects_found(document["effects"], _stds_solved(document) or _stds(run)),
        of_stage=effects_found([asdict(one) for one in of_stage], _stds(run)),
        figures=tuple(
            Quantity(key, f"{title}{over}", document[key], "°", digits=DIGITS)
            for key, title in FIGURES
            if document[key] is not None
        ),
        found_by=by,
        points=measured.points(budget.expanded_deg),
        points_say=_points_say(document, of_stage, came_with is not None),
    )


def _points_say(document: Document, of_stage: Sequence[AcceptedEffect], earlier: bool) -> tuple[str, ...]:
    said = ["Errors are the elevation that the unit gives less that of the stage: mean, lowest and highest."]
    if "elevation_std_deg" in document:
        said.append(
            "They are of one run of the joint solution, the stage put right by the map solved for beside."
        )
    if of_stage:
        said.append("The stage's own accepted errors are taken out of both where the poses allow it.")
    if earlier and not document["level_known"]:
        said.append(
            "The unit was clamped anew since: what is common to all errors as found may be the clamping's."
        )
    return tuple(said)


def _line(document: Document, reference: Reference | None, freedom: int | None) -> list[Quantity]:
    """Bias and scale with their expanded uncertainties, type A and the stage's part together.

    A joint solution has the unit in its effects: its scale is 1, and its bias the level, where that is known.
    """
    if "elevation_std_deg" in document:
        level = Quantity("bias_deg", "Bias", document["bias_deg"], "°", std=document["level_std_deg"])
        return [level] if document["level_known"] else []
    worth, covariance, coverage = document["uncertainty"], document["covariance"], document["coverage"]
    bias = "Bias" if document["level_known"] else "Bias, as clamped (the level is not known)"
    figures = (("bias_deg", bias, "°", "reference_bias_deg"), ("scale", "Scale", "", "reference_scale"))
    found = []
    for k, (key, title, unit, part) in enumerate(figures):
        if covariance is None or worth.get(part) is None or reference is None or not freedom or freedom < 1:
            own = None if covariance is None else math.sqrt(covariance[k][k])
            found.append(Quantity(key, title, document[key], unit, std=own))
            continue
        own, of_stage = math.sqrt(covariance[k][k]), worth[part]
        distribution = "normal" if reference.kind == "setting" else reference.distribution
        factor, std = coverage_factor(own, freedom, of_stage, distribution), math.hypot(own, of_stage)
        found.append(Quantity(key, title, document[key], unit, std, factor * std, factor, coverage))
    return found


def _stds_solved(document: Document) -> dict[tuple[str, str], float]:
    """Standard errors of a joint solution's parameters, as its document has them."""
    solved = document["provenance"].get("solution") or {"std": {}}
    return {
        (effect["name"], name): solved["std"][name]
        for effect in document["effects"]
        for name in effect["parameters"]
        if solved["std"].get(name) is not None
    }


def _stds(run: Run) -> dict[tuple[str, str], float]:
    """Standard errors of effects' parameters, of those that the run's own diagnosis found."""
    return {
        (effect["name"], name): given["std"]
        for effect in (run.diagnosis or {}).get("effects", ())
        if effect.get("accepted_at") is not None
        for name, given in effect["parameters"].items()
        if isinstance(given, Mapping) and given.get("std") is not None
    }
