"""Complete changes that an earlier version left half done when its process was killed.

Earlier versions stored an amendment and its entry in the audit log first, then the result that follows from
it, then the draft. If the process was killed in between, the draft or the result is missing.

A whole change may have no draft and a result that differs from the one of today. Therefore a result counts
as missing only if the stored one is that of before the change, and a draft only if no current revision rests
on the unit's own effects and the poses as they are.
"""

import logging
import math
from collections.abc import Iterable, Sequence
from functools import partial

from calrig.analysis.amendments import Records
from calrig.analysis.errors import Conflict
from calrig.analysis.limits import keep_configured
from calrig.analysis.results import refitted
from calrig.analysis.revisions import Issuer, Releases
from calrig.analysis.stored_runs import counted_poses
from calrig.analysis.unit_of_work import Fits, in_one_transaction
from calrig.model.result import Result
from calrig.settings import Settings
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.trail import EVERY_ENTRY, Act, Entry, What

log = logging.getLogger(__name__)

_IN_WORDS: dict[What, str] = {
    "accepted": "the acceptance of its effects",
    "taken_back": "the withdrawal of its effects",
    "voided": "that it was voided",
    "unvoided": "that it is valid again",
    "excluded": "the exclusion of a pose",
    "included": "the inclusion of a pose",
    "moved": "its move to another unit",
}
_FOLLOW: tuple[What, ...] = ("drafted", "released", "withdrawn")
_FIGURES = "bias_deg", "scale", "rms_calibrated_deg", "rms_with_effects_deg"
_SAME = 1e-6
"""Relative difference of figures that different versions compute from the same poses."""


def issuer_of(store: Store, settings: Settings, releases: Releases) -> Issuer:
    """Return who issues in a store that has been brought up to this version and to the configured limits."""
    keep_configured(settings, store)
    issuer = Issuer(store, releases)
    issuer.bring_over()
    mend(store, issuer)
    return issuer


def mend(store: Store, issuer: Issuer) -> list[str]:
    """Complete the half-done changes of a store, once for each store; return a sentence for each of them.

    Each is entered in the audit log as `mended`, and so is that the store was checked.
    """
    if any(one.unit is None for one in store.trail.entries(what=("mended",), limit=EVERY_ENTRY)):
        return []
    entries = store.trail.entries(what=(*_IN_WORDS, *_FOLLOW), limit=EVERY_ENTRY)
    if not entries:
        return []
    unfitted, undrafted = _without_result(entries), _without_draft(entries)
    says = []
    for entry in unfitted:
        says += in_one_transaction(store, partial(_mend_result, store, entry))
    for unit, entry in undrafted.items():
        says += in_one_transaction(store, partial(_mend_draft, store, issuer, unit, entry))
    for one in says:
        log.warning(one)
    n = len({entry.seq for entry in (*unfitted, *undrafted.values())})
    reason = f"{n} changes without a draft were checked; {len(says)} were half done and are completed"
    store.trail.add(Act("mended", reason=reason))
    return says


def _without_result(entries: Iterable[Entry]) -> list[Entry]:
    """Of each run the last acceptance or withdrawal of effects, unless the unit's next entry is its draft."""
    found: dict[str | None, Entry] = {}
    last: dict[str | None, Entry] = {}
    for entry in entries:
        before = last.get(entry.unit)
        if entry.what in ("accepted", "taken_back"):
            found[entry.run_id] = entry
        elif entry.what == "drafted" and before is not None and found.get(before.run_id) is before:
            del found[before.run_id]
        last[entry.unit] = entry
    return list(found.values())


def _without_draft(entries: Iterable[Entry]) -> dict[str, Entry]:
    """Of each unit the last change, if no revision was drafted, released or withdrawn since."""
    found: dict[str, Entry] = {}
    for entry in entries:
        for unit in {entry.unit, entry.detail.get("from")}:
            if unit is None:
                continue
            if entry.what in _IN_WORDS:
                found[unit] = entry
            else:
                found.pop(unit, None)
    return found


def _mend_result(store: Store, entry: Entry, _fits: Fits) -> list[str]:
    run = _run_of(store, entry)
    if run is None or run.result is None or run.kind == "verification" or run.voided is not None:
        return []
    in_force = store.effects.in_force(run.unit, run.rig)
    if any(one.is_joint for one in in_force):  # a later version has fitted all acceptances together
        return []
    poses = counted_poses(store, run.id)
    result, before = refitted(store, run, poses), _effects_before(store, run, entry, in_force)
    is_before = _is_same(run.result, refitted(store, run, poses, before))
    if _is_same(run.result, result) or not is_before:
        return []
    store.runs.update(run.id, result=result)
    return [_told(store, entry, run, "its result")]


def _effects_before(
    store: Store, run: Run, entry: Entry, in_force: Sequence[AcceptedEffect]
) -> list[AcceptedEffect]:
    """Return the effects that were in force before an acceptance or a withdrawal."""
    names = entry.detail.get("effects") or ()
    others = [one for one in in_force if not (one.run_id == run.id and one.name in names)]
    if entry.what == "accepted":
        return others
    withdrawn = {one.name: one for one in store.effects.ever_accepted(run.id) if one.name in names}
    return [*(one for one in others if one.name not in withdrawn), *withdrawn.values()]


def _mend_draft(store: Store, issuer: Issuer, unit: str, entry: Entry, fits: Fits) -> list[str]:
    run = _run_of(store, entry)
    if run is None:
        return []
    if entry.what in ("voided", "unvoided"):
        try:
            Records(store, issuer).refit_effects(run, fits)
        except Conflict as error:
            return [_say(store, run, f"run {run.id}: {_IN_WORDS[entry.what]} was not completed: {error}")]
    if not issuer.lacks_draft(run.model_copy(update={"unit": unit})):
        return []
    why = f"completed at the start: {_IN_WORDS[entry.what]} (run {run.id}, audit log {entry.seq})"
    made = issuer.redraft(run.model_copy(update={"unit": unit}), by=entry.who, reason=why)
    if made is None:
        return []
    return [_told(store, entry, run, f"revision {made.revision} of unit {unit}")]


def _run_of(store: Store, entry: Entry) -> Run | None:
    return None if entry.run_id is None else store.runs.get(entry.run_id)


def _is_same(stored: Result, computed: Result) -> bool:
    for name in _FIGURES:
        before, now = getattr(stored, name), getattr(computed, name)
        if (before is None) != (now is None):
            return False
        if before is not None and not math.isclose(before, now, rel_tol=_SAME, abs_tol=_SAME):
            return False
    return True


def _told(store: Store, entry: Entry, run: Run, what: str) -> str:
    """Enter in the audit log what was completed, and return it."""
    says = (
        f"run {run.id}: {_IN_WORDS[entry.what]} on {entry.at:%Y-%m-%d %H:%M} UTC was interrupted before "
        f"{what} followed; it is completed now"
    )
    return _say(store, run, says)


def _say(store: Store, run: Run, says: str) -> str:
    store.trail.add(Act("mended", unit=run.unit, rig=run.rig, run_id=run.id, reason=says))
    return says
