"""The effects accepted from several runs of a unit, as one model fitted over the poses of these runs."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from calrig.analysis.errors import Conflict
from calrig.analysis.results import rest_on_map
from calrig.analysis.stored_runs import counted_poses
from calrig.analysis.unit_of_work import Fits
from calrig.calibration.diagnosis import (
    MOST_POSES,
    Growth,
    JointEffects,
    RunOfEffects,
    fit_together,
    held_out_growth,
)
from calrig.calibration.poses import DiagnosisError
from calrig.calibration.results import AppliedEffect, own_effect
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.records import as_applied

REFERENCE = "reference_c"


def joint_of_accepting(
    store: Store, unit: str, added: Sequence[AcceptedEffect], fits: Fits, others: Sequence[str] = ()
) -> tuple[list[AcceptedEffect], list[AcceptedEffect]]:
    """Return the effects with the covariance of their parameters, and the model of the unit with them.

    The model is empty where one run has all effects: the values of its diagnosis stand.

    Args:
        store: with what was accepted before.
        unit: serial number.
        added: the effects accepted now.
        fits: where the fit is made.
        others: names that may be accepted besides, for the message of a refusal.

    Raises:
        Conflict: the effects cannot be fitted together, or predict a run worse than what is in force.
    """
    before = store.effects.acceptances(unit)
    own = [one for one in added if one.unit is not None]
    if not own:
        return [*added], []
    together = _replaced(before, own)
    earlier, runs = _runs(store, before), _runs(store, together)
    in_force = [one for one in store.effects.in_force(unit, None) if one.unit is not None]
    ordered = [*earlier, *(run for run in runs if run.id not in {one.id for one in earlier})]
    effects = _effects(together)
    asked = [_run_of(store, run, [*together, *added]) for run in ordered]
    is_needed = _is_needed(store, together)
    try:
        found, growths = fits(partial(_fitted, asked, effects, as_applied(in_force), len(earlier)))
    except DiagnosisError as error:
        if not is_needed:  # too few poses count since the diagnosis, whose values stand
            return [*added], []
        raise Conflict(f"the effects cannot be fitted together with those in force: {error}") from error
    for one in growths:
        if one.is_too_large:
            other_runs = [run.id for run in ordered if run.id != one.run_id]
            raise Conflict(_too_large(one, other_runs, others))
    if is_needed:
        return [*added], _accepted(together, runs, found)
    if len(found.factors) != len(together):  # two are one
        return [*added], []
    factors = {id(one): factor for one, factor in zip(together, found.factors, strict=True)}
    return [replace(one, factor=factors.get(id(one), one.factor)) for one in added], []


def _replaced(before: Sequence[AcceptedEffect], added: Sequence[AcceptedEffect]) -> list[AcceptedEffect]:
    """Return all acceptances; of each run a name's latest, in the place of its first."""
    of_name: dict[tuple[str, str], list[AcceptedEffect]] = {}
    for those in (before, added):
        for key in {(one.run_id, one.name): None for one in those}:
            of_name[key] = [one for one in those if (one.run_id, one.name) == key]
    return [one for those in of_name.values() for one in those]


def _too_large(growth: Growth, other_runs: Sequence[str], others: Sequence[str]) -> str:
    said = (
        f"accepting would make run {growth.run_id} worse: its error on held-out poses would grow from "
        f"{growth.before_deg:.3g}° to {growth.after_deg:.3g}°"
    )
    if others:
        return f"{said}. Accept it together with {', '.join(others)}, if they cancel each other in part"
    if not other_runs:
        return f"{said}. Its poses do not determine the effects: measure more poses, and diagnose again"
    return (
        f"{said} with one model of it and run {', '.join(other_runs)}. The unit has changed between the "
        "runs, or an effect is not what it seems: revoke what was accepted from the earlier run, or void the "
        "run that is wrong"
    )


def _fitted(
    runs: Sequence[RunOfEffects],
    effects: Sequence[AppliedEffect],
    before: Sequence[AppliedEffect],
    n_before: int,
) -> tuple[JointEffects, list[Growth]]:
    """The model, and what it makes of each run's error on held-out poses."""
    return fit_together(runs, effects), held_out_growth(runs, before, n_before, effects)


