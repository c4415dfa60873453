"""What a revision of a calibration rests on: which runs can give one, and what of it has changed since."""

from __future__ import annotations

from collections.abc import Sequence

from calrig.analysis.errors import Conflict
from calrig.analysis.mounts import axis_of
from calrig.plan import CALIBRATING
from calrig.store import AcceptedEffect, Run
from calrig.store.issued import Revision
from calrig.store.records import Document


def why_none(run: Run) -> str | None:
    """Why a run makes no calibration whatever it measures; None where it does.

    A verification applies one, a static log stands still, a follow-up has the poses that tell suspects apart,
    and about another axis than the unit's x there is no elevation.
    """
    if run.kind not in CALIBRATING:
        return f"is a {'static log' if run.kind == 'static' else run.kind}"
    if (axis := axis_of(run)) != "x":
        return f"had the unit's {axis} along the stage's axis: its poses are for the joint solution"
    return None if run.follows is None else f"is a follow-up of run {run.follows}"


def why_not_now(run: Run) -> str | None:
    """Why a calibration run gives none as it is; None where it does."""
    if run.voided is not None:
        return f"is voided ({run.voided['reason']})"
    if run.status != "completed" or run.result is None:
        return f"is {run.status}"
    return "does not know its scale" if run.result["scale"] is None else None


def basis_of(
    accepted: Sequence[AcceptedEffect], excluded: Sequence[int], chosen: Sequence[str] | None
) -> Document:
    """What a draft rests on beside its run, to be held against the same later.

    Args:
        accepted: effects that enter, of the unit and of its rig.
        excluded: indices of the run's poses that do not count.
        chosen: names of the unit's effects, where a person named them; None for all that are accepted.
    """
    return {
        "effects": {str(effect.id): effect.name for effect in accepted},
        "excluded": sorted(excluded),
        "chosen": None if chosen is None else sorted(chosen),
    }


def chosen_effects(
    accepted: Sequence[AcceptedEffect], names: Sequence[str] | None, run: Run
) -> list[AcceptedEffect]:
    """The accepted effects with those of the unit that a person named; the stage's are the rig's throughout.

    Raises:
        Conflict: one of the names has not been accepted for the unit.
    """
    if names is None:
        return list(accepted)
    own = {effect.name for effect in accepted if effect.unit is not None}
    for name in names:
        if name not in own:
            known = ", ".join(sorted(own)) or "none"
            raise Conflict(f"{name!r} is no accepted effect of unit {run.unit!r}; accepted: {known}")
    return [effect for effect in accepted if effect.unit is None or effect.name in names]


def changed_since(
    revision: Revision, run: Run, accepted: Sequence[AcceptedEffect], excluded: Sequence[int]
) -> list[str]:
    """What a revision rests on that has changed since it was made, a sentence each."""
    said = []
    if run.voided is not None:
        said.append(f"Run {run.id} has been voided: {run.voided['reason']}")
    if run.unit != revision.unit:
        said.append(f"Run {run.id} belongs to unit {run.unit} now.")
        return said
    if sorted(excluded) != revision.basis["excluded"]:
        then, now = _poses(revision.basis["excluded"]), _poses(excluded)
        said.append(f"Excluded poses of run {run.id} were {then} and are {now}.")
    used, now_accepted = revision.basis["effects"], {str(e.id): e for e in accepted}
    chosen = revision.basis["chosen"]
    gone = sorted(name for key, name in used.items() if key not in now_accepted)
    new = [e for key, e in now_accepted.items() if key not in used]
    if chosen is not None:  # those of the unit that were left out were left out on purpose
        new = [effect for effect in new if effect.unit is None]
    if gone:
        said.append(f"No longer accepted as applied: {', '.join(gone)}.")
    if new:
        names = sorted(f"{e.name} (rig {e.rig})" if e.unit is None else e.name for e in new)
        said.append(f"Accepted since: {', '.join(names)}.")
    return said


def _poses(indices: Sequence[int]) -> str:
    return ", ".join(str(index) for index in sorted(indices)) or "none"
