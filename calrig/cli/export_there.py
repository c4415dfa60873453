"""`export` at a running service, which holds the store."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import quote

from calrig.cli.running_service import whole_id_there
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.client import Client, Revision


def exported_there(
    client: Client, run_id: str | None, unit: str | None, format_: str
) -> tuple[str, str, Revision | None]:
    """The text that `export` prints, the unit, and the revision that it is of; None of a run's poses.

    Args:
        client: of the service.
        run_id: the run, which may be shortened; None where a unit is wanted.
        unit: or the unit.
        format_: as `calrig export --format` has them.
    """
    from calrig.export.formats import exporters

    if run_id is not None and format_ == "csv":
        return _poses(client, whole_id_there(client, run_id)), "", None
    if format_ in {exporter.name for exporter in exporters("noise")}:
        of_unit = unit or client.run(whole_id_there(client, run_id or "")).unit
        return client.exported(of_unit, format_), of_unit, None
    of_unit, found = revision_there(client, run_id, unit)
    if format_ == "csv":
        return _poses(client, found.run_id), of_unit, found
    text = client.exported(of_unit, format_, found.revision)
    return text + "\n" * (format_ == "json"), of_unit, found


def revision_there(client: Client, run_id: str | None, unit: str | None) -> tuple[str, Revision]:
    """A unit, and the revision of it that is asked for: the newest of the run, or in force, else the latest.

    Raises:
        WorkError: there is none.
    """
    if unit is not None:
        standing = [one for one in client.calibrations(unit) if one.status != "withdrawn"]
        if not standing:
            raise WorkError(f"unit {unit!r} has no calibration: none was completed, or all were withdrawn")
        return unit, next((one for one in standing if one.status == "in_force"), standing[0])
    run = client.run(whole_id_there(client, run_id or ""))
    for one in client.calibrations(run.unit):
        if one.run_id == run.id:
            return run.unit, one
    raise WorkError(f"run {run.id} gave no calibration")


def _poses(client: Client, run_id: str) -> str:
    return client.text(f"/api/runs/{quote(run_id, safe='')}/poses?format=csv")
