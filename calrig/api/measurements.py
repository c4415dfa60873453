"""What a run measured: its poses and its raw samples."""

from collections.abc import Iterator
from functools import partial
from itertools import chain, islice
from typing import Annotated, Any, AnyStr, Literal

from fastapi import APIRouter, Header, Query
from fastapi.responses import PlainTextResponse, Response, StreamingResponse
from pydantic_core import to_json

from calrig.analysis.calibration_in_force import Fit, left_of_poses_deg, residuals_of
from calrig.analysis.stored_runs import labels_of, mount_columns
from calrig.api.context import ApiContext, Context, KnownRun
from calrig.api.models import PoseAnswer
from calrig.api.routes import BYTES, TEXT, answers, problems_in_json
from calrig.calibration.poses import GYRO_MEANS, Pose
from calrig.calibration.results import raw_error_deg
from calrig.export.poses_csv import write_pose_batches
from calrig.export.samples_csv import write_samples_csv, write_samples_npz
from calrig.model.run import mount_axis
from calrig.store import Run, Store, StoredPose

CSV = "text/csv; charset=utf-8"

router = APIRouter(tags=["measurements"])


@router.get(
    "/api/runs/{run_id}/poses",
    **answers(list[PoseAnswer], "The poses of a run", 404, 422, sends={"text/csv": TEXT}),
)
def poses(
    run: KnownRun,
    context: Context,
    format: Annotated[Literal["json", "csv"] | None, Query()] = None,
    accept: Annotated[str, Header()] = "",
    fit: Fit = "verdict",
) -> Any:
    """JSON has all; CSV (`format=csv` or `Accept: text/csv`) is the import format, without excluded poses."""
    # Tens of thousands of them, straight from the store: a test holds them to the model.
    if format == "csv" or (format is None and prefers_csv(accept)):
        return _streamed(
            write_pose_batches(partial(_counted, context, run), labels_of(run)),
            CSV,
            f"run-{run.id}-poses.csv",
        )
    return _streamed(_json(run, context.store, fit), "application/json")


def _counted(context: ApiContext, run: Run) -> Iterator[list[Pose]]:
    for batch in context.store.poses.batches_of(run.id):
        yield [stored.pose for stored in batch if stored.excluded is None]


def _json(run: Run, store: Store, fit: Fit) -> Iterator[bytes]:
    begin = b"["
    whole: Iterator[float | None] | None = None
    if fit == "verdict" and run.result is not None and run.result.rms_with_effects_deg is not None:
        whole = iter(left_of_poses_deg(store, run, [p.pose for p in store.poses.of(run.id)]))
    for batch in store.poses.batches_of(run.id):
        left_deg = (
            residuals_of(store, run, [p.pose for p in batch], fit)
            if whole is None
            else list(islice(whole, len(batch)))
        )
        poses = [_pose(p, left, run) for p, left in zip(batch, left_deg, strict=True)]
        yield begin + to_json(poses, inf_nan_mode="null")[1:-1]
        begin = b","
    yield b"[]" if begin == b"[" else b"]"


def _streamed(pieces: Iterator[AnyStr], media_type: str, name: str = "") -> Response:
    """An answer that is made as it is sent; what is wrong with its beginning is told in place of it."""
    first = next(pieces)
    content: Iterator[str | bytes] = chain([first], pieces)
    return StreamingResponse(content, media_type=media_type, headers=_named(name) if name else None)


def _pose(stored: StoredPose, residual_deg: float | None, run: Run) -> dict[str, Any]:
    axis = mount_axis(run.plan, run.provenance)
    bias_deg = 0.0 if run.result is None else run.result.bias_deg
    return {
        **dict.fromkeys(GYRO_MEANS),
        **stored.pose.row(),
        **mount_columns(run.id, axis, stored.pose),
        "index": stored.index,
        "excluded": stored.excluded,
        "raw_error_deg": raw_error_deg(stored.pose, -1 if axis.startswith("-") else 1, bias_deg),
        "residual_deg": residual_deg,
    }


def prefers_csv(accept: str) -> bool:
    """Whether CSV is the first that an Accept header names of the two types there are."""
    named = [part.split(";")[0].strip().lower() for part in accept.split(",")]
    offered = [name for name in named if name in {"text/csv", "application/json"}]
    return offered[:1] == ["text/csv"]


@router.get(
    "/api/runs/{run_id}/samples",
    **answers(
        None,
        "The raw samples of a run",
        404,
        422,
        sends={"text/csv": TEXT, "application/octet-stream": BYTES},
    ),
)
def samples(
    run: KnownRun,
    context: Context,
    pose: Annotated[int | None, Query(ge=0, lt=2**31, description="The dwell of this pose only.")] = None,
    format: Literal["csv", "npz"] = "csv",
) -> Response:
    """In the columns of a static log, moves and dwells in the order taken; none once they were pruned."""
    name = f"run-{run.id}-samples" if pose is None else f"run-{run.id}-pose-{pose}-samples"
    if format == "npz":
        packed = write_samples_npz(context.store.samples.of(run.id, pose))
        return Response(packed, media_type="application/octet-stream", headers=_named(f"{name}.npz"))
    return _streamed(write_samples_csv(context.store.samples.blocks_of(run.id, pose)), CSV, f"{name}.csv")


@router.get(
    "/api/runs/{run_id}/transcript",
    response_class=PlainTextResponse,
    response_model=None,
    responses=problems_in_json(404),
    summary="What went over the wires before a run failed",
)
def transcript(run: KnownRun, context: Context) -> str:
    """The last minute of each port, one transcript after the other; empty of a run that did not fail."""
    return "".join(context.store.events.transcripts(run.id).values())


def _named(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"'}
