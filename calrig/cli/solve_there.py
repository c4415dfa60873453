"""Runs solved by a running service, which has them and keeps the solution."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import quote

import typer

from calrig.cli.progress import late_bar
from calrig.cli.running_service import whole_id_there
from calrig.cli.solve import NOT_DRAWN
from calrig.errors import InputError
from calrig.store.solved import Solved

if TYPE_CHECKING:
    from calrig.analysis.joint_solutions import Wanted
    from calrig.client import Client, RunRecord

KEPT_BESIDE = ("id", "created_at", "by", "rig", "runs", "linear", "periods_deg", "seat_std_deg", "frame")
"""What an answer has beside the document of CONTRACT section 8."""


def solved_there(client: Client, wanted: Wanted, *, with_files: bool, with_poses: bool) -> Solved:
    """The solution as the service has kept it; says on standard error where.

    Args:
        client: of the service.
        wanted: runs; their ids may be shortened.
        with_files: whether calibrations and stage map are wanted.
        with_poses: whether what each pose leaves is.

    Raises:
        InputError: what was asked is wrong, or the poses cannot be solved.
        WorkError: the service cannot be reached or refuses.
    """
    runs = [whole_id_there(client, typed) for typed in wanted.runs]
    if with_poses and any(_axis(client.run(run_id).record)[-1] != "x" for run_id in runs):
        raise InputError(NOT_DRAWN)
    with late_bar("solving") as show:
        found = client.solve(
            *runs,
            linear=wanted.linear,
            periods_deg=wanted.periods_deg,
            seat_std_deg=wanted.seat_std_deg,
            frame=wanted.frame,
            limits_deg=wanted.limits_deg,
            told=show,
        )
    path = f"/api/solve/{found.id}"
    document = client.get(path)
    beside = {name: document.pop(name) for name in KEPT_BESIDE}
    serials = [unit["unit"] for unit in document["units"]]
    typer.echo(f"calrig solve: kept as solution {found.id} at {client.server}", err=True)
    return Solved(
        rig=beside["rig"],
        basis=wanted.basis(beside["runs"], serials),
        document=document,
        calibrations={
            serial: client.get(f"{path}/units/{quote(serial, safe='')}") for serial in serials if with_files
        },
        stage_map=client.get(f"{path}/map") if with_files else {},
        poses=client.get(f"{path}/poses") if with_poses else {},
    )


def _axis(run: RunRecord) -> str:
    """Which of the unit's axes lay along the stage's."""
    return str((run.plan or run.provenance).get("mount_axis", "x"))