def joint_of_rest(store: Store, acceptances: Sequence[AcceptedEffect], fits: Fits) -> list[AcceptedEffect]:
    """Return the model of acceptances that remain after others were revoked or their run was voided.

    It is empty where one run has them all.

    Raises:
        Conflict: they cannot be fitted together. The values of several diagnoses would count twice what they
            have in common.
    """
    if not _is_needed(store, acceptances):
        return []
    runs, effects = _runs(store, acceptances), _effects(acceptances)
    asked = [_run_of(store, run, acceptances) for run in runs]
    try:
        found = fits(partial(fit_together, asked, effects))
    except DiagnosisError as error:
        listed = ", ".join(f"{one.name} of run {one.run_id}" for one in acceptances)
        raise Conflict(
            f"the effects that would stay accepted cannot be fitted together ({listed}): {error}. Nothing "
            f"was changed: revoke first what was accepted from run {acceptances[-1].run_id}"
        ) from error
    return _accepted(acceptances, runs, found)


def _is_needed(store: Store, acceptances: Sequence[AcceptedEffect]) -> bool:
    """Whether the values of the diagnoses do not serve.

    They are of several runs, of one that is void now, or of poses from which effects had been taken out.
    """
    if len({one.run_id for one in acceptances}) > 1 or any(one.is_partial for one in acceptances):
        return True
    ids = {run_id for one in acceptances for run_id in one.rests_on}
    return any(run.voided is not None for run_id in ids if (run := store.runs.get(run_id)) is not None)


def is_model_of(store: Store, joint: Sequence[AcceptedEffect], acceptances: Sequence[AcceptedEffect]) -> bool:
    """Whether a joint model has the effects of these acceptances, over all of their runs that are valid."""
    ids = {run.id for run in _valid_runs(store, acceptances)}
    return {one.name for one in joint} == {one.name for one in acceptances} and all(
        set(one.runs) == ids for one in joint
    )


def _valid_runs(store: Store, acceptances: Sequence[AcceptedEffect]) -> list[Run]:
    ids = dict.fromkeys(run_id for one in acceptances for run_id in one.rests_on)
    stored = [run for run_id in ids if (run := store.runs.get(run_id)) is not None]
    return [run for run in stored if run.voided is None]


def _runs(store: Store, acceptances: Sequence[AcceptedEffect]) -> list[Run]:
    """The runs that acceptances rest on and that are not voided, in the order measured."""
    runs = _valid_runs(store, acceptances)
    if (n := sum(store.poses.count(run.id) for run in runs)) > MOST_POSES:
        raise Conflict(
            f"effects are fitted together over at most {MOST_POSES:,} poses, and those of run "
            f"{', '.join(run.id for run in runs)} are {n:,}: revoke what was accepted from the earliest run"
        )
    return sorted(runs, key=lambda run: run.created_at)


def _effects(acceptances: Sequence[AcceptedEffect]) -> list[AppliedEffect]:
    """The effects in the order accepted, all at the reference temperature that was accepted first."""
    found = [own_effect(one.name, one.parameters) for one in acceptances]
    reference = next((values[REFERENCE] for _, values in found if REFERENCE in values), None)
    return [
        (name, {**values, REFERENCE: reference} if reference is not None and REFERENCE in values else values)
        for name, values in found
    ]


def _run_of(store: Store, run: Run, accepted: Sequence[AcceptedEffect]) -> RunOfEffects:
    """A run with what its own diagnosis found or took out, and with its rig's effects."""
    diagnosis = run.diagnosis or {}
    others = (
        [*diagnosis["effects"], *diagnosis.get("in_force", [])] if diagnosis.get("runs") == [run.id] else []
    )
    poses = counted_poses(store, run.id)
    added = [one for one in accepted if one.rig is not None and one.rig == run.rig]
    anew = {one.name for one in added}
    before = [one for one in store.effects.in_force(run.unit, run.rig) if one.unit is None]
    of_rig = [*(one for one in before if one.name not in anew), *added]
    return RunOfEffects(run.id, poses, others, [] if rest_on_map(poses) else as_applied(of_rig))


def _accepted(
    acceptances: Sequence[AcceptedEffect], runs: Sequence[Run], found: JointEffects
) -> list[AcceptedEffect]:
    latest = {one.name: one for one in acceptances}
    last = acceptances[-1].run_id
    return [
        replace(
            latest[name],
            id=None,
            run_id=last,
            parameters={key: None if one is None else one["value"] for key, one in parameters.items()},
            runs=[run.id for run in runs],
            std=known_stds(parameters),
            factor=factor,
            run_offset_std_deg=found.run_offset_std_deg,
            is_joint=True,
            is_partial=False,
        )
        for (name, parameters), factor in zip(found.effects, found.factors, strict=True)
    ]


def known_stds(parameters: dict[str, dict[str, float | None] | None]) -> dict[str, float]:
    """Return the standard errors of a diagnosis' parameters, where it states one."""
    return {name: std for name, one in parameters.items() if one and (std := one.get("std")) is not None}
