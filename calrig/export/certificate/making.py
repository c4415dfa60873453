"""The content of a certificate, made from what the store has of a revision; pure."""

import hashlib
import json
import math
from calendar import monthrange
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date, datetime
from typing import Any

import calrig
from calrig.calibration.poses import of_first_mount
from calrig.calibration.uncertainty import IN_WORDS, coverage_factor
from calrig.export.certificate import wording
from calrig.export.certificate.budget import budget_of
from calrig.export.certificate.content import (
    DIGITS,
    Budget,
    Certificate,
    Conditions,
    Conformity,
    Dates,
    Issue,
    Laboratory,
    Method,
    Quantity,
    Replaced,
    Results,
    TrailMark,
)
from calrig.export.certificate.content import CalibrationItem as ItemSaid
from calrig.export.certificate.measured import (
    Measured,
    effects_found,
    equipment_of,
    standards_of,
    stated_reference,
    traceable,
)
from calrig.laboratory import LaboratorySettings
from calrig.model.result import Reference
from calrig.model.verdict import Limit
from calrig.store.issued import Revision
from calrig.store.records import AcceptedEffect, Document, Run, StoredPose
from calrig.store.trail import Entry
from calrig.store.units import CalibrationItem

FIGURES = (
    ("rms_raw_deg", "RMS error as the unit reads"),
    ("rms_calibrated_deg", "RMS error with the plain fit of bias and scale"),
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

    `freedom`, of the scatter about its line, is None where it is not known; `came_with`, the revision that
    the unit came with, where it is found as it reads.
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
    if not document["level_known"]:
        said.append("Those as left are less their mean over the range: the level is not known.")
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
        factor = coverage_factor(own, freedom, of_stage, reference.combined_distribution)
        std = math.hypot(own, of_stage)
        found.append(Quantity(key, title, document[key], unit, std, factor * std, factor, coverage))
    return found


def _stds_solved(document: Document) -> dict[tuple[str, str, float], float]:
    """Standard errors of a joint solution's parameters, as its document has them."""
    solved = document["provenance"].get("solution") or {"std": {}}
    return {
        (effect["name"], name, value): solved["std"][name]
        for effect in document["effects"]
        for name, value in effect["parameters"].items()
        if solved["std"].get(name) is not None
    }


def _stds(run: Run) -> dict[tuple[str, str, float], float]:
    """Standard errors of effects' parameters, of those that the run's own diagnosis found."""
    return {
        (effect["name"], name, given["value"]): given["std"]
        for effect in (run.diagnosis or {}).get("effects", ())
        if effect.get("accepted_at") is not None
        for name, given in effect["parameters"].items()
        if isinstance(given, Mapping) and given.get("std") is not None
    }


SUPPLIED = {
    "customer": "customer",
    "address": "address",
    "order": "order number",
    "received_at": "date of receipt",
    "condition": "condition",
    "description": "description",
    "interval_agreed_months": "interval",
}
"""Fields of an item, and what they are called where the customer supplied them."""


@dataclass(frozen=True, slots=True)
class Sources:
    """All that a certificate is made of.

    Attributes:
        poses: of the run, excluded ones too.
        before: the revision in force until this one was; None where there was none.
        came_with: the last one before of another run, with which the unit came in; None if there was none.
        of_stage: effects of the rig's that this revision rests on.
        limit: that the verdict names, as it was when the revision was made; None if unknown.
        entries: of the audit trail, about this revision, oldest first.
        item: the unit as received; None if not stated.
        gone: what it rests on that counts no more, such as a run that was voided; a sentence each.
    """

    revision: Revision
    run: Run
    poses: Sequence[StoredPose]
    laboratory: LaboratorySettings
    before: Revision | None = None
    came_with: Revision | None = None
    of_stage: Sequence[AcceptedEffect] = ()
    limit: Limit | None = None
    entries: Sequence[Entry] = ()
    item: CalibrationItem | None = None
    gone: Sequence[str] = ()


def certificate_of(sources: Sources, issue: Issue | None = None) -> Certificate:
    """The content of a revision's certificate: the same sources always give the same one.

    `issue` is how it is issued; None for a preview.
    """
    revision, run = sources.revision, sources.run
    document, provenance = revision.document, revision.document["provenance"]
    out = set(revision.basis["excluded"])
    kept = [one.pose for one in sources.poses if one.index not in out]
    counted = of_first_mount(kept)
    freedom = document.get("degrees_of_freedom")
    if "degrees_of_freedom" not in document:  # of before: a joint solution's scatter is of all units together
        of_line = len(counted) - 2 if counted else None
        freedom = provenance.get("degrees_of_freedom", of_line)
    reference = stated_reference(document)
    came_with = None if sources.came_with is None else sources.came_with.document
    measured = Measured(counted, document, came_with, sources.of_stage)
    budget = budget_of(document, reference, freedom)
    released = next((one for one in reversed(sources.entries) if one.what == "released"), None)
    last = sources.entries[-1] if sources.entries else None
    mark = None if last is None else TrailMark(last.seq, last.at, last.what, last.who, last.sha256)
    made = Certificate(
        number="",
        issue=issue,
        kind="demonstration" if provenance.get("simulated") else "certificate",
        revision=revision.revision,
        status=revision.status,
        document_sha256=revision.sha256,
        laboratory=Laboratory(**sources.laboratory.as_stated()),
        item=_item(revision.unit, provenance, sources.item),
        dates=_dates(sources, released, issue),
        method=Method(
            program=f"calrig {provenance.get('calrig') or 'of a version not known'}",
            measurand=wording.measurand(document),
            model=document["model"],
            procedure=wording.procedure(run.plan, document, len(counted)),
            plan=wording.plan_rows(run.plan),
            literature=(wording.PAPER, *wording.GUIDES),
        ),
        conditions=_conditions(document),
        results=results_of(document, run, measured, budget, freedom, sources.of_stage, sources.came_with),
        residuals=measured.residuals(),
        budget=budget,
        standards=standards_of(document, run.started_at),
        traceable=traceable(document),
        equipment=equipment_of(provenance),
        conformity=_conformity(revision, sources.limit),
        judged=tuple(revision.verdict["says"]),
        authorised_by=_authorised(sources.laboratory, revision, released),
        in_force_by=_in_force(revision, released),
        replaces=_replaced(revision, sources.before),
        gone=tuple(sources.gone),
        deviations=wording.deviations(
            plan=run.plan,
            provenance=provenance,
            faults=run.faults,
            excluded=[one for one in sources.poses if one.index in out],
            at_other_mounts=len(kept) - len(counted),
        ),
        software=wording.software(calrig.__version__),
        trail=mark,
        statements=wording.STATEMENTS,
        document=wording.flattened(document),
    )
    return replace(made, number=_number(made))


def _number(certificate: Certificate) -> str:
    """The revision, and a hash of everything that is said: other words, another number."""
    text = json.dumps(asdict(certificate), sort_keys=True, ensure_ascii=False, default=str)
    number = f"{certificate.revision:04d}-{hashlib.sha256(text.encode()).hexdigest()[:12].upper()}"
    return number if certificate.issue is not None else f"PREVIEW-{number}"


def _item(serial: str, provenance: Document, item: CalibrationItem | None) -> ItemSaid:
    said, board = item or CalibrationItem(), provenance.get("board") or {}
    return ItemSaid(
        serial=serial,
        chip=board.get("chip"),
        firmware=board.get("firmware"),
        description=said.description,
        condition=said.condition,
        customer=said.customer,
        address=said.address,
        order=said.order,
        received_on=said.received_at,
        interval_months=said.interval_agreed_months,
        supplied=tuple(SUPPLIED[name] for name in SUPPLIED if name in said.supplied),
    )


def _dates(sources: Sources, released: Entry | None, issue: Issue | None) -> Dates:
    run, months = sources.run, None if sources.item is None else sources.item.interval_agreed_months
    began, ended = run.started_at, run.finished_at
    if (solved := sources.revision.document["provenance"].get("solution")) is not None:
        times = (solved[key] for key in ("began_at", "ended_at"))
        began, ended = (None if text is None else datetime.fromisoformat(text) for text in times)
    again = None if months is None or ended is None else months_after(ended.date(), months)
    if run.plan is None:
        began = ended = None
    return Dates(
        calibration_began=began,
        calibration_ended=ended,
        measured_by=ended or (run.created_at if run.plan is None else sources.revision.issued_at),
        revision_made=sources.revision.issued_at,
        released=None if released is None else released.at,
        issued=sources.revision.issued_at if issue is None else issue.at,
        calibrate_again=again,
    )


def months_after(day: date, months: int) -> date:
    """The same day so many months later, or the last one of a shorter month."""
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, monthrange(year, month + 1)[1]))


