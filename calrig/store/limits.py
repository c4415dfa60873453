"""Limits, in the order in which they are matched."""

from collections.abc import Sequence

from sqlmodel import Session, col, delete, select

from calrig.model.verdict import Limit
from calrig.store.database import Repository
from calrig.store.tables import LimitTable
from calrig.store.trail import Act, append

_IN_THIS_SESSION = "limits"


class Limits(Repository):
    """What units are held against."""

    def all(self) -> list[Limit]:
        """All of them; the first that matches a unit counts."""
        with self._database.reading() as session:
            return list(limits_of(session))

    def replace(self, limits: Sequence[Limit], *, who: str | None, reason: str | None = None) -> None:
        """Puts others in their place, and into the trail where they differ."""
        with self._database.writing() as session:
            before = limits_of(session)
            then, now = ([one.model_dump(mode="json") for one in some] for some in (before, limits))
            if then == now:
                return
            session.exec(delete(LimitTable))
            session.add_all(
                LimitTable(position=place, name=document["name"], document=document)
                for place, document in enumerate(now)
            )
            detail = {"before": then, "now": now}
            append(session, Act("limits_changed", who=who, reason=reason, detail=detail))


def limits_of(session: Session) -> tuple[Limit, ...]:
    """The limits that a session sees; read once, for a page of runs asks for every run."""
    known: tuple[Limit, ...] | None = session.info.get(_IN_THIS_SESSION)
    if known is None:
        rows = session.exec(select(LimitTable).order_by(col(LimitTable.position)))
        known = session.info[_IN_THIS_SESSION] = tuple(Limit.model_validate(row.document) for row in rows)
    return known
