"""What a service does for a program, in its own terms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from calrig.client.documents import Estimate, PlanDesign, RigState, RunRecord, Status
from calrig.client.issued import Issued
from calrig.client.jobs import Told, outcome, unheard
from calrig.client.run import Run
from calrig.client.studies import Studies
from calrig.client.transport import part

if TYPE_CHECKING:
    from calrig.plan import Plan


class Client(Studies, Issued):
    """The service at an address: `Client("http://lab-pc:8000").calibrate("AS-0042").result.bias_deg`.

    It may be used from several threads. Errors are `calrig.client.ServiceError`, in the service's words.
    """

    def rigs(self) -> list[RigState]:
        """Every rig and what it is doing; the first is what runs take that name none."""
        return RigState.each(self.get("/api/rigs"))

    def calibrate(
        self,
        unit: str,
        *,
        rig: str | None = None,
        plan: Plan | PlanDesign | Mapping[str, Any] | None = None,
        operator: str | None = None,
        note: str | None = None,
        stage_at_deg: float | None = None,
        queue: bool = False,
    ) -> Run:
        """Starts a run; its `result` waits for the end.

        Args:
            unit: serial number.
            rig: its name; without one the first.
            plan: what is measured; what it does not say is as the service has it.
            operator: who runs it, where the service does not know by the token.
            note: kept with the run.
            stage_at_deg: elevation at which a stage without homing stands.
            queue: whether it waits for its turn where the rig is busy.

        Raises:
            Refused: the rig is busy or does not exist.
            Invalid: the plan or the serial number is wrong.
        """
        said: dict[str, Any] = {"rig": rig, "operator": operator, "note": note, "stage_at_deg": stage_at_deg}
        body: dict[str, Any] = {
            "unit": unit,
            **{key: value for key, value in said.items() if value is not None},
        }
        if plan is not None:
            body["plan"] = _plain(plan)
        if queue:
            body["queue"] = True
        return Run(self, RunRecord.of(self.post("/api/runs", body)))

    def run(self, run_id: str) -> Run:
        """A run by its whole id."""
        return Run.of_id(self, run_id)

    def runs(
        self,
        *,
        unit: str | None = None,
        rig: str | None = None,
        status: Status | None = None,
        begins: str | None = None,
        limit: int = 50,
    ) -> list[RunRecord]:
        """The newest runs, newest first.

        Args:
            unit: serial number.
            rig: its name.
            status: what they are.
            begins: first characters of their ids.
            limit: how many at most, up to 500.
        """
        wanted = {"unit": unit, "rig": rig, "status": status, "begins": begins, "limit": limit}
        query = urlencode({key: value for key, value in wanted.items() if value is not None})
        return RunRecord.each(part(self.get(f"/api/runs?{query}"), "items"))

    def estimate(
        self, plan: Plan | PlanDesign | Mapping[str, Any], *, rig: str | None = None, unit: str = ""
    ) -> Estimate:
        """A plan's poses, its duration on a rig, and what is to be said of it; nothing moves.

        Args:
            plan: as of `calibrate`.
            rig: its name; without one the first.
            unit: whose limits it is held to.

        Raises:
            Invalid: the plan is wrong.
        """
        body = {"rig": rig, "unit": unit, "plan": _plain(plan)}
        return Estimate.of(self.post("/api/plans/estimate", body))

    def plan(
        self,
        *,
        target_u_deg: float | None = None,
        time_s: float | None = None,
        rig: str | None = None,
        unit: str = "",
        until: Mapping[str, float] | None = None,
        trace: bool = True,
        sweep: bool = True,
        keep: Plan | Mapping[str, Any] | None = None,
        told: Told = unheard,
    ) -> PlanDesign:
        """The plan that reaches an uncertainty soonest, or the best one for a time; nothing moves.

        Args:
            target_u_deg: the expanded uncertainty wanted.
            time_s: or the time there is.
            rig: its name; without one the first.
            unit: whose earlier runs tell the noise.
            until: what else is to be reached: `bias_std_deg`, `scale_std`, `expanded_uncertainty_deg`.
            trace: whether effects are to be found in it.
            sweep: whether it may turn without stopping.
            keep: a plan whose range, settling and rate are kept.
            told: is told the share that is done.

        Raises:
            Invalid: no plan reaches it; says what would.
        """
        wanted: dict[str, Any] = {
            "rig": rig,
            "target_u_deg": target_u_deg,
            "time_s": time_s,
            "until": until and dict(until),
        }
        body: dict[str, Any] = {
            "unit": unit,
            "trace": trace,
            "sweep": sweep,
            **{k: v for k, v in wanted.items() if v is not None},
        }
        if keep is not None:
            body["plan"] = _plain(keep)
        return PlanDesign.of(outcome(self, self.post("/api/plans/design?wait=false", body), told))


def _plain(plan: Plan | PlanDesign | Mapping[str, Any]) -> dict[str, Any]:
    """A plan as JSON; of a design the plan in it."""
    if isinstance(plan, PlanDesign):
        return plan.plan
    return dict(plan) if isinstance(plan, Mapping) else plan.model_dump(mode="json")