def _conditions(document: Document) -> Conditions:
    low, high = document["range_deg"]
    temperature = document["temperature_c"] or {}
    return Conditions(
        range_deg=(low, high),
        temperature_min_c=temperature.get("min"),
        temperature_max_c=temperature.get("max"),
        level_known=document["level_known"],
        level_std_deg=document["level_std_deg"],
        other=(),
    )


def _conformity(revision: Revision, limit: Limit | None) -> Conformity | None:
    judged: Mapping[str, Any] = revision.verdict
    if judged["answer"] == "no_limits":
        return None
    return Conformity(
        answer=judged["answer"],
        answer_in_words=IN_WORDS[judged["answer"]],
        limit_name=judged["limit"],
        limit=limit,
        rule="not stated" if limit is None else limit.rule_in_words,
        asks=wording.asks(limit),
        says=tuple(judged["says"]),
        probability_of_conformity=judged.get("probability_of_conformity"),
        probability_of_false_accept=judged.get("probability_of_false_accept"),
    )


def _authorised(laboratory: LaboratorySettings, revision: Revision, released: Entry | None) -> str | None:
    if laboratory.authorised_by is not None or released is None or released.at == revision.issued_at:
        return laboratory.authorised_by
    return released.who


def _releaser(revision: Revision, released: Entry) -> str | None:
    """Who put it in force; what came into force as it was made did so by its rig's `release`."""
    if released.at != revision.issued_at:
        return released.who
    is_imported = "imported_from" in revision.document["provenance"]
    return f"the release rule {'for imports' if is_imported else 'of its rig'}"


def _in_force(revision: Revision, released: Entry | None) -> str:
    if revision.status == "draft":
        return "This revision is a draft: nobody has put it in force."
    if revision.status == "withdrawn":
        return "This revision has been withdrawn and is not to be used."
    said = "The calibration was put in force"
    if released is not None:
        said += f" on {released.at:%Y-%m-%d}"
        by = _releaser(revision, released)
        said += "" if by is None else f" by {by}"
    return f"{said}; it has been superseded since." if revision.status == "superseded" else f"{said}."


def _replaced(revision: Revision, before: Revision | None) -> Replaced | None:
    if before is None:
        return None
    is_same_run = before.run_id == revision.run_id
    return Replaced(before.revision, before.sha256, before.issued_at, is_same_run, revision.reason)
