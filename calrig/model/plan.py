"""What a run is to do: the plan as a person or program writes it, and the poses that follow from it."""

import math
import random
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

MAX_POSES = 10_000
"""More than a day of dwells: beyond it a plan is a slip of the keyboard."""

FEWEST_UNTIL = 8
"""Poses that a run takes in any case."""
MOST_MOUNTS = 36
"""As often does nobody turn a unit by hand in one run."""
LARGEST_JITTER_DEG = 45.0
SAME_MOUNT_DEG = 1e-6
LONGEST_STRETCH_DEG = 20.0
"""Of a turn that is taken for one pose: an error of 1° that goes with sin θ bends by 0.005° over it."""
FIRST_SETTLE_S = 3.0
"""Before the first dwell of a sweep, to which the stage comes as fast as it can: after so long the filter has
forgotten what a gyro wrong by 1 % made of 60°, to 0.0001°. The moves into the others are slow and known."""
SHORTEST_STRETCH_S = 0.5
"""A standard error from less is itself a guess."""

ElevationDeg = Annotated[float, Field(ge=-360, le=360)]
MountAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
"""Which of the unit's axes lies along the stage's."""


CALIBRATING = ("calibration", "sweep")
"""Kinds of plans whose runs give a calibration of their unit."""


class PlanError(ValueError):
    """The plan cannot be carried out on this rig; the message says which elevation and which limit."""


@dataclass(frozen=True, slots=True)
class PlannedPose:
    """One pose to visit: its index in the run from 0, its sweep from 0, its commanded angle of the dial.

    `mount_deg` is the angle at which the unit is clamped for it. Of a sweep that does not stop, a pose may be
    a stretch: `stretch_deg` are its two ends in the order turned, and the target is its middle.
    """

    index: int
    sweep: int
    target_deg: float
    mount_deg: float = 0.0
    stretch_deg: tuple[float, float] | None = None


