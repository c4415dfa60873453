"""Find runs by their verdict under today's limits, from the figures that are stored with each run's result.

`calrig.calibration.uncertainty.verdict` makes the verdict. It changes with the limits, so that no index can
hold it. Its `calrig.model.verdict.VerdictFigures` are written in the transaction that writes
the run's row, with the hash of the program text. Figures of another program text are ignored: such a run is
judged from its whole result until this program has written its figures.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from typing import Any, Literal, cast, get_args

import sqlalchemy
from sqlalchemy import Connection, event
from sqlmodel import Session, col, select

from calrig.calibration.uncertainty import answer_of, limit_for, verdict_figures
from calrig.model.result import Result
from calrig.model.verdict import Answer, Left, Limit, VerdictFigures
from calrig.program_text import sha256_of_program
from calrig.store.convert import run_of
from calrig.store.database import Repository
from calrig.store.limits import limits_of
from calrig.store.records import Run, how_judged
from calrig.store.runs import NEWEST_FIRST, Sought, older_than
from calrig.store.tables import RunTable, VerdictFiguresTable

Judged = Literal[Answer, "no_limits", Left]
"""A verdict's `answer`, or its `left`."""
LOOKED_AT = 20_000
"""Runs searched for one page: a quarter of a second."""
JUDGED_WHOLE = 200
"""Runs for one page whose figures another program text has written."""
AT_ONCE = 500
"""Rows read together."""
WRITTEN_AT_ONCE = 20
"""Runs in one transaction: other writers wait for it."""
_FOLLOWED = ("result", "diagnosis", "faults", "plan")
"""Columns that the figures follow from. Serial number, rig and limits are read when runs are searched."""
PROGRAM = sha256_of_program("calibration", "estimation", "model", "store/records.py", "store/verdicts.py")
"""Hash of the program text that computes the figures; taken at import, while the text is what runs."""
_KEPT = sqlalchemy.inspect(VerdictFiguresTable).local_table
_FIGURES = tuple(VerdictFigures.model_fields)


@dataclass(frozen=True, slots=True)
class RunPage:
    """A page of runs, with a verdict or all.

    Attributes:
        items: the runs, the newest first.
        next_cursor: for the next page; None after the last.
        back_to: creation time of the oldest run that was searched; None if there was none.
        judged_whole: ids of the runs that were judged from their whole result.
    """

    items: list[Run]
    next_cursor: str | None
    back_to: datetime | None
    judged_whole: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class RunAnswer:
    """What a run's verdict is in short, under today's limits."""

    answer: Answer | Literal["no_limits"]
    left: Left | None


class Verdicts(Repository):
    """Runs and their verdict under today's limits."""

    def answers(self, run_ids: Sequence[str]) -> tuple[dict[str, RunAnswer], list[str]]:
        """Return the verdicts of some runs by id, without those that cannot be judged.

        Also returns the ids of the runs that were judged from their whole result.
        """
        found: dict[str, RunAnswer] = {}
        whole: list[str] = []
        with self._database.reading() as session:
            limits = limits_of(session)
            of = cache(lambda unit, rig: limit_for(limits, unit, rig))
            for first in range(0, len(run_ids), AT_ONCE):
                some = col(RunTable.uid).in_(run_ids[first : first + AT_ONCE])
                judged = sqlalchemy.select(col(RunTable.uid), col(RunTable.unit), col(RunTable.rig), _KEPT)
                judged = judged.join(_KEPT, _KEPT.c.run_id == col(RunTable.id))
                for row in session.connection().execute(judged.where(some, _KEPT.c.program == PROGRAM)):
                    answer = answer_of(cast("VerdictFigures", row), of(row.unit, row.rig))
                    found[row.uid] = RunAnswer(answer, row.left)
                others = [one for one in run_ids[first : first + AT_ONCE] if one not in found]
                for run in session.exec(select(RunTable).where(col(RunTable.uid).in_(others))):
                    whole.append(run.uid)
                    figures = _figures_of(run)
                    if figures is not None:
                        answer = answer_of(figures, of(run.unit, run.rig))
                        found[run.uid] = RunAnswer(answer, figures.left)
        return found, whole

    def judged_runs(
        self, sought: Sought, judged: Judged, *, limit: int = 50, cursor: str | None = None
    ) -> RunPage:
        """Return a page of the runs with a verdict, as `Runs.search` does; a short page need not be the last.

        Raises:
            ValueError: as there.
        """
        with self._database.reading() as session:
            by_figures: list[int] = []
            to_judge: list[int] = []
            n_looked_at, last, more = 0, None, False
            is_it = _matching(judged, limits_of(session))
            for row in _narrow(session, sought, cursor):
                more = n_looked_at == LOOKED_AT or limit == len(by_figures) or len(to_judge) == JUDGED_WHOLE
                if more:
                    break
                n_looked_at, last = n_looked_at + 1, row.id
                if not row.is_of_today:
                    to_judge.append(row.id)
                elif is_it(row):
                    by_figures.append(row.id)
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
        return RunPage(found, next_cursor if more else None, back_to, whole)

    def judge(self, run_ids: Sequence[str]) -> None:
        """Write the figures of runs again by this program, `WRITTEN_AT_ONCE` in a transaction."""
        for first in range(0, len(run_ids), WRITTEN_AT_ONCE):
            some = col(RunTable.uid).in_(run_ids[first : first + WRITTEN_AT_ONCE])
            with self._database.writing() as session:
                for row in session.exec(select(RunTable).where(some)):
                    _keep(session.connection(), row)


