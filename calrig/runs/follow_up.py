"""Follow-up run: it ends its decision once the candidates are separated, then diagnoses all runs together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from calrig.analysis.errors import Conflict
from calrig.analysis.stored_runs import AmbiguousRuns, found_in, last_request, poses_together, runs_together
from calrig.calibration.diagnosis import Findings, FollowUp, SequentialTest, design, trace
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.calibration.progress import Progress, unheard, within
from calrig.calibration.regression import DiagnosisRequest
from calrig.model.plan import Plan, PlannedPose
from calrig.processes.pool import WorkError, run_in_subprocess
from calrig.store import Run

if TYPE_CHECKING:
    from calrig.store import Store


Designed = tuple[Findings, FollowUp] | str
"""What was found in the earlier runs and the run that separates it, or why none would."""
SEARCHED = 0.7
"""The share of it all that the search for effects takes, about."""


@dataclass(frozen=True, slots=True)
class FollowUpQuestion:
    """Which run would best separate the suspects of earlier ones, of which `last` is the latest, on a rig.

    Attributes:
        last: a run whose diagnosis, with those it follows on, left something ambiguous.
        run_ids, poses: of all of them, in the order measured.
        request: what the last diagnosis assumed.
    """

    last: Run
    run_ids: list[str]
    poses: list[list[Pose]]
    limits_deg: tuple[float, float]
    request: DiagnosisRequest

    @classmethod
    def of(cls, store: Store, last: Run, limits_deg: tuple[float, float]) -> FollowUpQuestion:
        """The question; Conflict where a run has not ended, Invalid where they are too many."""
        runs = runs_together(store, last.id)
        ids = [run.id for run in runs]
        return cls(last, ids, poses_together(store, runs), limits_deg, last_request(last))

    @property
    def work(self) -> Callable[..., Designed]:
        """What answers it, here or in another process; its `progress` is told the share that is done."""
        return partial(designed, self.poses, self.limits_deg, self.request)

    def follow_up(self, found: Designed) -> FollowUpRun:
        """The run that was designed; Conflict where none would separate the suspects, and why."""
        if isinstance(found, str):
            raise Conflict(f"run {self.last.id}: {found}")
        findings, design = found
        plan = Plan.model_validate(design.document(self.last.plan or {})["plan"])
        earlier = AmbiguousRuns(self.run_ids, self.poses, findings)
        return FollowUpRun(earlier, design.separates, design.deciding, plan, self.limits_deg)


def designed(
    poses: list[list[Pose]],
    limits_deg: tuple[float, float],
    request: DiagnosisRequest,
    progress: Progress = unheard,
) -> Designed:
    """Finds the suspects in the poses of runs, and designs the run that separates them."""
    try:
        findings = found_in(poses, request)
    except DiagnosisError as error:
        return str(error)
    progress(SEARCHED)
    found = design(poses, findings, limits_deg, progress=within(progress, SEARCHED, 1.0))
    return found if isinstance(found, str) else (findings, found)


@dataclass
class FollowUpRun:
    """A follow-up and the runs it follows on.

    Attributes:
        earlier: the runs, whose diagnosis left something ambiguous.
        separates: names of the suspects.
        deciding: how many poses of a sweep, its first, are there to decide; the others confirm.
        decided_on: indices of the measured poses that served to decide.
    """

    earlier: AmbiguousRuns
    separates: Sequence[str]
    deciding: int
    plan: Plan
    limits_deg: tuple[float, float]
    decided_on: list[int] = field(default_factory=list)
    _decided: bool = False

    def __post_init__(self) -> None:
        self._test = SequentialTest(self.earlier.poses, self.earlier.findings)
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
            "reference": self.earlier.findings.responses.request.reference,
        }

    def diagnosis(self, run_id: str, measured: Sequence[Pose]) -> dict[str, Any] | None:
        """The diagnosis of all runs together, confirmed on the poses that did not serve to decide."""
        question = partial(
            trace,
            [*self.earlier.poses, measured],
            [*self.earlier.run_ids, run_id],
            request=self.earlier.findings.responses.request,
            plan=self.plan.model_dump(mode="json"),
            limits_deg=self.limits_deg,
            deciding=self.decided_on,
        )
        try:
            return run_in_subprocess(question)
        except (DiagnosisError, WorkError):
            return None  # asking for it later says why
