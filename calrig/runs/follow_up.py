"""A follow-up while it runs: it stops deciding once the suspects are apart, then diagnoses all runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from calrig.analysis.errors import Conflict
from calrig.analysis.unresolved import Unresolved
from calrig.calibration.diagnosis import trace
from calrig.calibration.experiment_design import design
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.sprt import SequentialTest
from calrig.plan import Plan, PlannedPose
from calrig.processes.pool import Apart, WorkError, run_apart
from calrig.store import Run


@dataclass
class FollowUpRun:
    """A follow-up and the runs it follows on.

    Attributes:
        earlier: the runs, whose diagnosis left something ambiguous.
        separates: names of the suspects.
        deciding: how many poses of a sweep, its first, are there to decide; the others confirm.
        plan: of the follow-up.
        limits_deg: soft limits of the rig.
        decided_on: indices of the measured poses that served to decide.
    """

    earlier: Unresolved
    separates: Sequence[str]
    deciding: int
    plan: Plan
    limits_deg: tuple[float, float]
    decided_on: list[int] = field(default_factory=list)
    _decided: bool = False

    def __post_init__(self) -> None:
        self._test = SequentialTest(self.earlier.poses, self.earlier.findings)
        self._of_a_sweep = len(self.plan.elevations())

    @classmethod
    def designed(
        cls, earlier: Unresolved, last: Run, limits_deg: tuple[float, float], apart: Apart = run_apart
    ) -> FollowUpRun:
        """The follow-up that best separates the suspects on a rig; `last` is the latest of the earlier runs.

        Raises:
            Conflict: no run within these limits would, and why.
        """
        found = apart(partial(design, earlier.poses, earlier.findings, limits_deg))
        if isinstance(found, str):
            raise Conflict(f"run {last.id}: {found}")
        plan = Plan.model_validate(found.document(last.plan or {})["plan"])
        return cls(earlier, found.separates, found.deciding, plan, limits_deg)

    def skips(self, planned: PlannedPose, measured: Sequence[Pose]) -> bool:
        """Whether a planned pose need not be measured: it was to decide, and that has been done."""
        if planned.index % self._of_a_sweep >= self.deciding:
            return False
        if not self._decided:
            self._decided = self._test.decided([measured[k] for k in self.decided_on])
        if not self._decided:
            self.decided_on.append(len(measured))
        return self._decided

    def provenance(self) -> dict[str, Any]:
        """What is kept with the run."""
        return {
            "separates": list(self.separates),
            "deciding": self.deciding,
            "decided_on": self.decided_on,
            "decided_early": self._decided,
        }

    def diagnosis(self, run_id: str, measured: Sequence[Pose]) -> dict[str, Any] | None:
        """The diagnosis of all runs together, confirmed on the poses that did not serve to decide."""
        question = partial(
            trace,
            [*self.earlier.poses, measured],
            [*self.earlier.run_ids, run_id],
            plan=self.plan.model_dump(mode="json"),
            limits_deg=self.limits_deg,
            deciding=self.decided_on,
        )
        try:
            return run_apart(question)
        except (DiagnosisError, WorkError):
            return None  # asking for it later says why