def _has(run: Run, judged: Judged) -> bool:
    """Return whether a run with a result has the verdict, computed without its sentences."""
    assert run.result is not None  # noqa: S101 (others have no row here)
    found = verdict_figures(run.result, run.diagnosis, **how_judged(run.plan, run.faults))
    return judged in {answer_of(found, run.limit), found.left}


def _narrow(session: Session, sought: Sought, cursor: str | None) -> sqlalchemy.Result[Any]:
    """Select number, whether the figures are this program's, unit, rig and `_FIGURES` of judged runs."""
    wanted = (
        sqlalchemy.select(
            col(RunTable.id),
            (_KEPT.c.program == PROGRAM).label("is_of_today"),
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


def _matching(judged: Judged, limits: Sequence[Limit]) -> Callable[[sqlalchemy.Row[Any]], bool]:
    """Return a function that tests whether a row of `_narrow` has the verdict."""
    if judged in get_args(Left):
        return lambda row: bool(row.left == judged)
    of = cache(lambda unit, rig: limit_for(limits, unit, rig))
    # a row has the attributes of the figures; to make them for each of 20,000 rows takes longer than to test
    return lambda row: answer_of(cast("VerdictFigures", row), of(row.unit, row.rig)) == judged


def _keep(connection: Connection, run: RunTable) -> None:
    """Write a run's figures; for a result that cannot be judged, a row that is not computed."""
    connection.execute(sqlalchemy.delete(VerdictFiguresTable).where(_KEPT.c.run_id == run.id))
    if run.result is None:
        return
    found = _figures_of(run)
    values = {"program": ""} if found is None else {"program": PROGRAM, **found.model_dump()}
    connection.execute(sqlalchemy.insert(VerdictFiguresTable).values(run_id=run.id, **values))


def _figures_of(run: RunTable) -> VerdictFigures | None:
    """Return the figures of a run's result; None if it cannot be judged."""
    try:
        result = Result.model_validate(run.result)
        found = verdict_figures(result, run.diagnosis, **how_judged(run.plan, run.faults))
    except (KeyError, TypeError, ValueError, ArithmeticError):  # written by another program
        return None
    numbers = (value for value in found.model_dump().values() if isinstance(value, float))
    return found if all(map(math.isfinite, numbers)) else None


@event.listens_for(RunTable, "after_insert")
def _inserted(_mapper: object, connection: Connection, run: RunTable) -> None:
    if run.result is not None:
        _keep(connection, run)


@event.listens_for(RunTable, "after_update")
def _updated(_mapper: object, connection: Connection, run: RunTable) -> None:
    changed = [name for name in _FOLLOWED if sqlalchemy.inspect(run).attrs[name].history.has_changes()]
    if changed and (run.result is not None or "result" in changed):
        _keep(connection, run)
