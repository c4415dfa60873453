"""Use cases of a rig's check standard: each check, when the next is due, the runs that a failure affects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from calrig.analysis.errors import Unknown
from calrig.analysis.histories import FIGURES, Histories, histories
from calrig.calibration.histories import Checks, checks
from calrig.model.run import Suspect
from calrig.store import CheckUnit, ComparisonRow, Run, Store
from calrig.store.records import Document


@dataclass(frozen=True, slots=True)
class SuspectPeriod:
    """A period in which a rig was not known to be right: after `after`, before `until`.

    Attributes:
        after: when its check standard last passed; when it was named, if it never passed.
        until: when it passed again; None while it has not.
        failed: the check that failed first.
    """

    rig: str
    after: datetime
    until: datetime | None
    failed: str
    reason: str

    def contains(self, rig: str | None, finished_at: datetime | None) -> bool:
        """Return whether a run of a rig finished in the period."""
        if rig != self.rig or finished_at is None or finished_at <= self.after:
            return False
        return self.until is None or finished_at < self.until


@dataclass(frozen=True, slots=True)
class Suspects:
    """The suspect periods of all rigs, by rig."""

    periods: Mapping[str, Sequence[SuspectPeriod]]

    def of(self, rig: str | None, finished_at: datetime | None) -> Suspect | None:
        """Return why a run is suspect; None if it is not."""
        for period in self.periods.get(rig or "", ()):
            if period.contains(rig, finished_at):
                return Suspect(reason=period.reason, check_run_id=period.failed)
        return None


def suspects(store: Store, found: Histories | None = None) -> Suspects:
    """Return the suspect periods of all rigs that have a check standard."""
    named = store.check_standards.all()
    if not named:
        return Suspects({})
    found = histories(store) if found is None else found
    return Suspects({one.rig: _suspect_periods(one, _checked(found, one)) for one in named})


def with_doubts(store: Store, runs: Sequence[Run]) -> list[Run]:
    """Return the runs, each with the reason why it is suspect, if it is."""
    known = suspects(store)
    return (
        [run.model_copy(update={"suspect": known.of(run.rig, run.finished_at)}) for run in runs]
        if known.periods
        else [*runs]
    )


@dataclass(frozen=True, slots=True)
class _Checked:
    """The runs of a check standard on its rig, and their charts; `figures` is empty if nothing is known.

    Attributes:
        places: in the histories.
        from_place: of the first that is a check, among them.
        figures: bias and scale.
        failed, known: (n,) over both.
    """

    found: Histories
    places: np.ndarray[Any, np.dtype[np.intp]]
    from_place: int
    figures: tuple[Checks, ...]
    failed: np.ndarray[Any, np.dtype[np.bool_]]
    known: np.ndarray[Any, np.dtype[np.bool_]]

    def row(self, place: int) -> ComparisonRow:
        return self.found.rows[int(self.places[place])]


def _checked(found: Histories, named: CheckUnit) -> _Checked:
    places = np.array([k for k in found.of(named.unit) if found.rows[k].rig == named.rig], dtype=np.intp)
    n = len(places)
    begins = sum(found.rows[k].finished_at < named.named_at for k in places)
    failed, known = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    judged = []
    for figure, runs in enumerate(found.figures):
        variance, freedom = found.variance(figure), found.freedom(figure)
        value = runs.value[places]
        if variance is None or freedom is None or not np.isfinite(value).all():
            continue
        one = checks(value, variance[places], begins, freedom[places])
        judged.append(one)
        failed |= one.failed
        known |= one.known
    return _Checked(found, places, begins, tuple(judged), failed, known)


def _suspect_periods(named: CheckUnit, checked: _Checked) -> list[SuspectPeriod]:
    found: list[SuspectPeriod] = []
    passed_at, is_open = named.named_at, False
    for place in range(len(checked.places)):
        row = checked.row(place)
        if checked.failed[place] and not is_open:
            is_open = True
            reason = (
                f"check unit {named.unit} failed on rig {named.rig} in run {row.run_id}, and last "
                f"passed {_when(passed_at) if passed_at != named.named_at else 'never since it was named'}"
            )
            found.append(SuspectPeriod(named.rig, passed_at, None, row.run_id, reason))
        elif checked.known[place] and not checked.failed[place]:
            if is_open:
                found[-1] = replace(found[-1], until=row.finished_at)
            passed_at, is_open = row.finished_at, False
    return found


def _when(at: datetime) -> str:
    return at.astimezone(UTC).strftime("on %Y-%m-%d at %H:%M UTC")


def check_document(store: Store, rig: str, *, now: datetime | None = None) -> Document:
    """Return the state of a rig by its check standard.

    Raises:
        Unknown: it has none.
    """
    named, found = _named(store, rig), histories(store)
    checked = _checked(found, named)
    now = now or datetime.now(UTC)
    n = len(checked.places)
    last = checked.row(n - 1).finished_at if n else None
    passed = [place for place in range(n) if checked.known[place] and not checked.failed[place]]
    due_at = (named.named_at if last is None else last) + timedelta(days=named.interval_days)
    state = _verdict(checked, -1)
    periods = _suspect_periods(named, checked)
    return {
        "rig": rig,
        "unit": named.unit,
        "interval_days": named.interval_days,
        "named_at": named.named_at,
        "state": state,
        "last_check_at": last,
        "last_passed_at": checked.row(passed[-1]).finished_at if passed else None,
        "due_at": due_at,
        "overdue": due_at < now,
        "says": _says(named, state, due_at, overdue=due_at < now),
        "checks": [_check(checked, place) for place in range(n)],
        "suspect_runs": [
            row.run_id
            for row in sorted(found.rows, key=lambda row: row.finished_at)
            if any(one.contains(row.rig, row.finished_at) for one in periods)
        ],
    }


def check_chart(store: Store, rig: str) -> tuple[list[datetime], dict[str, list[float]], list[float]]:
    """Return when each check was, its moving averages by figure, and their control limit.

    Raises:
        Unknown: the rig has no check unit.
    """
    checked = _checked(histories(store), _named(store, rig))
    finished_at = [checked.row(place).finished_at for place in range(len(checked.places))]
    names = ("bias", "scale")[: len(checked.figures)]
    averages = {name: one.average.tolist() for name, one in zip(names, checked.figures, strict=True)}
    return finished_at, averages, checked.figures[0].limit.tolist() if checked.figures else []


def _named(store: Store, rig: str) -> CheckUnit:
    named = store.check_standards.of(rig)
    if named is None:
        raise Unknown(f"rig {rig!r} has no check unit: name one with PUT, or on the rig's page")
    return named


def _verdict(checked: _Checked, place: int) -> str:
    if not len(checked.places) or not checked.known[place]:
        return "not_known"
    return "failed" if checked.failed[place] else "passed"


def _says(named: CheckUnit, state: str, due_at: datetime, *, overdue: bool) -> str:
    due = f"The next check {'was' if overdue else 'is'} due {_when(due_at)}."
    if state == "passed":
        return f"Check unit {named.unit} passed when it was last on the rig. {due}"
    if state == "failed":
        return f"Check unit {named.unit} fails: the rig, or the unit, has changed since it last passed. {due}"
    return (
        f"Rig drift: not yet checked. Measure {named.unit} twice on this rig, and some units more than once, "
        f"which shows the effect of remounting. {due}"
    )


def _check(checked: _Checked, place: int) -> Document:
    row = checked.row(place)
    averages = [float(one.average[place]) for one in checked.figures]
    return {
        "run_id": row.run_id,
        "finished_at": row.finished_at,
        **{name: row.result[name] for name, _ in FIGURES},
        "is_check": place >= checked.from_place,
        "average": max(averages, key=abs) if averages and checked.known[place] else None,
        "verdict": _verdict(checked, place),
    }
