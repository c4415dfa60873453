"""Runs found by their verdict of today, from a few numbers that are kept beside each run's result.

A verdict follows the limits of today, and so stands in no index. What it follows from on the run's side is
written in the transaction that writes the run's row, whoever does. It says which program text it is of: what
another one wrote is not looked at, and the run is judged whole until this one has written it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from functools import cache
from typing import Any, Literal, get_args

import sqlalchemy
from sqlalchemy import Connection, event
from sqlmodel import Session, col, select

from calrig.calibration.uncertainty import limit_for
from calrig.calibration.verdict import VerdictFigures, verdict_figures
from calrig.model.result import Result
from calrig.model.verdict import Left, Limit
from calrig.program_text import sha256_of_program
from calrig.store.convert import run_of
from calrig.store.database import Repository
from calrig.store.limits import limits_of
from calrig.store.records import Run, how_judged
from calrig.store.runs import NEWEST_FIRST, Sought, older_than
from calrig.store.tables import RunTable, VerdictFiguresTable

Judged = Literal[
    "pass",
    "conditional_pass",
    "conditional_fail",
    "fail",
    "undecided",
    "no_limits",
    "noise",
    "more_than_noise",
]
"""A verdict's `answer`, or its `left`."""
LOOKED_AT = 20_000
"""Runs for one page: a quarter of a second."""
JUDGED_WHOLE = 200
"""Runs for one page that another program has judged last."""
AT_ONCE = 500
"""Rows that are read together."""
WRITTEN_AT_ONCE = 20
"""Runs in one transaction: others wait for their turn to write meanwhile."""
_FOLLOWED = ("result", "diagnosis", "faults", "plan")
"""Columns that a verdict follows from; serial number, rig and limits are looked at when it is sought."""
PROGRAM = sha256_of_program("calibration", "estimation", "model", "store/records.py", "store/verdicts.py")
"""What decides what a verdict follows from and what is kept of it; read now, while it is what runs."""
_KEPT = sqlalchemy.inspect(VerdictFiguresTable).local_table
_FIGURES = tuple(one.name for one in fields(VerdictFigures))


@dataclass(frozen=True, slots=True)
class JudgedRuns:
    """A page of runs with a verdict.

    Attributes:
        items: the newest first.
        next_cursor: of the next page; None after the last.
        back_to: when the oldest run was made that was looked at; None where there was none.
        judged_whole: ids of those that another program has judged last.
    """

    items: list[Run]
    next_cursor: str | None
    back_to: datetime | None
    judged_whole: list[str]


class Verdicts(Repository):
    """Runs by what the limits of today say of them."""

    def judged_runs(
        self, sought: Sought, judged: Judged, *, limit: int = 50, cursor: str | None = None
    ) -> JudgedRuns:
        """A page of the runs with a verdict, as of `sought_runs`; a short one need not be the last.

        Raises:
            ValueError: as there.
        """
        with self._database.reading() as session:
            by_figures: list[int] = []
            to_judge: list[int] = []
            n_looked_at, last, more = 0, None, False
            is_it = _matching(judged, limits_of(session))
            for number, of_today, *row in map(tuple, _narrow(session, sought, cursor)):
                more = n_looked_at == LOOKED_AT or limit == len(by_figures) or len(to_judge) == JUDGED_WHOLE
                if more:
                    break
                n_looked_at, last = n_looked_at + 1, number
                if not of_today:
                    to_judge.append(number)
                elif is_it(*row):
                    by_figures.append(number)
            wanted = select(RunTable).where(col(RunTable.id).in_([*by_figures, *to_judge]))
            runs = {row.id: run_of(row) for row in session.exec(wanted.order_by(*NEWEST_FIRST))}
            end = None if last is None else session.get_one(RunTable, last)
            back = None if end is None else (end.uid, end.created_at)
        found = [run for run in runs.values() if _has(run, judged)]
        if len(found) > limit:
            found, more = found[:limit], True
            back = found[-1].id, found[-1].created_at
        next_cursor, back_to = back or (None, None)
        whole = [runs[number].id for number in to_judge]
        return JudgedRuns(found, next_cursor if more else None, back_to, whole)

    def judge(self, run_ids: Sequence[str]) -> None:
        """Writes what the verdicts of runs follow from anew, by this program, some at a time."""
        for first in range(0, len(run_ids), WRITTEN_AT_ONCE):
            some = col(RunTable.uid).in_(run_ids[first : first + WRITTEN_AT_ONCE])
            with self._database.writing() as session:
                for row in session.exec(select(RunTable).where(some)):
                    _keep(session.connection(), row)


def _has(run: Run, judged: Judged) -> bool:
    """Whether a run with a result has the verdict, by the rules that make it and without its words."""
    assert run.result is not None  # noqa: S101 (others have no row here)
    found = verdict_figures(run.result, run.diagnosis, **how_judged(run.plan, run.faults))
    return judged in {found.answer(run.limit), found.left}


def _narrow(session: Session, sought: Sought, cursor: str | None) -> sqlalchemy.Result[Any]:
    """Of each run with a result its number, whether its figures are this program's, unit, rig, and they."""
    wanted = (
        sqlalchemy.select(
            col(RunTable.id),
            _KEPT.c.program == PROGRAM,
            col(RunTable.unit),
            col(RunTable.rig),
            *(_KEPT.c[name] for name in _FIGURES),
        )
        .join(_KEPT, _KEPT.c.run_id == col(RunTable.id))
        .where(*sought.conditions(), *older_than(session, cursor))
        .order_by(*NEWEST_FIRST)
        .limit(LOOKED_AT + 1)
        .execution_options(yield_per=AT_ONCE)
    )
    return session.connection().execute(wanted)


def _matching(judged: Judged, limits: Sequence[Limit]) -> Callable[..., bool]:
    """Tells of a unit, a rig and figures whether they have the verdict."""
    if judged in get_args(Left):
        return lambda _unit, _rig, left, *_: bool(left == judged)
    of = cache(lambda unit, rig: limit_for(limits, unit, rig))
    return lambda unit, rig, *figures: VerdictFigures(*figures).answer(of(unit, rig)) == judged


def _keep(connection: Connection, run: RunTable) -> None:
    """Writes what a run's verdict follows from; of a result that cannot be judged, that it is to be."""
    connection.execute(sqlalchemy.delete(VerdictFiguresTable).where(_KEPT.c.run_id == run.id))
    if run.result is None:
        return
    try:
        found = asdict(
            verdict_figures(
                Result.model_validate(run.result), run.diagnosis, **how_judged(run.plan, run.faults)
            )
        )
        is_sound = all(math.isfinite(value) for value in found.values() if isinstance(value, float))
    except (KeyError, TypeError, ValueError, ArithmeticError):  # of somebody else's making
        found, is_sound = {}, False
    values = {"program": PROGRAM, **found} if is_sound else {"program": ""}
    connection.execute(sqlalchemy.insert(VerdictFiguresTable).values(run_id=run.id, **values))


@event.listens_for(RunTable, "after_insert")
def _inserted(_mapper: object, connection: Connection, run: RunTable) -> None:
    if run.result is not None:
        _keep(connection, run)


@event.listens_for(RunTable, "after_update")
def _updated(_mapper: object, connection: Connection, run: RunTable) -> None:
    changed = [name for name in _FOLLOWED if sqlalchemy.inspect(run).attrs[name].history.has_changes()]
    if changed and (run.result is not None or "result" in changed):
        _keep(connection, run)
