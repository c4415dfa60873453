"""Use cases of histories: the runs of all units side by side, what changed between runs, in sentences."""

import math
import pickle
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import compress
from typing import Any

import numpy as np

from calrig.analysis.stored_runs import known_unit
from calrig.calibration.effects import EFFECTS, title_inside
from calrig.calibration.histories import (
    FALSE_DISCOVERY_RATE,
    UNIT_CHART,
    Changes,
    ControlChart,
    Differences,
    IntArray,
    Runs,
    changes,
    control_chart,
    pairs,
)
from calrig.estimation.angles import FloatArray
from calrig.model.comparison import ChangeVerdict
from calrig.model.result import Gyro
from calrig.store import ComparisonRow, Store
from calrig.store.records import Document

FIGURES = (("bias_deg", "bias_std_deg"), ("scale", "scale_std"))
"""What is compared, with its standard error."""
SECONDS_PER_DAY = 86_400.0


@dataclass(frozen=True, slots=True)
class Histories:
    """N runs that count, by unit, the oldest of each first; arrays (N,) in that order.

    Attributes:
        serials: of the units, in their order here.
        day: when each run finished, in days since 1970.
        figures: bias and scale.
        changes: what changed between each run and the next of its unit.
    """

    rows: list[ComparisonRow]
    serials: list[str]
    day: FloatArray
    figures: tuple[Runs, Runs]
    changes: Changes

    def of(self, serial: str) -> IntArray:
        """Places of a unit's runs."""
        if serial not in self.serials:
            return np.empty(0, dtype=np.intp)
        return np.flatnonzero(self.figures[0].unit == self.serials.index(serial))

    def changed_units(self) -> list[str]:
        """Serials of the units that changed between two of their runs."""
        units = self.figures[0].unit[self.changes.first[self.changes.changed]]
        return [self.serials[unit] for unit in dict.fromkeys(units.tolist())]

    def segment(self) -> IntArray:
        """(N,) which stretch of an unchanged unit each run belongs to, from 0."""
        begins = np.zeros(len(self.rows), dtype=np.intp)
        if len(begins):
            begins[1:] = self.figures[0].unit[1:] != self.figures[0].unit[:-1]
            begins[self.changes.figures[0].second[self.changes.changed]] = 1
        return np.cumsum(begins)

    def variance(self, figure: int) -> FloatArray | None:
        """(N,) of a run's figure about what its unit has: its own, re-clamping's and the day's.

        None where repeatability is not known.
        """
        pooled = self.changes.pooled[figure]
        if pooled is None:
            return None
        own = np.nan_to_num(self.figures[figure].std) ** 2
        return np.asarray(own + max(pooled.between_days**2, SMALLEST[figure] ** 2), dtype=np.float64)

    def freedom(self, figure: int) -> FloatArray | None:
        """(N,) degrees of freedom that these variances rest on; None where they are not known.

        Welch and Satterthwaite (GUM, JCGM 100:2008, G.4.1), a run's own standard error taken for known: the
        less re-clamping and the day add beside it, the less it matters how few repeats tell of them.
        """
        pooled, variance = self.changes.pooled[figure], self.variance(figure)
        if pooled is None or variance is None:
            return None
        share = max(pooled.between_days, SMALLEST[figure]) ** 2 / variance
        return np.asarray(np.minimum(pooled.freedom / share**2, MOST_FREEDOM), dtype=np.float64)


MOST_FREEDOM = 1e9
"""As good as known."""
SMALLEST = (1e-6, 1e-8)
"""Below which no figure repeats: where runs are copies of one another, nothing is divided by zero."""


POOLED = 5_000
"""Calibrations that tell how units repeat, the latest: to 1 % of a standard deviation, in 0.1 s."""


def histories(store: Store, serials: Sequence[str] | None = None) -> Histories:
    """Return the histories of units; a change is tested against how all units repeat.

    `serials` are of interest, told whole beside the `POOLED` latest runs of all; None for all of all.
    """
    rows = store.units.comparison(serials, latest=POOLED)
    units, day, figures = _arrays(store, rows)
    return Histories(rows, units, day, figures, _changes(pickle.dumps(figures)))


def change_between(store: Store, before: ComparisonRow, now: ComparisonRow) -> tuple[Changes, int]:
    """Test a unit's new run against the one that its calibration in force is of, as `histories` tests runs.

    How units repeat is known by the other runs alone: the new one does not judge itself. Where another unit
    was on the rig since, the unit was remounted, and only runs after a remounting tell what that adds.

    `store` has all other runs, and perhaps these two.

    Returns:
        The changes between all runs, without the unit's own after `before`; and the place of this pair.
    """
    rows = [row for row in store.units.comparison([now.unit], latest=POOLED) if row.run_id != now.run_id]
    known = list({row.run_id: row for row in [*rows, before, now]}.values())
    since = (row.unit == now.unit and row.finished_at > before.finished_at for row in known)
    is_remounted = any(compress(_remounted(known), since))
    repeats = list(compress(rows, _remounted(rows))) if is_remounted else rows
    pooled = changes(_arrays(store, repeats)[2]).pooled
    own = [row for row in rows if row.unit == now.unit and row.run_id != before.run_id]
    own = [row for row in own if row.finished_at < before.finished_at]
    others = [row for row in rows if row.unit != now.unit]
    rows = [*own, before, now, *others]
    return changes(_arrays(store, rows)[2], pooled), len(own)


