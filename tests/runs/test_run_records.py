"""Import, void and exclude: what is done to runs after they were measured. Nothing is ever deleted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from run_rigs import ENDLESS, TruthRig, until

from calrig.analysis.amendments import Records
from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.runs.service import RunService
from calrig.store import Run, Store

THETA = [-60.0, -30.0, 0.0, 30.0, 60.0]
READING = [-60.1, -29.6, 0.42, 30.61, 61.0]


@pytest.fixture
def records(store: Store) -> Records:
    return Records(store)


def csv(*rows: str, header: str = "target_deg,reading_deg") -> bytes:
    return "\n".join([header, *rows, ""]).encode()


@pytest.fixture
def imported(records: Records) -> Run:
    """A run of five poses from a file."""
    rows = (f"{theta},{reading}" for theta, reading in zip(THETA, READING, strict=True))
    return records.import_poses(unit="AS-9", rig="elsewhere", file_name="poses.csv", content=csv(*rows))


def line_through(theta: list[float], reading: list[float]) -> tuple[float, float, float, float]:
    """Bias, scale and both RMS, by NumPy's own least squares."""
    x, y = np.array(theta), np.array(reading)
    scale, bias = np.polyfit(x, y, 1)
    left = (y - bias) / scale - x
    return bias, scale, math.sqrt(((y - x) ** 2).mean()), math.sqrt((left**2).mean())


def figures(run: Run) -> tuple[float, float, float, float]:
    keys = ("bias_deg", "scale", "rms_raw_deg", "rms_calibrated_deg")
    return tuple(getattr(run.result, key) for key in keys)  # type: ignore[return-value]


def test_an_import_is_a_completed_run_with_its_fit(imported: Run, store: Store) -> None:
    assert (imported.status, imported.unit, imported.rig, imported.plan) == (
        "completed",
        "AS-9",
        "elsewhere",
        None,
    )
    assert imported.provenance["imported_from"] == "poses.csv"
    assert imported.result.reference is None, "nobody says what that stage was worth"
    assert figures(imported) == pytest.approx(line_through(THETA, READING))
    assert [stored.pose.reading_deg for stored in store.poses.of(imported.id)] == READING
    assert imported.progress.model_dump(exclude={"waiting_for"}) == {
        "poses_done": 5,
        "poses_total": 5,
        "fraction": 1.0,
        "remaining_s": 0.0,
    }


def test_poses_at_one_elevation_give_no_scale(records: Records) -> None:
    run = records.import_poses(unit="AS-9", rig=None, file_name="a.csv", content=csv("10,10.2", "10,10.4"))
    assert run.result.scale is None
    assert run.result.scale_std is None
    assert run.result.bias_deg == pytest.approx(0.3)
    assert run.result.rms_raw_deg == pytest.approx(math.sqrt((0.2**2 + 0.4**2) / 2))
    assert run.result.rms_calibrated_deg == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (csv("0,0", "1,abc"), r"bad\.csv.*line 3.*reading_deg"),
        (csv("0,0", "1,nan"), r"bad\.csv.*line 3.*reading_deg"),
        (csv("0", header="target_deg"), r"bad\.csv.*reading_deg"),
        (csv(), r"bad\.csv"),
        (b"", r"bad\.csv"),
        (b"\xff\xfe\x00target", r"bad\.csv"),
    ],
)
def test_a_bad_file_is_named_with_line_and_column_and_stores_nothing(
    records: Records, store: Store, content: bytes, named: str
) -> None:
    before = store.runs.page()
    with pytest.raises(Invalid, match=named):
        records.import_poses(unit="AS-bad-file", rig=None, file_name="bad.csv", content=content)
    assert store.runs.page() == before
    assert store.units.get("AS-bad-file") is None


@pytest.mark.parametrize("serial", ["", "A ", "x" * 10_000])
def test_a_bad_serial_stores_nothing(records: Records, store: Store, serial: str) -> None:
    before = store.runs.page()
    with pytest.raises(Invalid, match="serial number"):
        records.import_poses(unit=serial, rig=None, file_name="a.csv", content=csv("0,0"))
    assert store.runs.page() == before


