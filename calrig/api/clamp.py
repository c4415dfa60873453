"""Turning the unit in a rig's own clamp, where it has one."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

import asyncio

from fastapi import APIRouter

from calrig.api.callers import requires
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Body, RigAnswer
from calrig.plan import ElevationDeg, MountAxis

router = APIRouter(tags=["runs"])


class ClampUnit(Body):
    """How the unit is to be clamped."""

    mount_deg: ElevationDeg
    mount_axis: MountAxis = "x"


@router.post(
    "/api/rigs/{name}/clamp",
    dependencies=[requires("operator")],
    response_model=RigAnswer,
    responses=problems(404, 409, 422),
    summary="Turn the unit with the rig's clamp",
)
async def clamp(name: str, body: ClampUnit, context: Context) -> object:
    """200 once the unit sits. No run asks for it: it waits for a person, who may use this and then resume.

    409 where the rig has no clamp, or a run is on it that does not wait for the unit to be turned.
    """
    errand = await asyncio.to_thread(context.service.begin_clamp, name, body.mount_deg, body.mount_axis)
    return await asyncio.shield(asyncio.wrap_future(errand.future))
