"""When each unit is due: by the drift of its history against its limits, else after a fixed interval."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np

from calrig.analysis.histories import SECONDS_PER_DAY, Histories, histories
from calrig.calibration.histories import Bounds, Forecast, IntArray, forecast
from calrig.calibration.uncertainty import limit_for
from calrig.estimation.angles import FloatArray
from calrig.model.verdict import Limit
from calrig.store import Store
from calrig.store.issued import Revision

INTERVAL_DAYS = 365.0
"""Where nobody has set another one (`interval_days` in calrig.toml)."""


@dataclass(frozen=True, slots=True)
class Due:
    """When a unit is due; `due_at` None where it was never calibrated."""

    due_at: datetime | None
    overdue: bool
    due_method: Literal["interval", "drift"] | None
    due_says: str


NEVER = Due(None, False, None, "It was never calibrated.")
WITHDRAWN = Due(None, False, None, "Its calibration was withdrawn: calibrate it again.")


@dataclass(frozen=True, slots=True)
class DueDates:
    """Of every unit that was calibrated. Runs whose revisions are all withdrawn count as no calibration."""

    units: Mapping[str, Due]

    def of(self, serial: str) -> Due:
        """Of one unit."""
        return self.units.get(serial, NEVER)


def due_dates(
    store: Store,
    found: Histories | None = None,
    *,
    serials: Collection[str] | None = None,
    interval_days: float = INTERVAL_DAYS,
    limits: Iterable[Limit] | None = None,
    now: datetime | None = None,
) -> DueDates:
    """When each unit is due.

    `found` are all histories, where they are known already, and `serials` the units to tell about (None for
    all). `interval_days` counts where a history says nothing; `limits` stand in for those of the store, `now`
    for this moment.
    """
    found = histories(store, None if serials is None else list(serials)) if found is None else found
    now = now or datetime.now(UTC)
    withdrawn = store.revisions.withdrawn_runs()
    rows = [row for row in enumerate(found.rows) if serials is None or row[1].unit in serials]
    latest = {row.unit: place for place, row in rows if row.run_id not in withdrawn}
    known = store.limits.all() if limits is None else list(limits)
    limited = {serial: limit_for(known, serial, found.rows[place].rig) for serial, place in latest.items()}
    with_limits = [serial for serial, limit in limited.items() if limit is not None]
    in_force = {one.unit: one for one in store.revisions.all_in_force(with_limits)} if with_limits else {}
    units = {row.unit: WITHDRAWN for _, row in rows}
    for serial, last in latest.items():
        limit = limited[serial]
        drifting = None
        if limit is not None:
            drifting = _by_drift(found, found.of(serial), limit, in_force.get(serial), interval_days)
        units[serial] = _due(found, last, drifting, interval_days, now)
    return DueDates(units)


def _due(found: Histories, last: int, drifting: Forecast | None, interval_days: float, now: datetime) -> Due:
    if drifting is not None and drifting.due_day is not None:
        at = datetime.fromtimestamp(drifting.due_day * SECONDS_PER_DAY, UTC)
        return Due(at, at < now, "drift", f"By its history: {drifting.why}.")
    at = found.rows[last].finished_at + timedelta(days=interval_days)
    why = "" if drifting is None else f"; {drifting.why}"
    return Due(at, at < now, "interval", f"{interval_days:g} days after its last calibration{why}.")


def _by_drift(
    found: Histories, places: IntArray, limit: Limit, in_force: Revision | None, interval_days: float
) -> Forecast | None:
    """The soonest of the forecasts of all that a limit is on; None where no history tells anything.

    Of the whole history where that lies on a line, else of what came after the last change.
    """
    told = []
    since = places[found.segment()[places] == found.segment()[places[-1]]]
    for day, value, variance, bounds in _limited(found, places, limit, in_force):
        whole = forecast(day, value, variance, bounds, interval_days)
        if whole is not None and not whole.fits:
            late = day >= found.day[since[0]]
            whole = forecast(day[late], value[late], variance[late], bounds, interval_days)
        if whole is not None:
            told.append(whole)
    dated = [one for one in told if one.due_day is not None]
    silent = next((one for one in told if one.due_day is None), None)
    if silent is not None:
        dated = [one for one in dated if (one.due_day or 0.0) < float(found.day[places[-1]]) + interval_days]
    return min(dated, key=lambda one: one.due_day or 0.0, default=silent)


def _limited(
    found: Histories, places: IntArray, limit: Limit, in_force: Revision | None
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, Bounds]]:
    """Days, values and variances of each figure that a limit is on, and its bounds."""
    variances = [found.variance(figure) for figure in range(2)]
    if variances[0] is None or variances[1] is None:
        return
    bias_var, scale_var = variances[0][places], variances[1][places]
    bias, scale = (runs.value[places] for runs in found.figures)
    day, known = found.day[places], np.isfinite(scale)
    if limit.bias_deg is not None:
        yield day, bias, bias_var, limit.bias_deg
    if limit.scale is not None:
        yield day[known], scale[known], scale_var[known], limit.scale
    ids = [found.rows[place].run_id for place in places]
    if limit.max_error_deg is not None and in_force is not None and in_force.run_id in ids:
        base = ids.index(in_force.run_id)
        for end in in_force.document["range_deg"]:
            error = bias - bias[base] + end * (scale - scale[base])
            variance = bias_var + end**2 * scale_var
            yield day[known], error[known], variance[known], (-limit.max_error_deg, limit.max_error_deg)
