"""What changed from each run of a unit to the next: CONTRACT section 2's `changes`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calrig.analysis.change_words import difference_in_words, traced_in_words
from calrig.analysis.errors import Unknown
from calrig.analysis.histories import FIGURES, Histories, histories
from calrig.calibration.histories import FALSE_DISCOVERY_RATE, UNIT_CHART, ControlChart, control_chart
from calrig.estimation.angles import FloatArray
from calrig.store import Store

Document = dict[str, Any]

RULE = (
    f"Units are marked so that of those marked {100 * FALSE_DISCOVERY_RATE:g} % on average are so by chance "
    "(false discovery rate, Benjamini and Hochberg 1995), over all units of this store."
)


def unit_changes(store: Store, serial: str) -> list[Document]:
    """Each run of a unit that counts beside the one before it, the oldest first.

    Effects are those of the diagnosis of both runs that is stored, if there is one; none is made.

    Raises:
        Unknown: there is no such unit.
    """
    if store.unit(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    found = histories(store, [serial])
    places = found.of(serial)
    signals = [chart.signals for chart in charts(found, serial) if chart is not None]
    pairs = found.changes.figures[0].first
    listed = []
    for k in [k for k, first in enumerate(pairs) if len(places) and places[0] <= first <= places[-1]]:
        change = change_of(found, k)
        if change["verdict"] == "changed":
            change["effects"] = _traced(store, change["from"], change["to"])
            if change["effects"]:
                change["says"] = traced_in_words(change["effects"])
        to = int(found.changes.figures[0].second[k] - places[0])
        change["signal"] = any(bool(one[to]) for one in signals) if signals else None
        listed.append(change)
    return listed


def change_of(found: Histories, k: int) -> Document:
    """The k-th difference of all, without effects: `effects` is [] where nothing changed, else None."""
    first, second = (int(getattr(found.changes.figures[0], name)[k]) for name in ("first", "second"))
    change: Document = {
        "from": found.rows[first].run_id,
        "to": found.rows[second].run_id,
        "days": float(found.day[second] - found.day[first]),
    }
    for (name, _), difference in zip(FIGURES, found.changes.figures, strict=True):
        value, std, sigma = (_known(one[k]) for one in (difference.value, difference.std, difference.sigma))
        change[name] = value
        change[f"{name.removesuffix('_deg')}_std{'_deg' if name.endswith('_deg') else ''}"] = std
        change[f"{name.removesuffix('_deg')}_sigma"] = sigma
    p_value = _known(found.changes.p_value[k])
    changed = bool(found.changes.changed[k])
    verdict = "not_known" if p_value is None else "changed" if changed else "unchanged"
    return {
        **change,
        "p_value": p_value,
        "verdict": verdict,
        "effects": None if changed else [],
        "says": difference_in_words(found.changes.figures, k, verdict),
    }


def charts(found: Histories, serial: str) -> list[ControlChart | None]:
    """The control chart of each figure since the unit last changed; None where repeatability is not known.

    Each is of all the unit's runs; those before the last change have no limit and no signal.
    """
    places = found.of(serial)
    segments = found.segment()[places]
    drawn: list[ControlChart | None] = []
    for figure, runs in enumerate(found.figures):
        variance = found.variance(figure)
        if variance is None or not len(places):
            drawn.append(None)
            continue
        since = int((segments == segments[-1]).argmax())
        freedom = np.asarray(found.freedom(figure))[places]
        drawn.append(_since(runs.value[places], variance[places], since, freedom))
    return drawn


def _since(value: FloatArray, variance: FloatArray, since: int, freedom: FloatArray) -> ControlChart:
    known = np.flatnonzero(np.isfinite(value))
    known = known[known >= since]
    chart = control_chart(value[known], variance[known], UNIT_CHART, freedom[known])
    n = len(value)
    whole = ControlChart(np.zeros(n), np.zeros(n), np.full(n, np.inf), np.zeros(n, dtype=bool))
    for name in ("q", "average", "limit", "signals"):
        getattr(whole, name)[known] = getattr(chart, name)
    return whole


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _traced(store: Store, before: str, after: str) -> list[Document] | None:
    """Effects that the stored diagnosis of two runs says have changed between them; None without one."""
    run = store.run(after)
    diagnosis = None if run is None else run.diagnosis
    if diagnosis is None or before not in diagnosis["runs"]:
        return None
    return [
        effect
        for effect in diagnosis["effects"]
        if effect.get("changed") is not None and effect["changed"] == {"from": before, "to": after}
    ]