def test_an_excluded_pose_stays_and_the_result_is_that_of_the_others(
    imported: Run, records: Records, store: Store
) -> None:
    run = records.exclude_pose(imported.id, 2, "somebody leaned on the bench")
    assert figures(run) == pytest.approx(line_through(THETA[:2] + THETA[3:], READING[:2] + READING[3:]))
    assert run.result.n_poses == 4
    run = records.exclude_pose(imported.id, 0, "so it was before")
    assert figures(run) == pytest.approx(line_through([-30, 30, 60], READING[1:2] + READING[3:]))
    stored = store.poses.of(imported.id)
    assert [pose.pose.reading_deg for pose in stored] == READING
    assert [pose.excluded for pose in stored] == [
        "so it was before",
        None,
        "somebody leaned on the bench",
        None,
        None,
    ]


def test_an_exclusion_shows_in_the_comparison(imported: Run, records: Records, store: Store) -> None:
    run = records.exclude_pose(imported.id, 4, "outlier")
    row = next(row for row in store.units.comparison(["AS-9"]) if row.run_id == imported.id)
    assert (row.result["bias_deg"], row.result["scale"]) == (run.result.bias_deg, run.result.scale)


def test_the_last_pose_cannot_be_excluded(records: Records, store: Store) -> None:
    run = records.import_poses(unit="AS-9", rig=None, file_name="a.csv", content=csv("0,0.1", "10,10.2"))
    kept = records.exclude_pose(run.id, 0, "first")
    with pytest.raises(Conflict, match="void the run"):
        records.exclude_pose(run.id, 1, "last")
    assert store.runs.get(run.id).result == kept.result
    assert [pose.excluded for pose in store.poses.of(run.id)] == ["first", None]


def test_a_voided_run_is_kept_and_out_of_every_comparison(
    imported: Run, records: Records, store: Store
) -> None:
    assert imported.id in {row.run_id for row in store.units.comparison(["AS-9"])}
    run = records.void(imported.id, "  wrong unit  ")
    assert run.voided.reason == "wrong unit"
    assert run.result == imported.result
    assert len(store.poses.of(imported.id)) == 5
    assert imported.id not in {row.run_id for row in store.units.comparison(["AS-9"])}
    latest = store.runs.latest_calibration("AS-9")
    assert latest is None or latest.id != imported.id


@pytest.mark.parametrize("reason", ["", "   ", "x" * 1001])
def test_a_reason_is_needed_and_of_a_length_to_read(
    imported: Run, records: Records, store: Store, reason: str
) -> None:
    with pytest.raises(Invalid, match="reason"):
        records.void(imported.id, reason)
    with pytest.raises(Invalid, match="reason"):
        records.exclude_pose(imported.id, 0, reason)
    assert store.runs.get(imported.id) == imported


@pytest.mark.parametrize("index", [-1, 5, 1000])
def test_a_pose_that_is_not_there(imported: Run, records: Records, index: int) -> None:
    with pytest.raises(Unknown, match=f"pose {index}"):
        records.exclude_pose(imported.id, index, "why not")


def test_a_run_that_is_not_there(records: Records) -> None:
    for amend in (records.void, lambda run, why: records.exclude_pose(run, 0, why)):
        with pytest.raises(Unknown, match="no run 999999"):
            amend("999999", "why not")


def test_only_an_ended_run_is_amended(
    bench: TruthRig, service: RunService, records: Records, store: Store
) -> None:
    run = service.start(unit="AS-1", plan=ENDLESS)
    until(bench.moves, "motion")
    with pytest.raises(Conflict, match="running: end it first"):
        records.void(run.id, "why not")
    with pytest.raises(Conflict, match="running: end it first"):
        records.exclude_pose(run.id, 0, "why not")
    service.abort(run.id)
    assert records.void(run.id, "aborted anyway").voided.reason == "aborted anyway"


def test_excluding_from_a_measured_run_keeps_what_its_samples_say_of_the_gyro(
    bench: TruthRig, service: RunService, records: Records, store: Store, quick_plan: Any
) -> None:
    run = service.wait(service.start(unit="AS-1", plan=quick_plan).id, 30)
    amended = records.exclude_pose(run.id, 3, "a door was slammed")
    left = [p.pose for p in store.poses.of(run.id) if p.index != 3]
    expected = line_through([p.stage_deg for p in left], [p.reading_deg for p in left])
    assert figures(amended) == pytest.approx(expected)
    assert amended.result.gyro == run.result.gyro
    assert amended.result.reference.std_deg == run.result.reference.std_deg == 0.29
    assert amended.result.reference.bias_std_deg != run.result.reference.bias_std_deg
    assert len(store.samples.of(run.id, 3)) > 0
