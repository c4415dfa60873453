"""A follow-up while it runs: it stops deciding once the suspects are apart, then diagnoses all runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from calrig.calibration.diagnosis import trace
from calrig.calibration.pose import Pose
from calrig.calibration.responses import DiagnosisError
from calrig.calibration.search import Findings
from calrig.calibration.sprt import SequentialTest
from calrig.plan import Plan, PlannedPose


@dataclass
class FollowUpRun:
    """What a follow-up knows of the runs it follows on.

    Attributes:
        run_ids, runs: the earlier runs and their poses.
        findings: of their diagnosis, which left something ambiguous.
        separates: names of the suspects.
        deciding: how many poses of a sweep, its first, are there to decide; the others confirm.
        decided_on: indices of the measured poses that served to decide.
    """

    run_ids: Sequence[str]
    runs: Sequence[Sequence[Pose]]
    findings: Findings
    separates: Sequence[str]
    deciding: int
    plan: Plan
    limits_deg: tuple[float, float]
    decided_on: list[int] = field(default_factory=list)
    _decided: bool = False

    def __post_init__(self) -> None:
        self._test = SequentialTest(self.runs, self.findings)
        self._of_a_sweep = len(self.plan.elevations())

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
        try:
            return trace(
                [*self.runs, measured],
                [*self.run_ids, run_id],
                plan=self.plan.model_dump(mode="json"),
                limits_deg=self.limits_deg,
                deciding=self.decided_on,
            )
        except DiagnosisError:
            return None  # asking for it later says why
