"""Long work on files and runs: poses imported, noise and filters studied, runs traced and solved together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from calrig.client.documents import Diagnosis, RunRecord, Solution
from calrig.client.jobs import Told, outcome, unheard
from calrig.client.run import Run
from calrig.client.transport import Transport
from calrig.client.upload import Upload

if TYPE_CHECKING:
    from calrig.client.log_documents import FiltersStudy, NoiseStudy


class Studies(Transport):
    """A service's long work: whoever stops waiting ends it there."""

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
            told: is told the share that is read.

        Raises:
            Invalid: the file is no such CSV; says line and column.
        """
        fields = {"unit": unit} | ({} if rig is None else {"rig": rig})
        return Run(self, RunRecord.of(self._of_file("/api/imports", file, fields, sent, told)))

    def noise(
        self,
        file: str | Path,
        *,
        rate_hz: float | None = None,
        accel_range_g: float | None = None,
        gyro_range_dps: float | None = None,
        sent: Told = unheard,
        told: Told = unheard,
    ) -> NoiseStudy:
        """The noise of a sensor at rest; the service keeps what was found, and not the log.

        Args:
            file: path of a CSV with a row a sample.
            rate_hz: samples a second; goes before the log's own time.
            accel_range_g: full scale of the accelerometer's raw counts.
            gyro_range_dps: likewise of the gyro's.
            sent: is told the share that is sent.
            told: is told the share that is analysed.

        Raises:
            Invalid: the file is no such log; says line and column.
        """
        from calrig.client.log_documents import NoiseStudy

        fields = _given(rate_hz, accel_range_g, gyro_range_dps)
        return NoiseStudy.of(self._of_file("/api/noise", file, fields, sent, told))

    def filters(
        self,
        file: str | Path,
        *,
        rate_hz: float | None = None,
        accel_range_g: float | None = None,
        gyro_range_dps: float | None = None,
        sent: Told = unheard,
        told: Told = unheard,
    ) -> FiltersStudy:
        """Filters side by side on a log with rest and motion; arguments and errors as of `noise`."""
        from calrig.client.log_documents import FiltersStudy

        fields = _given(rate_hz, accel_range_g, gyro_range_dps)
        return FiltersStudy.of(self._of_file("/api/filters", file, fields, sent, told))

    def diagnose(self, run_id: str, *more: str, told: Told = unheard) -> Diagnosis:
        """As `Run.diagnose`, by the run's id."""
        return Run.of_id(self, run_id).diagnose(*more, told=told)

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

    def _of_file(self, path: str, file: str | Path, fields: Mapping[str, str], sent: Told, told: Told) -> Any:
        with Upload(Path(file), fields, sent) as upload:
            answer = self.upload(f"{path}?wait=false", upload)
        return outcome(self, answer, told)


def _given(
    rate_hz: float | None, accel_range_g: float | None, gyro_range_dps: float | None
) -> dict[str, str]:
    of_log = {"rate_hz": rate_hz, "accel_range_g": accel_range_g, "gyro_range_dps": gyro_range_dps}
    return {name: str(value) for name, value in of_log.items() if value is not None}