def _remounted(rows: Sequence[ComparisonRow]) -> list[bool]:
    """Return of each run whether its unit was certainly mounted since its run before, if it had any."""
    by_rig: dict[str | None, str] = {}
    by_unit: dict[str, str | None] = {}
    found = [True] * len(rows)
    for place in sorted(range(len(rows)), key=lambda place: rows[place].finished_at):
        row = rows[place]
        stayed = row.unit in by_unit and by_unit[row.unit] == row.rig and by_rig[row.rig] == row.unit
        found[place] = not stayed
        by_rig[row.rig], by_unit[row.unit] = row.unit, row.rig
    return found


def _arrays(store: Store, rows: list[ComparisonRow]) -> tuple[list[str], FloatArray, tuple[Runs, Runs]]:
    """Serials of the units, (N,) days and the figures of runs that come by unit, the oldest first."""
    serials = list(dict.fromkeys(row.unit for row in rows))
    rigs = {name: place for place, name in enumerate(dict.fromkeys(row.rig for row in rows))}
    units = {serial: place for place, serial in enumerate(serials)}
    unit = np.array([units[row.unit] for row in rows], dtype=np.intp)
    rig = np.array([rigs[row.rig] for row in rows], dtype=np.intp)
    day = np.array([row.finished_at.timestamp() / SECONDS_PER_DAY for row in rows])
    _, day_of_rig = np.unique(np.floor(day).astype(np.intp) * len(rigs) + rig, return_inverse=True)
    stage = _stage_variances(store, rows, unit, rig)
    figures = tuple(
        Runs(unit, rig, day_of_rig, _column(rows, name), _column(rows, std), stage[:, place])
        for place, (name, std) in enumerate(FIGURES)
    )
    return serials, day, (figures[0], figures[1])


@lru_cache(maxsize=4)
def _changes(figures: bytes) -> Changes:
    """Return the changes of pickled `Runs`; cached, because a page asks many times for the same ones."""
    return changes(pickle.loads(figures))  # noqa: S301 (pickled by the caller, never stored)


def _column(rows: list[ComparisonRow], name: str) -> FloatArray:
    return np.array([row.result[name] for row in rows], dtype=np.float64)


def _stage_variances(store: Store, rows: list[ComparisonRow], unit: IntArray, rig: IntArray) -> FloatArray:
    """(N, 2) what the stage is worth in bias and scale; looked up where a unit went to another rig alone."""
    found = np.zeros((len(rows), len(FIGURES)))
    first, second = pairs(unit)
    moved = rig[first] != rig[second]
    places = np.unique(np.concatenate([first[moved], second[moved]]))
    known = store.runs.reference_figures([rows[place].run_id for place in places])
    for place in places:
        own = rows[place].result.get("reference") or {}  # of a run that is not stored yet
        unstored = own.get("bias_std_deg", 0.0), own.get("scale_std")
        bias, scale = known.get(rows[place].run_id, unstored)
        found[place] = bias**2, (scale or 0.0) ** 2
    return found


FIGURE_NAMES = (("bias", "°"), ("scale", ""))
STANDS_OUT = 3.0
"""Standard uncertainties beyond which a figure is named beside the one that changed most."""


def difference_in_words(differences: Sequence[Differences], k: int, verdict: str) -> str:
    """Say the k-th difference of bias and scale: how far each moved, and its uncertainty."""
    named = zip(FIGURE_NAMES, differences, strict=True)
    known = [(name, unit, d) for (name, unit), d in named if math.isfinite(d.value[k])]
    if verdict == "not_known":
        moved = (f"{name} by {plus_minus(d.value[k], d.type_a_std[k], unit)}" for name, unit, d in known)
        by = " and ".join(moved) or "nothing that is known"
        return (
            f"Moved: {by} (the noise of both runs alone). What remounting and the "
            "day add is not known yet: that takes more units that were calibrated twice."
        )
    tested = [one for one in known if math.isfinite(one[2].std[k])]
    if verdict == "unchanged":
        by = ", ".join(f"{name} {plus_minus(d.value[k], d.std[k], unit)}" for name, unit, d in tested)
        return f"No more than repeatability: {by}."
    tested.sort(key=lambda one: -abs(one[2].sigma[k]))
    told = [tested[0], *(one for one in tested[1:] if abs(one[2].sigma[k]) > STANDS_OUT)]
    moved = (
        f"{name} moved by {plus_minus(d.value[k], d.std[k], unit)} ({abs(d.sigma[k]):.0f} times that)"
        for name, unit, d in told
    )
    return _sentence("; ".join(moved))


