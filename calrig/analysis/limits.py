"""Use cases of limits: replace them and check whether a plan can pass them."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.stage_maps import kept_of
from calrig.calibration.separation import StageMap, map_reference
from calrig.calibration.uncertainty import cannot_pass, limit_for
from calrig.model.plan import Plan
from calrig.model.result import Reference
from calrig.model.verdict import Limit
from calrig.settings import LimitSettings, RigSettings, Settings
from calrig.store import Store
from calrig.store.records import Document


def keep_configured(settings: Settings, store: Store) -> None:
    """Store the limits of the configuration, if it has any, for everything that reads the store."""
    if settings.limit:
        found = f"as {settings.file} has them"
        store.limits.replace(settings.limit, who=None, reason=found)


def replace(
    store: Store, given: Sequence[LimitSettings], *, who: str | None, kept_in: str | None
) -> list[Limit]:
    """Replace all limits.

    `given` are in the order that they are tried in; `who` is None if unknown; `kept_in` is the file that
    gives the limits, None where it does not.

    Raises:
        Conflict: they are kept in a file.
        Invalid: two have one name.
    """
    if kept_in is not None:
        raise Conflict(f"the limits are kept in {kept_in} ([[limit]]): change them there and restart calrig")
    names = [one.name for one in given]
    for place, name in enumerate(names):
        if name in names[:place]:
            said = f"Limit {place + 1} is named {name!r} like another one: a verdict names its limit"
            raise Invalid(said, [f"[{place}].name"])
    store.limits.replace(given, who=who)
    return store.limits.all()


def cannot_pass_on(
    rig: RigSettings, unit: str, plan: Plan, store: Store, maps: Mapping[str, Document] = MappingProxyType({})
) -> list[str]:
    """Return why no unit can pass its limits on a rig by a plan; empty if one can.

    `store` has limits, and the map that was put in force; `maps` are those that files give, as far as they
    are in this program's hands.
    """
    limit = limit_for(store.limits.all(), unit, rig.name)
    if limit is None or plan.kind == "static":
        return []
    stated = rig.reference
    reference = None
    if stated is not None and stated.std_deg is not None:
        reference = Reference(stated.std_deg, stated.kind, stated.distribution)
    theta_deg = np.array(plan.elevations() * plan.sweeps, dtype=np.float64)
    kept = kept_of(store, rig.name, maps)
    if kept is None and stated is not None and stated.map is not None:
        return []  # a bench's own file, which a centre has not seen
    if kept is not None:
        in_force = StageMap.from_frozen(kept)
        if in_force.covers(theta_deg).all():
            reference = map_reference(in_force, theta_deg, theta_deg, np.zeros(len(theta_deg)))
    return cannot_pass(limit, reference, theta_deg)
