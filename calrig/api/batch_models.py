"""What the API takes and gives of lists of units."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from calrig.api.models import Answer, Body, MountAnswer, ProgressAnswer, Status
from calrig.plan import Plan
from calrig.runs.batch_serials import serials_in

LONGEST_CSV = 200_000
Serials = Annotated[list[Annotated[str, Field(max_length=1000)]], Field(max_length=10_000)]


class UnitsBody(Body):
    """Serials, one an entry, or a CSV: its column `unit` or `serial`, else its first."""

    units: Serials = Field(default_factory=list)
    csv: Annotated[str, Field(max_length=LONGEST_CSV)] | None = None

    def serials(self) -> list[str]:
        """All of them, in order."""
        return [*self.units, *(serials_in(self.csv)[0] if self.csv else ())]


class Table(Body):
    """A CSV."""

    csv: Annotated[str, Field(max_length=LONGEST_CSV)]


class SerialsAnswer(Answer):
    """The serials of a CSV as they stand there, and how many of its rows have none."""

    units: list[str]
    left_out: int


class MakeBatch(UnitsBody):
    """A list: its units, the rigs side by side that they go to (without any, the first), and how."""

    rigs: Annotated[list[str], Field(max_length=50)] | None = None
    plan: Plan = Plan()
    operator: Annotated[str, Field(max_length=200)] | None = None
    note: Annotated[str, Field(max_length=10_000)] | None = None
    failed: Literal["end", "follow_up"] = Field(
        default="end",
        description="A unit that fails gets another turn at the end, or at once the run that tells why.",
    )


class NameUnit(Body):
    """A unit of the list."""

    unit: str


class StartTurn(Body):
    """What a person has mounted, and where."""

    rig: str
    unit: str
    stage_at_deg: Annotated[float, Field(ge=-360, le=360)] | None = None


class TurnAnswer(Answer):
    """A unit's turn. `word`: pass or fail by its limits, `done` without any; null before it was measured."""

    position: int
    unit: str
    state: Literal["waiting", "follow_up", "running", "done", "failed", "removed"]
    rig: str | None
    run_id: str | None
    word: Literal["pass", "fail", "done"] | None
    why: str | None


class SeenAnswer(Answer):
    """What was seen of the unit on a rig while nobody uses it.

    `absent`: no board answers; `wrong`: the board says another serial; `askew`: gravity contradicts.
    """

    state: Literal["looking", "absent", "moving", "askew", "wrong", "there"]
    serial: str | None = Field(description="By the board's own word; empty where it has none.")
    says: str


class BatchRigAnswer(Answer):
    """A rig of the list. `on` is under way or to be mounted, `next` comes then, `last` ended last.

    `seen` tells of the unit that `on` waits for; null while nobody has asked for a look.
    """

    name: str
    state: Literal["idle", "busy", "unreachable", "offline"]
    busy_with: str | None
    on: TurnAnswer | None
    status: Status | None = Field(description="Of the run under way.")
    progress: ProgressAnswer | None
    waiting_for: MountAnswer | None
    seen: SeenAnswer | None
    next: TurnAnswer | None
    last: TurnAnswer | None
    last_says: list[str]
    designing: bool = Field(description="Whether the run that tells why is diagnosed for and designed now.")
    nothing_measured: bool = Field(description="By the run that `on` had here after that of `last`.")


class LookAnswer(Answer):
    """The rigs of a list as they stand."""

    rigs: list[BatchRigAnswer]


class BatchAnswer(Answer):
    """A list as it stands."""

    id: str
    created_at: datetime
    closed_at: datetime | None
    plan: Plan
    operator: str | None
    note: str | None
    failed: Literal["end", "follow_up"]
    rigs: list[BatchRigAnswer]
    units: list[TurnAnswer]
    known: list[str] = Field(description="Of units just added, those that the list had already.")


class ListedBatch(Answer):
    """A list among the others; `takes_units` is false of one that is closed, or of another day."""

    id: str
    created_at: datetime
    closed_at: datetime | None
    rigs: list[str]
    operator: str | None
    note: str | None
    takes_units: bool