def traced_in_words(effects: Sequence[dict[str, Any]], *, reference_is_good: bool) -> str:
    """Such as "z offset moved by 6.0 ± 0.1 mg."; without a capital where it begins with an axis."""
    title, said = partial(title_inside, reference_is_good=reference_is_good), []
    for effect in effects:
        moved = " and ".join(_moved(effect)) or f"{title(effect['name'])} changed"
        others = " or ".join(map(title, effect["confusable_with"]))
        doubt = "" if effect["verdict"] == "named" else f" (or: {others or 'something else'})"
        said.append(f"{moved}{doubt}")
    return _sentence("; ".join(said))


def _moved(effect: dict[str, Any]) -> Iterator[str]:
    """Of each parameter that is more than its error; at least the most significant one."""
    known = effect["parameters"]
    catalogued = EFFECTS[effect["name"]].parameters if effect["name"] in EFFECTS else ()
    given = [
        (parameter, known[parameter.name]["value"], known[parameter.name]["std"])
        for parameter in catalogued
        if known.get(parameter.name) is not None and known[parameter.name]["std"]
    ]
    given.sort(key=lambda one: -abs(one[1]) / one[2])
    for place, (parameter, value, std) in enumerate(given):
        if place == 0 or abs(value) > STANDS_OUT * std:
            title = re.sub(r"^Offset of (\w+)$", r"\1 offset", parameter.title)
            yield f"{title} moved by {plus_minus(value, std, parameter.unit or '')}"


def _sentence(words: str) -> str:
    return f"{words[0] if re.match('[xyz] ', words) else words[0].upper()}{words[1:]}."


def plus_minus(value: float, std: float, unit: str) -> str:
    """Such as "6.0 ± 0.1 mg": both to the first digit of the error."""
    unit = unit if unit in {"", "°"} else f" {unit}"
    if not (math.isfinite(std) and std > 0.0):
        return f"{value:.4g}{unit}".replace("-", "−")
    decimals = max(0, -math.floor(math.log10(std) + 0.02))
    rounded = round(value, decimals) + 0.0  # no −0.00
    return f"{rounded:.{decimals}f} ± {std:.{decimals}f}{unit}".replace("-", "−")


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
    known_unit(store, serial)
    found = histories(store, [serial])
    places = found.of(serial)
    signals = [chart.signals for chart in charts(found, serial) if chart is not None]
    pairs = found.changes.figures[0].first
    gyros = store.runs.gyros([found.rows[place].run_id for place in places])
    listed = []
    for k in [k for k, first in enumerate(pairs) if len(places) and places[0] <= first <= places[-1]]:
        change = change_of(found, k)
        if change["verdict"] == "changed":
            change |= _traced(store, change["from"], change["to"])
        change["gyro"] = gyro_difference(gyros.get(change["from"]), gyros.get(change["to"]))
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
    before, after = (found.rows[place].result["rms_calibrated_deg"] for place in (first, second))
    change["rms_deg"] = None if None in (before, after) else after - before
    p_value = _known(found.changes.p_value[k])
    changed = bool(found.changes.changed[k])
    verdict = change_verdict(p_value, changed=changed)
    return {
        **change,
        "p_value": p_value,
        "verdict": verdict,
        "effects": None if changed else [],
        "says": difference_in_words(found.changes.figures, k, verdict),
    }


def change_verdict(p_value: float | None, *, changed: bool) -> ChangeVerdict:
    """Return the verdict of a test for a change; without a p-value none was made."""
    if p_value is None:
        return "not_known"
    return "changed" if changed else "unchanged"


def gyro_difference(before: Gyro | None, after: Gyro | None) -> Document | None:
    """Return the gyro figures of a run less those of the run before; None without figures of both."""
    if before is None or after is None:
        return None
    bias = [_less(*both) for both in zip(before.bias_dps, after.bias_dps, strict=True)]
    scale = _less(before.scale, after.scale)
    if scale is None and not any(one is not None for one in bias):
        return None
    stds = zip(before.bias_std_dps, after.bias_std_dps, strict=True)
    return {
        "bias_dps": bias,
        "bias_std_dps": [_both(*both) for both in stds],
        "scale": scale,
        "scale_std": _both(before.scale_std, after.scale_std),
    }


def _less(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else after - before


def _both(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else math.hypot(before, after)


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
    whole = ControlChart(np.zeros(n), np.full(n, np.inf), np.zeros(n, dtype=bool))
    for name in ("average", "limit", "signals"):
        getattr(whole, name)[known] = getattr(chart, name)
    return whole


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _traced(store: Store, before: str, after: str) -> Document:
    """Effects that a stored diagnosis says have changed between two runs; in words, too, if any has."""
    run = store.runs.get(after)
    diagnosis = None if run is None else run.diagnosis
    if diagnosis is None or before not in diagnosis["runs"]:
        return {"effects": None}
    between = {"from": before, "to": after}
    effects = [effect for effect in diagnosis["effects"] if effect.get("changed") == between]
    if not effects:
        return {"effects": effects}
    is_good = diagnosis.get("reference") == "good"
    return {"effects": effects, "says": traced_in_words(effects, reference_is_good=is_good)}
