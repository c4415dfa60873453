"""Bodies and answers of the API, exactly CONTRACT section 2: the OpenAPI document is made from these."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from calrig.model.base import Model
from calrig.model.plan import Plan
from calrig.model.run import PoseColumns, Run
from calrig.model.verdict import Verdict


class Body(BaseModel):
    """What a client sends: a field nobody knows is a mistake, and said to be one."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="after")
    @classmethod
    def _has_no_nul(cls, value: Any) -> Any:
        """SQLite would keep one and PostgreSQL would not: no store could be moved that has any."""
        if isinstance(value, str) and "\0" in value:
            raise ValueError("has a NUL character in it, which is no text")
        return value


StageAt = Annotated[
    Annotated[float, Field(ge=-360, le=360)] | None,
    Field(description="Elevation at which a stage without homing stands, by the word of who looked."),
]


class ResumeRun(Body):
    """How a run goes on. `stage_at_deg` is for an interrupted run on a stage without homing."""

    stage_at_deg: StageAt = None


class StartRun(Body):
    """A run to start. Without `rig`, the first one configured."""

    unit: str
    rig: str | None = None
    plan: Plan = Plan()
    operator: Annotated[str, Field(max_length=200)] | None = None
    note: Annotated[str, Field(max_length=10_000)] | None = None
    stage_at_deg: StageAt = None
    queue: bool = Field(
        default=False,
        description="Whether it waits its turn where the rig is busy or, at a centre, its bench away.",
    )


class Reason(Body):
    """Why something is done: it stays with what is done."""

    reason: str


class ReasonIfAny(Body):
    """The same, where what is done may say enough."""

    reason: str | None = None


class Problem(Model):
    """Every error; the header `Calrig-Fields` names places in the body: `plan.elevations_deg[1]`."""

    detail: str


class Health(Model):
    """The service answers."""

    status: Literal["ok"]
    version: str


class RunAnswer(Run):
    """A run. `plan` is null for an imported one; `voided` is null for one that counts."""

    plan: Plan | None
    verdict: Verdict | None


class RunList(Model):
    """One page of runs, newest first; `next_cursor` asks for the next one and is null on the last."""

    items: list[RunAnswer]
    next_cursor: str | None


class PoseAnswer(PoseColumns):
    """A pose: CONTRACT section 4's columns, covariates beside them, and whether it counts."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float | None]

    index: int
    excluded: str | None = Field(description="Why the pose does not count; null where it does.")
    sweep: int | None = Field(alias="pass")
    approach: Literal[-1, 0, 1] | None
    gyro_x_dps: float | None = Field(description="Mean over the dwell, as of the other two axes.")
    gyro_y_dps: float | None
    gyro_z_dps: float | None
    mount: str = Field(description="Poses that share it were taken without the unit being touched.")
    mount_deg: float = Field(description="The angle at which the unit was clamped, nominally.")
    mount_axis: str = Field(description="Which of the unit's axes lay along the stage's.")
    raw_error_deg: float = Field(description="Reading less the elevation it was taken at.")
    residual_deg: float | None = Field(
        description="As the verdict judges it; `fit=plain`: by bias and scale."
    )
