"""The estimate of a plan on a rig, and the design of a plan (CONTRACT section 9)."""

from pydantic import Field

from calrig.model.base import Model


class Estimate(Model):
    """`elevations_deg` are those of one sweep; a static log has no poses."""

    n_poses: int
    elevations_deg: list[float]
    duration_s: float = Field(description="About, by the board's clock; without a wait for a temperature.")
    wall_s: float = Field(description="The same by the wall clock, at the pace of the rig's last runs.")
    warnings: list[str] = Field(description="What is known to fail before the run has begun, in sentences.")


class Expected(Model):
    """Expected by the noise and the pace of the rig; where the plan may end early, when it probably does."""

    duration_s: float
    expanded_uncertainty_deg: float | None
    bias_std_deg: float
    scale_std: float


class DurationLimit(Model):
    """The lower bound of the duration of any plan; without `sweep`, of any plan of dwells.

    Where a time was given: of any plan that reaches as small an uncertainty as this one.
    """

    duration_s: float
    why: str


class SmallestDetected(Model):
    """The smallest effect detected with a power of 80 %; null where no size of it would be.

    `rms_deg` is its residual in calibrated readings; `value` its parameter, where it has only one.
    """

    name: str
    title: str
    rms_deg: float | None
    parameter: str | None
    unit: str | None
    value: float | None


class Design(Model):
    """What to expect of a designed plan, and its distance to the best possible one."""

    expected: Expected
    limit: DurationLimit
    suspects: list[SmallestDetected]
    says: list[str]
