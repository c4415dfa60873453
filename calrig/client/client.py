"""What a service does for a program, in its own terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote, urlencode

from calrig.client.documents import (
    Comparison,
    Diagnosis,
    PlanDesign,
    RigState,
    RunRecord,
    Solution,
    Status,
)
from calrig.client.jobs import Told, outcome, unheard
from calrig.client.run import Run
from calrig.client.transport import Transport
from calrig.client.upload import Upload

if TYPE_CHECKING:
    from calrig.loaded import Calibration
    from calrig.plan import Plan


class Client(Transport):
    """The service at an address: `Client("http://lab-pc:8000").calibrate("AS-0042").result.bias_deg`.

    It may be used from several threads. Errors are `calrig.client.ServiceError`, in the service's words.
    """

    def rigs(self) -> list[RigState]:
        """Every rig and what it is doing; the first is what runs take that name none."""
        return [RigState.of(rig) for rig in self.get("/api/rigs")]

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
        return Run(self, RunRecord.of(self.get(f"/api/runs/{quote(run_id, safe='')}")))

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
        return [RunRecord.of(item) for item in self.get(f"/api/runs?{query}")["items"]]

    def import_poses(
        self,
        file: str | Path,
        unit: str,
        *,
        rig: str | None = None,
        sent: Told = unheard,
        told: Told = unheard,
    ) -> Run:
        """A run of a CSV of poses.

        Args:
            file: its path; it is read as it is sent.
            unit: serial number.
            rig: where it was measured.
            sent: is told the share that is sent.
            told: is told the share that is read, where the service can say.

        Raises:
            Invalid: the file is no such CSV; says line and column.
        """
        fields = {"unit": unit} | ({} if rig is None else {"rig": rig})
        answer = self.upload("/api/imports?wait=false", Upload(Path(file), fields, sent))
        return Run(self, RunRecord.of(outcome(self, answer, told)))

    def diagnose(self, run_id: str, *more: str, told: Told = unheard) -> Diagnosis:
        """As `Run.diagnose`, by the run's id."""
        return self.run(run_id).diagnose(*more, told=told)

    def compare(self, *units: str) -> Comparison:
        """Units side by side; all of them without any."""
        query = urlencode([("unit", unit) for unit in units])
        return Comparison.of(self.get(f"/api/compare?{query}"))

    def calibration(self, unit: str, revision: int | None = None) -> Calibration:
        """A unit's calibration, ready to be applied to readings: the one in force, or the revision."""
        from calrig.export.calibration_file import checked
        from calrig.loaded import Calibration

        path = f"/api/units/{quote(unit, safe='')}/calibration"
        path += "" if revision is None else f"?revision={revision}"
        return Calibration(checked(self.get(path), self.server + path))

    def solve(
        self,
        *runs: str,
        units: Sequence[str] = (),
        rig: str | None = None,
        linear: bool = False,
        periods_deg: Sequence[float] = (),
        seat_std_deg: float | None = None,
        frame: Literal["sensor", "faces"] = "sensor",
        limits_deg: tuple[float, float] | None = None,
        told: Told = unheard,
    ) -> Solution:
        """Solves the stage's map, the mounts and the units of runs together; the service keeps it.

        Args:
            runs: ids.
            units: serial numbers: all their calibrations that count.
            rig: alone, all calibrations that count on it.
            linear: whether the units have no quadratic and cubic terms.
            periods_deg: of gears, where somebody knows them.
            seat_std_deg: how far one clamping of a face scatters from the next, likewise.
            frame: of units clamped by several faces, whose their matrix is.
            limits_deg: of the stage, which advice keeps to; without them those of the last run.
            told: is told the share that is done, where the service can say.
        """
        body = {
            "runs": list(runs),
            "units": list(units),
            "rig": rig,
            "linear": linear,
            "periods_deg": list(periods_deg),
            "seat_std_deg": seat_std_deg,
            "frame": frame,
            "limits_deg": limits_deg,
        }
        return Solution.of(outcome(self, self.post("/api/solve?wait=false", body), told))

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
