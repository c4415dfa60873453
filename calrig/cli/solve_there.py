"""Runs solved by a running service, which has them and keeps the solution."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import typer

from calrig.cli.typed_ids import LISTED, the_one
from calrig.client import Client
from calrig.errors import WorkError
from calrig.run_ids import begins_uuid, is_uuid
from calrig.store.solutions import Solved

if TYPE_CHECKING:
    from calrig.analysis.joint_solutions import Wanted

LOOK_S = 0.5
KEPT_BESIDE = ("id", "created_at", "by", "rig", "runs", "linear", "periods_deg", "seat_std_deg", "frame")
"""What an answer has beside the document of CONTRACT section 8."""


def solved_there(server: str, wanted: Wanted, *, with_files: bool, with_poses: bool) -> Solved:
    """The solution as the service has kept it; says on standard error where.

    Args:
        server: its address.
        wanted: runs; their ids may be shortened.
        with_files: whether calibrations and stage map are wanted.
        with_poses: whether what each pose leaves is.

    Raises:
        InputError: what was asked is wrong, or the poses cannot be solved.
        WorkError: the service cannot be reached or refuses.
    """
    client = Client(server)
    runs = [_whole_id(client, typed) for typed in wanted.runs]
    body = {
        "runs": runs,
        "linear": wanted.linear,
        "periods_deg": list(wanted.periods_deg),
        "seat_std_deg": wanted.seat_std_deg,
        "frame": wanted.frame,
        "limits_deg": wanted.limits_deg,
    }
    document = _asked(client, body)
    beside = {name: document.pop(name) for name in KEPT_BESIDE}
    path = f"/api/solve/{beside['id']}"
    serials = [unit["unit"] for unit in document["units"]]
    typer.echo(f"calrig solve: kept as solution {beside['id']} at {server}", err=True)
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


def _whole_id(client: Client, typed: str) -> str:
    if is_uuid(typed) or not begins_uuid(typed.lower()):
        return typed
    found = client.get(f"/api/runs?begins={typed.lower()}&limit={LISTED + 1}")["items"]
    return the_one(typed, [run["id"] for run in found])


def _asked(client: Client, body: dict[str, Any]) -> dict[str, Any]:
    """The answer, however long it takes; who no longer waits ends the work."""
    answer: dict[str, Any] = client.post("/api/solve?wait=false", body)
    if "state" not in answer:
        return answer
    job = f"/api/jobs/{answer['id']}"
    try:
        while answer["state"] in {"queued", "running"}:
            time.sleep(LOOK_S)
            answer = client.get(job)
    except KeyboardInterrupt:
        client.delete(job)
        raise
    if answer["state"] != "done":
        raise WorkError(answer["error"] or f"the work was {answer['state']} at the service")
    found: dict[str, Any] = client.get(answer["result"])
    return found
