"""What a revision's certificate is made of, gathered from the store."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from calrig.analysis.stored_runs import stored_run
from calrig.calibration.conformity import Limit
from calrig.export.certificate.content import Certificate
from calrig.export.certificate.making import Sources, certificate_of
from calrig.settings import LaboratorySettings
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.issued import Revision
from calrig.store.trail import Entry, What

EVERY_ENTRY = 1_000_000


def certificate(store: Store, revision: Revision, laboratory: LaboratorySettings) -> Certificate:
    """The content of a revision's certificate."""
    run = stored_run(store, revision.run_id)
    entries = _entries(store, revision)
    return certificate_of(
        Sources(
            revision=revision,
            run=run,
            poses=store.poses(run.id),
            laboratory=laboratory,
            before=_before(store, revision, entries),
            of_stage=_of_stage(store, revision, run),
            limit=_limit(store, revision),
            entries=entries,
        )
    )


def _entries(store: Store, revision: Revision) -> list[Entry]:
    """Of the trail, what was done with this revision; the oldest first."""
    what: tuple[What, ...] = ("drafted", "released", "withdrawn")
    of_unit = store.trail(unit=revision.unit, what=what, limit=EVERY_ENTRY)
    return [one for one in of_unit if (one.act.unit, one.act.revision) == (revision.unit, revision.revision)]


def _before(store: Store, revision: Revision, entries: Sequence[Entry]) -> Revision | None:
    """The revision that was in force until this one first was; of a draft, the one that is in force now."""
    first = next((one for one in entries if one.act.what == "released"), None)
    if first is None:
        in_force = store.in_force(revision.unit) if revision.status == "draft" else None
        return None if in_force is None or in_force.revision == revision.revision else in_force
    number = first.act.detail.get("supersedes")
    return None if number is None else store.revision(revision.unit, number)


def _of_stage(store: Store, revision: Revision, run: Run) -> list[AcceptedEffect]:
    """The rig's effects that it rests on, as far as nobody has taken them back since."""
    used = revision.basis["effects"]
    accepted = store.effects_in_force(revision.unit, run.rig)
    return [effect for effect in accepted if effect.unit is None and str(effect.id) in used]


def _limit(store: Store, revision: Revision) -> Limit | None:
    """The limit that its verdict names, as it was then."""
    named = revision.verdict["limit"]
    if named is None:
        return None
    limits = _limits_at(store, revision.issued_at)
    return next((one for one in limits if one.name == named), None)


def _limits_at(store: Store, when: datetime) -> list[Limit]:
    """The limits as the trail has them of a time; those of today, where nobody ever changed them."""
    changes = store.trail(what=["limits_changed"], limit=EVERY_ENTRY)
    before = [one for one in changes if one.at <= when]
    if before:
        return [Limit.from_dict(one) for one in before[-1].act.detail["now"]]
    return [Limit.from_dict(one) for one in changes[0].act.detail["before"]] if changes else store.limits()