class Until(BaseModel):
    """What a run is to reach and ends at (CONTRACT section 9); null where it does not matter."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    TITLES: ClassVar = {"expanded_uncertainty_deg": "Stop at expanded uncertainty"}

    bias_std_deg: float | None = Field(default=None, gt=0, le=90)
    scale_std: float | None = Field(default=None, gt=0, le=10)
    expanded_uncertainty_deg: float | None = Field(default=None, gt=0, le=90)

    @model_validator(mode="after")
    def _names_something(self) -> Self:
        if (self.bias_std_deg, self.scale_std, self.expanded_uncertainty_deg) == (None, None, None):
            raise ValueError("until names what is to be reached: at least one of its three")
        return self


class Plan(BaseModel):
    """A run's plan (CONTRACT section 2). Angles in degrees, times in seconds of the board's clock."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    TITLES: ClassVar = {
        "start_deg": "From",
        "stop_deg": "To",
        "step_deg": "Step",
        "elevations_deg": "Elevations",
        "mounts_deg": "Mounting angles",
        "mount_axis": "Unit axis along stage axis",
        "order": "Order",
        "sweeps": "Sweeps",
        "settle_s": "Settling time",
        "dwell_s": "Dwell time",
        "jitter_deg": "Jitter",
        "rate_hz": "Sample rate",
        "target_std_deg": "Dwell until standard error",
        "velocity_dps": "Stage velocity",
        "wait_s": "Wait before each sweep",
        "wait_temperature_c": "Wait for temperature",
        "seed": "Seed",
    }
    """What the page calls its fields."""

    kind: Literal["calibration", "verification", "static", "sweep"] = "calibration"
    elevations_deg: list[ElevationDeg] | None = Field(default=None, min_length=1, max_length=MAX_POSES)
    start_deg: ElevationDeg = -60.0
    stop_deg: ElevationDeg = 60.0
    step_deg: float = Field(default=10.0, gt=0, le=360)
    sweeps: int = Field(default=4, ge=1, le=MAX_POSES)
    order: Literal["sweep", "random", "given"] = "sweep"
    jitter_deg: float = Field(default=0.0, ge=0, le=LARGEST_JITTER_DEG)
    settle_s: float = Field(default=1.0, ge=0, le=3600)
    dwell_s: float = Field(default=2.0, gt=0, le=86_400)
    rate_hz: int = Field(default=200, ge=1, le=8000)
    target_std_deg: float | None = Field(default=None, gt=0, le=90)
    velocity_dps: float | None = Field(default=None, gt=0, le=1000)
    wait_s: float = Field(default=0.0, ge=0, le=86_400)
    wait_temperature_c: float | None = Field(default=None, ge=-40, le=125)
    mounts_deg: list[ElevationDeg] = Field(default=[0.0], min_length=1, max_length=MOST_MOUNTS)
    mount_axis: MountAxis = "x"
    until: Until | None = None
    revision: int | None = Field(default=None, ge=1, le=2**31 - 1)
    seed: int = Field(default=0, ge=0, le=2**63 - 1)

    @model_validator(mode="before")
    @classmethod
    def _mounts_are_jittered(cls, plan: Any) -> Any:
        """Jitter a grid of several mounts by half a step, unless the plan states a jitter.

        The map of the stage is known at the angles that poses visit; less leaves parts of the dial unvisited.
        """
        if not isinstance(plan, dict) or "jitter_deg" in plan or plan.get("elevations_deg") is not None:
            return plan
        mounts_deg, kind = plan.get("mounts_deg"), plan.get("kind")
        if not isinstance(mounts_deg, list | tuple) or len(mounts_deg) < 2 or kind in ("static", "sweep"):
            return plan
        try:
            step_deg = float(plan.get("step_deg", cls.model_fields["step_deg"].default))
        except (TypeError, ValueError):  # its own validation says so
            return plan
        if not step_deg > 0.0:
            return plan
        return {**plan, "jitter_deg": min(step_deg / 2.0, LARGEST_JITTER_DEG)}

    @field_validator("mounts_deg")
    @classmethod
    def _mounts_are_apart(cls, mounts_deg: list[float]) -> list[float]:
        for one, other in combinations(mounts_deg, 2):
            if abs(math.remainder(other - one, 360.0)) < SAME_MOUNT_DEG:
                raise ValueError(f"{one:g}° and {other:g}° are one mount: a whole turn is none")
        return mounts_deg

    @model_validator(mode="after")
    def _is_of_a_size_one_can_run(self) -> Self:
        count = self._n_poses()
        if count > MAX_POSES:
            raise ValueError(f"the plan has {count} poses; the most a run takes is {MAX_POSES}")
        if self.revision is not None and self.kind != "verification":
            raise ValueError("only a verification applies a revision")
        if self.kind == "static" and len(self.elevations_deg or ()) > 1:
            raise ValueError(
                "a static plan stands at one elevation, or where the stage stands if it names none"
            )
        if self.kind == "static" and len(self.mounts_deg) > 1:
            raise ValueError("a static plan stands still: it has one mount")
        if self.kind == "verification" and self.mount_axis != "x":
            raise ValueError("a verification is of elevations about x: its mount_axis is x")
        if self.kind == "sweep":
            self._can_be_swept()
        if self.until is not None:
            self._can_end_early(count)
        if self.dwell_s * self.rate_hz < 2:
            raise ValueError(
                f"a dwell of {self.dwell_s:g} s at {self.rate_hz} Hz holds fewer than two samples: "
                "dwell longer or sample faster"
            )
        return self

    def _can_be_swept(self) -> None:
        """A sweep goes there and back between two ends; whatever it cannot do it says."""
        if self.elevations_deg is not None or self.order != "sweep" or self.target_std_deg is not None:
            raise ValueError(
                "a sweep turns from start_deg to stop_deg without stopping: it takes no elevations_deg, no "
                "other order, no target_std_deg"
            )
        if self.asks_for_mounts:
            raise ValueError("a sweep is of one mount, 0, about x")
        if self.sweeps < 2:
            raise ValueError("a sweep goes through the range in both directions: sweeps is 2 or more")
        if self._n_steps() < 2 or self.step_deg > LONGEST_STRETCH_DEG:
            raise ValueError(
                f"a sweep has stretches of step_deg, two or more, none longer than {LONGEST_STRETCH_DEG:g}°"
            )
        if self.jitter_deg > self._stretch_deg() / 4:
            raise ValueError("the jitter of a sweep is of its stretches' ends: a quarter of one at most")
        if self._stretch_deg() / self.turn_dps < SHORTEST_STRETCH_S:
            raise ValueError(
                f"stretches of {self._stretch_deg():g}° at {self.turn_dps:g}°/s are shorter than "
                f"{SHORTEST_STRETCH_S:g} s: turn slower"
            )

    def _can_end_early(self, count: int) -> None:
        if self.kind not in ("calibration", "sweep") or len(self.mounts_deg) > 1 or self.mount_axis != "x":
            raise ValueError("until is for calibrations of one mount about x")
        if count < FEWEST_UNTIL or len(set(self.elevations())) == 1:
            raise ValueError(f"until is for plans of {FEWEST_UNTIL} poses and more, at several elevations")

    @property
    def asks_for_mounts(self) -> bool:
        """Whether gravity is to show how the unit is clamped; a plan that says nothing asks nothing."""
        return self.mounts_deg != [0.0] or self.mount_axis != "x"

    @property
    def turn_dps(self) -> float:
        """The velocity of a sweep: without one given, a stretch takes as long as a dwell."""
        return self.velocity_dps or self.step_deg / self.dwell_s

    @property
    def first_settle_s(self) -> float:
        """Before the first dwell."""
        return max(self.settle_s, FIRST_SETTLE_S) if self.kind == "sweep" else self.settle_s

    def _stretch_deg(self) -> float:
        return abs(self.stop_deg - self.start_deg) / self._n_steps()

    def _n_poses(self) -> int:
        if self.kind == "sweep":
            return 1 + self.sweeps * (self._n_steps() + 1)
        n_elevations = self._n_steps() + 1 if self.elevations_deg is None else len(self.elevations_deg)
        return len(self.mounts_deg) * self.sweeps * n_elevations

    def _n_steps(self) -> int:
        """Steps from start to stop, the last one shorter where the way is no whole number of them."""
        way_deg = abs(self.stop_deg - self.start_deg)
        steps = math.ceil(min(way_deg / self.step_deg, 1e9) - 1e-9)  # 0.3/0.1 is a hair above or below 3
        return max(steps, int(way_deg > 0))

    def elevations(self) -> list[float]:
        """The elevations of one sweep in degrees, as given, or the grid with both of its ends.

        Of a sweep that does not stop, those are the ends of its stretches.
        """
        if self.elevations_deg is not None:
            return list(self.elevations_deg)
        if self.kind == "sweep":  # stretches of one length: of a short one no more than noise is left
            way_deg = (self.stop_deg - self.start_deg) / self._n_steps()
            return [*(self.start_deg + k * way_deg for k in range(self._n_steps())), self.stop_deg]
        step_deg = math.copysign(self.step_deg, self.stop_deg - self.start_deg)
        return [*(self.start_deg + k * step_deg for k in range(self._n_steps())), self.stop_deg]

    def poses(self, limits_deg: tuple[float, float]) -> list[PlannedPose]:
        """Every pose in the order measured, mount by mount, jittered by the plan's own seed.

        Sweeps are counted through; each mount begins with one upward. Of a static plan, the one elevation it
        names to stand at, or none.

        Args:
            limits_deg: the rig's soft limits of elevation, lower then upper.

        Raises:
            PlanError: an elevation lies beyond the limits.
        """
        low, high = limits_deg
        elevations = self.elevations() if self.kind != "static" else self.elevations_deg or []
        for elevation in elevations:
            if not low <= elevation <= high:
                raise PlanError(
                    f"elevation {elevation:g}° is beyond the rig's soft limits {low:g}° to {high:g}°; "
                    "nothing was moved"
                )
        rng = random.Random(self.seed)  # noqa: S311 (an experiment's order, not a secret)
        if self.kind == "sweep":
            return self._swept(elevations, rng)
        poses: list[PlannedPose] = []
        sweeps = self.sweeps if self.kind != "static" else 1
        for place, mount_deg in enumerate(self.mounts_deg):
            for sweep in range(sweeps):
                for elevation in self._ordered(elevations, sweep, rng):
                    jittered = round(elevation + rng.uniform(-self.jitter_deg, self.jitter_deg), 6)
                    target = min(max(jittered, low), high) if self.jitter_deg else elevation
                    poses.append(PlannedPose(len(poses), place * sweeps + sweep, target, mount_deg))
        return poses

    def _swept(self, ends_deg: list[float], rng: random.Random) -> list[PlannedPose]:
        """A dwell, and of each pass its stretches and the dwell at its end; inner ends are jittered."""
        poses = [PlannedPose(0, 0, ends_deg[0])]
        for sweep in range(self.sweeps):
            first, *inner, last = ends_deg if sweep % 2 == 0 else ends_deg[::-1]
            inner = [round(one + rng.uniform(-self.jitter_deg, self.jitter_deg), 6) for one in inner]
            for ends in pairwise([first, *inner, last]):
                poses.append(PlannedPose(len(poses), sweep, sum(ends) / 2, stretch_deg=ends))
            poses.append(PlannedPose(len(poses), sweep, last))
        return poses

    def _ordered(self, elevations: list[float], sweep: int, rng: random.Random) -> list[float]:
        if self.order == "given":
            return elevations
        if self.order == "random":
            return rng.sample(elevations, len(elevations))
        return sorted(elevations, reverse=sweep % 2 == 1)
