"""The calls of a service: rigs, runs, plans, studies of files and runs, and what was issued of units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote, urlencode

from calrig.client.documents import PlanDesign, RunRecord, each, typed
from calrig.client.run import Run, Told, ignore_progress, outcome
from calrig.client.transport import Transport, part
from calrig.model.calibration import Revision
from calrig.model.comparison import Comparison
from calrig.model.diagnosis import Diagnosis
from calrig.model.noise import FiltersStudy, NoiseStudy
from calrig.model.plan_design import Estimate
from calrig.model.result import StatedKind
from calrig.model.run import Status
from calrig.model.service import RigState
from calrig.model.solution import Frame, Solution

if TYPE_CHECKING:
    from calrig.loaded import Calibration
    from calrig.model.plan import Plan


class Client(Transport):
    """The service at an address: `Client("http://lab-pc:8000").calibrate("AS-0042").result.bias_deg`.

    It may be used from several threads. Errors are `calrig.client.ServiceError`, in the service's words.
    """

    def rigs(self) -> list[RigState]:
        """Every rig and what it is doing; the first is what runs take that name none."""
        return each(RigState, self.get("/api/rigs"))

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
        body = _given(unit=unit, rig=rig, operator=operator, note=note, stage_at_deg=stage_at_deg)
        if plan is not None:
            body["plan"] = _plain(plan)
        if queue:
            body["queue"] = True
        return Run(self, typed(RunRecord, self.post("/api/runs", body)))

    def run(self, run_id: str) -> Run:
        """A run by its whole id."""
        return Run(self, typed(RunRecord, self.get(f"/api/runs/{quote(run_id, safe='')}")))

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
        query = urlencode(_given(unit=unit, rig=rig, status=status, begins=begins, limit=limit))
        return each(RunRecord, part(self.get(f"/api/runs?{query}"), "items"))

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
        return typed(Estimate, self.post("/api/plans/estimate", body))

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
        told: Told = ignore_progress,
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
        wanted = _given(rig=rig, target_u_deg=target_u_deg, time_s=time_s, until=until and dict(until))
        body = {"unit": unit, "trace": trace, "sweep": sweep, **wanted}
        if keep is not None:
            body["plan"] = _plain(keep)
        return typed(PlanDesign, outcome(self, self.post("/api/plans/design?wait=false", body), told))

    def import_poses(
        self,
        file: str | Path,
        unit: str,
        *,
        rig: str | None = None,
        reference_std_deg: float | None = None,
        reference_kind: StatedKind | None = None,
        reference_certificate: str | None = None,
        reference: Literal["good", "stage"] | None = None,
        sent: Told = ignore_progress,
        told: Told = ignore_progress,
    ) -> Run:
        """A run of a CSV of poses.

        Args:
            file: its path; it is read as it is sent.
            unit: serial number.
            rig: where it was measured.
            reference_std_deg: standard uncertainty of the reference angles; None for the file's, else the
                rig's.
            reference_kind: how its error is shared among poses; None for `harmonic`.
            reference_certificate: number of the certificate that its uncertainty is from.
            reference: what diagnoses of the run assume: `good`, the reference does not err; None for what
                its rig says.
            sent: is told the share that is sent.
            told: is told the share that is read.

        Raises:
            Invalid: the file is no such CSV; says line and column.
        """
        std = None if reference_std_deg is None else repr(reference_std_deg)
        fields = _given(
            unit=unit,
            rig=rig,
            reference_std_deg=std,
            reference_kind=reference_kind,
            reference_certificate=reference_certificate,
            reference=reference,
        )
        return Run(self, typed(RunRecord, self._of_file("/api/imports", file, fields, sent, told)))

    def noise(
        self,
        file: str | Path,
        *,
        rate_hz: float | None = None,
        accel_range_g: float | None = None,
        gyro_range_dps: float | None = None,
        sent: Told = ignore_progress,
        told: Told = ignore_progress,
    ) -> NoiseStudy:
        """The noise of a sensor at rest; the service keeps what was found, and not the log.

        Args:
            file: path of a CSV with a row a sample.
            rate_hz: samples a second; goes before the log's own time.
            accel_range_g: full scale of the accelerometer's raw counts.
            gyro_range_dps: full scale of the gyro's raw counts.
            sent: is told the share that is sent.
            told: is told the share that is analysed.

        Raises:
            Invalid: the file is no such log; says line and column.
        """
        fields = _given(rate_hz=rate_hz, accel_range_g=accel_range_g, gyro_range_dps=gyro_range_dps)
        return typed(NoiseStudy, self._of_file("/api/noise", file, fields, sent, told))

    def filters(
        self,
        file: str | Path,
        *,
        rate_hz: float | None = None,
        accel_range_g: float | None = None,
        gyro_range_dps: float | None = None,
        sent: Told = ignore_progress,
        told: Told = ignore_progress,
    ) -> FiltersStudy:
        """Filters side by side on a log with rest and motion; arguments and errors as of `noise`."""
        fields = _given(rate_hz=rate_hz, accel_range_g=accel_range_g, gyro_range_dps=gyro_range_dps)
        return typed(FiltersStudy, self._of_file("/api/filters", file, fields, sent, told))

    def diagnose(
        self,
        run_id: str,
        *more: str,
        reference: Literal["stage", "good"] | None = None,
        periods_deg: Sequence[float] = (),
        told: Told = ignore_progress,
    ) -> Diagnosis:
        """As `Run.diagnose`, by the run's id."""
        run = self.run(run_id)
        return run.diagnose(*more, reference=reference, periods_deg=periods_deg, told=told)

    def solve(
        self,
        *runs: str,
        units: Sequence[str] = (),
        rig: str | None = None,
        linear: bool = False,
        periods_deg: Sequence[float] = (),
        seat_std_deg: float | None = None,
        frame: Frame = "sensor",
        limits_deg: tuple[float, float] | None = None,
        told: Told = ignore_progress,
    ) -> Solution:
        """Solves the stage's map, the mounts and the units of runs together; the service keeps it.

        Args:
            runs: ids.
            units: serial numbers: all their calibrations that count.
            rig: alone, all calibrations that count on it.
            linear: whether the units have no quadratic and cubic terms.
            periods_deg: known periods of gears.
            seat_std_deg: repeatability (standard deviation) of clamping a face, where it is known.
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
        return typed(Solution, outcome(self, self.post("/api/solve?wait=false", body), told))

    def _of_file(
        self, path: str, file: str | Path, fields: Mapping[str, object], sent: Told, told: Told
    ) -> Any:
        texts = {name: str(value) for name, value in fields.items()}
        return outcome(self, self.upload(f"{path}?wait=false", Path(file), texts, sent), told)

    def compare(self, *units: str) -> Comparison:
        """Units side by side; all of them without any."""
        query = urlencode([("unit", unit) for unit in units])
        return typed(Comparison, self.get(f"/api/compare?{query}"))

    def calibration(self, unit: str, revision: int | None = None) -> Calibration:
        """A unit's calibration, ready to be applied to readings: the one in force, or the revision."""
        from calrig.export.calibration_document import checked
        from calrig.loaded import Calibration

        path = _calibration(unit, revision)
        return Calibration(checked(self.get(path), self.server + path))

    def calibrations(self, unit: str) -> list[Revision]:
        """Every revision that was issued, the newest first."""
        return each(Revision, self.get(f"{_calibration(unit)}s"))

    def exported(self, unit: str, form: str, revision: int | None = None) -> str:
        """A calibration as it was issued (`json`), or made of it for another program.

        Args:
            unit: serial number.
            form: `c-header`, `px4` and others that `calrig export --format` has.
            revision: else the one in force.

        Raises:
            Refused: there is none, or that form cannot hold it.
        """
        return self.text(_calibration(unit, revision, form))

    def certificate(
        self, unit: str, form: Literal["pdf", "dcc"] = "pdf", revision: int | None = None
    ) -> bytes:
        """The certificate of a calibration: for people, or PTB's XML for programs.

        Raises:
            Refused: there is none, or the service cannot make such a one (501).
        """
        return b"".join(self.pieces(_calibration(unit, revision, form)))

    def archive(self, unit: str, file: str | Path) -> int:
        """All that stands behind a unit, a zip that `calrig verify` checks, into a file; gives its bytes.

        Raises:
            InputError: the file is there, or cannot be made.
            Refused: there is no such unit; no file is left then, nor where the line breaks.
        """
        from calrig.export.new_file import write_new

        return write_new(Path(file), self.pieces(f"/api/units/{quote(unit, safe='')}/archive"))


def _given(**fields: object) -> dict[str, object]:
    return {name: value for name, value in fields.items() if value is not None}


def _calibration(unit: str, revision: int | None = None, form: str | None = None) -> str:
    query = urlencode(_given(revision=revision, format=form))
    path = f"/api/units/{quote(unit, safe='')}/calibration"
    return f"{path}?{query}" if query else path


def _plain(plan: Plan | PlanDesign | Mapping[str, Any]) -> dict[str, Any]:
    """A plan as JSON; of a design the plan in it."""
    if isinstance(plan, PlanDesign):
        return plan.plan
    return dict(plan) if isinstance(plan, Mapping) else plan.model_dump(mode="json")
