"""Answers of the service, typed: the classes of `calrig.model`, and those that only the client has.

Units are in the names; what is not known is None. Fields that a newer service adds are kept as attributes.
"""

from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from calrig.client.errors import Unreachable
from calrig.model.base import Model
from calrig.model.plan_design import Design
from calrig.model.run import AT_REST, Run
from calrig.model.verdict import Verdict

M = TypeVar("M", bound=BaseModel)


def typed(kind: type[M], answer: object) -> M:
    """Return an answer as an object of its class.

    Raises:
        Unreachable: it is not an answer of calrig.
    """
    try:
        return kind.model_validate(answer, extra="allow")
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise Unreachable(f"the service answers, and not as calrig does ({place}: {first['msg']})") from error


def each(kind: type[M], answer: object) -> list[M]:
    """Return a list of answers as objects of their class; Unreachable where it is no list."""
    if not isinstance(answer, list):
        raise Unreachable("the service answers, and not as calrig does (no list)")
    return [typed(kind, one) for one in answer]


class RunRecord(Run):
    """A run as the service has it."""

    plan: dict[str, Any] | None
    verdict: Verdict | None


class RunEvent(Model):
    """An event of a run; `id` counts up from 1 in a run's log.

    `data`: of `state` {"status", "error"}, of `progress` a `Progress`, of `pose` a pose with its `index`, of
    `reading` {"time_s", "stage_deg", "reading_deg", "temperature_c"}.
    """

    id: int
    type: str
    data: dict[str, Any]

    @property
    def is_last(self) -> bool:
        """Whether the run has ended or was interrupted; resuming it adds further events."""
        return self.type == "state" and self.data["status"] in AT_REST


class PlanDesign(Design):
    """A designed plan, ready for `Client.calibrate`, and what to expect of it."""

    plan: dict[str, Any]
