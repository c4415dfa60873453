"""`import` and `export` at a running service, which holds the store."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode

import typer

from calrig.cli.progress import late_bar
from calrig.cli.running_service import whole_id_there
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.client import Client, Run

NOISE = frozenset({"kalibr", "vins"})
"""Formats of what a unit's latest static run shows, whatever the revision."""


def imported_there(client: Client, file: Path, unit: str, rig: str | None) -> Run:
    """The run that the service made of a file."""
    with late_bar(f"sending {file.name}") as sent, late_bar("importing") as told:
        return client.import_poses(file, unit, rig=rig, sent=sent, told=told)


def exported_there(
    client: Client, run_id: str | None, unit: str | None, format_: str
) -> tuple[str, list[str]]:
    """The text that `export` prints, and what is to be said of it on standard error.

    Args:
        client: of the service.
        run_id: the run, which may be shortened; None where a unit is wanted.
        unit: or the unit.
        format_: as `calrig export --format` has them.
    """
    if run_id is not None:
        run_id = whole_id_there(client, run_id)
        if format_ == "csv":
            return client.text(f"{_run(run_id)}/poses?format=csv"), []
        unit = client.run(run_id).unit
    calibration = f"/api/units/{quote(str(unit), safe='')}/calibration"
    if format_ in NOISE:
        return client.text(f"{calibration}?{urlencode({'format': format_})}"), []
    found = _chosen(client.get(f"{calibration}s"), run_id, str(unit))
    if found["status"] != "in_force":
        words = f"revision {found['revision']} of unit {unit!r} is {found['status']}, not in force"
        typer.echo(f"calrig export: {words}", err=True)
    if format_ == "csv":
        return client.text(f"{_run(found['run_id'])}/poses?format=csv"), []
    query = urlencode({"revision": found["revision"], "format": format_})
    text = client.text(f"{calibration}?{query}")
    return text + "\n" * (format_ == "json"), found["verdict"]["says"]


def _run(run_id: str) -> str:
    return f"/api/runs/{quote(run_id, safe='')}"


def _chosen(revisions: list[dict[str, Any]], run_id: str | None, unit: str) -> dict[str, Any]:
    """Of the revisions, newest first: the newest of the run, or the unit's in force, else its latest."""
    if run_id is not None:
        for one in revisions:
            if one["run_id"] == run_id:
                return one
        raise WorkError(f"run {run_id} gave no calibration")
    standing = [one for one in revisions if one["status"] != "withdrawn"]
    if not standing:
        raise WorkError(f"unit {unit!r} has no calibration: none was completed, or all were withdrawn")
    return next((one for one in standing if one["status"] == "in_force"), standing[0])
