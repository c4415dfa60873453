"""Poses that are wrong, poor or wild: a clear answer or a refusal, never an effect that is not there."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from posed import posed
from support import DATA, one_now

from calrig.calibration.diagnosis.candidates import Candidate
from calrig.calibration.diagnosis.conclusion import conclude
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.calibration.regression.responses import responses_of
from calrig.export.poses_csv import read_poses

NOISE_DEG = 0.03


def run_of(targets_deg: np.ndarray, seed: int = 5, **known: np.ndarray) -> list[Pose]:
    """Poses of a rig with nothing wrong but bias, scale and noise."""
    noise_deg = np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(targets_deg))
    readings_deg = 0.8 + 1.002 * targets_deg + noise_deg
    time_s = 4.0 * np.arange(len(targets_deg))
    return posed(**{"target_deg": targets_deg, "reading_deg": readings_deg, "time_s": time_s, **known})


def sweeps(count: int = 4) -> np.ndarray:
    up = np.linspace(-60.0, 60.0, 25)
    return np.concatenate([up if k % 2 == 0 else up[::-1] for k in range(count)])


def approaches(targets_deg: np.ndarray) -> np.ndarray:
    senses = np.sign(np.diff(targets_deg, prepend=0.0)).astype(int)
    return np.where(senses == 0, np.roll(senses, 1), senses)


def told(poses: list[Pose], *, cross_fit: bool = False) -> dict[str, Any]:
    """The document, which must be JSON without NaN (CONTRACT: what is not known is null)."""
    said = document(diagnose([poses], bootstraps=199, cross_fit=cross_fit), ["1"])
    json.dumps(said, allow_nan=False)
    return said


def with_column(poses: list[Pose], name: str, values: np.ndarray) -> list[Pose]:
    return [
        replace(pose, covariates={**pose.covariates, name: float(value)})
        for pose, value in zip(poses, values, strict=True)
    ]


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_fewer_poses_than_parameters_are_refused(count: int) -> None:
    with pytest.raises(DiagnosisError, match=f"{count} poses are too few"):
        diagnose([run_of(sweeps()[:count])])


def test_more_poses_than_a_search_can_take_are_refused_with_how_many_to_leave_out() -> None:
    with pytest.raises(DiagnosisError, match=r"4,001 poses; at most 4,000 .*one row in 2"):
        diagnose([run_of(np.linspace(-60.0, 60.0, 4001))])


def of_a_drive(rows: int, lag_rows: float, steps: int = 12) -> list[Pose]:
    """A log of a drive at commanded elevations, many rows at each: readings approach them exponentially."""
    commanded_deg = np.repeat(np.tile([20.0, 90.0, 160.0], steps // 3), rows)
    reading_deg = np.empty(len(commanded_deg))
    behind = np.exp(-1.0 / lag_rows)
    at_deg = commanded_deg[0]
    for k, target_deg in enumerate(commanded_deg):
        at_deg = reading_deg[k] = target_deg + (at_deg - target_deg) * behind
    noise_deg = np.random.default_rng(3).normal(0.0, NOISE_DEG, len(reading_deg))
    time_s = 0.05 * np.arange(len(reading_deg))
    return posed(target_deg=commanded_deg, reading_deg=reading_deg + noise_deg, time_s=time_s)


def test_rows_of_a_drive_that_was_still_on_its_way_are_refused() -> None:
    with pytest.raises(
        DiagnosisError, match="after a step of target_deg the readings take 11 rows to follow"
    ):
        told(of_a_drive(rows=40, lag_rows=5.0))


def test_rows_of_a_dwell_that_had_nearly_settled_are_diagnosed() -> None:
    assert told(of_a_drive(rows=10, lag_rows=0.4, steps=6))["n_poses"] == 60


@pytest.mark.parametrize("count", [8, 9, 12])
def test_few_poses_are_diagnosed_without_inventing_anything(count: int) -> None:
    """In one draw: one in a hundred has something to say by itself."""
    assert told(run_of(sweeps()[::4][:count], seed=1), cross_fit=True)["verdict"] == "nothing"


def test_all_poses_at_one_angle_have_no_scale_and_no_effect_of_angle() -> None:
    said = told(run_of(np.full(60, 20.0)), cross_fit=True)
    assert (said["verdict"], said["base"]["scale"]) == ("nothing", None)


def test_a_drift_at_one_angle_is_found() -> None:
    poses = run_of(np.full(60, 20.0))
    drifting = [replace(p, reading_deg=p.reading_deg + 1e-3 * (p.time_s or 0.0)) for p in poses]
    effect = told(drifting)["effects"][0]
    stated = effect["parameters"]["deg_per_s"]
    assert effect["name"] == "time_drift"
    assert abs(stated["value"] - 1e-3) < 4 * stated["std"]


def test_where_physics_rules_every_candidate_out_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = sweeps()
    poses = run_of(targets, approach=approaches(targets))
    with_play = [replace(one, reading_deg=one.reading_deg - 0.1 * (one.approach or 0)) for one in poses]
    assert told(with_play)["verdict"] == "named"
    monkeypatch.setattr(Candidate, "is_possible", lambda *_: False)
    assert told(with_play)["verdict"] == "nothing"


def test_nothing_found_in_four_times_the_noise_is_said_to_be_that() -> None:
    """Something wanders from pose to pose, which no effect and no column of the file follows."""
    rng = np.random.default_rng(9)
    wander_deg = np.zeros(100)
    for k in range(1, 100):
        wander_deg[k] = 0.7 * wander_deg[k - 1] + rng.normal(0.0, 0.1)
    poses = [
        replace(p, reading_deg=p.reading_deg + float(off), reading_stderr_deg=NOISE_DEG)
        for p, off in zip(run_of(sweeps()), wander_deg, strict=True)
    ]
    said = told(poses)
    assert (said["verdict"], said["noise"]["floor_deg"]) == ("nothing", pytest.approx(NOISE_DEG))
    (warning,) = said["warnings"]
    assert warning.startswith("lack of fit: bias and scale leave more than the noise of a pose")
    answer, *_ = conclude({**said, "confirmed_by": None}).says
    assert "more is left than the noise of a pose" in answer
    assert "consistent with noise" not in answer


CONSTANT: dict[str, Callable[[list[Pose]], list[Pose]]] = {
    "temperature_c": lambda poses: [replace(p, temperature_c=25.0) for p in poses],
    "approach": lambda poses: [replace(p, approach=1) for p in poses],
    "time_s": lambda poses: [replace(p, time_s=0.0) for p in poses],
    "accelerometer": lambda poses: [replace(p, accel_x_g=0.0, accel_y_g=0.0, accel_z_g=1.0) for p in poses],
    "gyro_move_deg": lambda poses: [replace(p, gyro_move_deg=0.0) for p in poses],
    "gyro_move_deg less the move": lambda poses: [
        replace(p, gyro_move_deg=p.target_deg - before.target_deg)
        for before, p in zip([poses[0], *poses], poses, strict=False)
    ],
    "unknown column": lambda poses: with_column(poses, "lamp_current", np.ones(len(poses))),
    "reading_deg": lambda poses: [replace(p, reading_deg=12.5) for p in poses],
}


@pytest.mark.parametrize("column", [name for name in CONSTANT if name != "reading_deg"])
def test_a_constant_column_says_nothing(column: str) -> None:
    assert told(CONSTANT[column](run_of(sweeps())))["verdict"] == "nothing"


def test_a_reading_that_never_changes_is_refused() -> None:
    with pytest.raises(DiagnosisError, match="never change"):
        diagnose([CONSTANT["reading_deg"](run_of(sweeps()))])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("span_deg", [1.0, 120.0])
def test_readings_of_noise_alone_are_refused_without_an_error_in_degrees(seed: int, span_deg: float) -> None:
    """Scales of 0.000 and 0.1 ± 0.2 made errors of 34° and 2.5° of noise of 0.5°."""
    targets = sweeps() * span_deg / 120.0
    noise_deg = np.random.default_rng(seed).normal(0.0, 0.5, len(targets))
    with pytest.raises(DiagnosisError, match="not seen to follow"):
        diagnose([run_of(targets, reading_deg=5.0 + noise_deg)])


def test_a_reading_that_never_changes_but_for_one_outlier_is_refused() -> None:
    stuck = CONSTANT["reading_deg"](run_of(sweeps()))
    stuck[40] = replace(stuck[40], reading_deg=15.0)
    with pytest.raises(DiagnosisError, match="not seen to follow"):
        diagnose([stuck])


@pytest.mark.parametrize("bias_deg", [0.0, 0.5, -179.3])
def test_readings_without_any_noise_are_diagnosed(bias_deg: float) -> None:
    exact = [replace(p, reading_deg=bias_deg + p.target_deg) for p in run_of(sweeps())]
    said = told(exact, cross_fit=True)
    assert said["verdict"] == "nothing"
    assert said["noise"]["lag1_correlation"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("seed", one_now(range(4)))
def test_what_rounding_leaves_of_exact_readings_and_witnesses_is_not_judged(seed: int) -> None:
    """The last bits of every channel, as another processor's kernels might leave them."""
    rng, targets = np.random.default_rng(seed), sweeps()
    last_bits = rng.integers(-1, 2, (100, 3)) * np.spacing(60.0)
    angle = np.radians(targets + last_bits[:, 0])
    poses = run_of(
        targets,
        approach=approaches(targets).tolist(),
        temperature_c=np.linspace(20.0, 26.0, 100),
        accel_y_g=np.sin(angle),
        accel_z_g=np.cos(angle),
        gyro_move_deg=np.diff(targets, prepend=0.0) + last_bits[:, 1],
    )
    exact = [
        replace(p, reading_deg=1.02 * p.target_deg + b) for p, b in zip(poses, last_bits[:, 2], strict=True)
    ]
    assert told(exact)["verdict"] == "nothing"


def test_an_effect_in_readings_without_any_noise_is_found() -> None:
    targets = sweeps()
    poses = run_of(targets, approach=approaches(targets).tolist())
    exact = [replace(p, reading_deg=p.target_deg + 0.04 * (p.approach or 0)) for p in poses]
    (effect,) = told(exact)["effects"]
    assert effect["name"] == "backlash"
    assert effect["parameters"]["backlash_deg"]["value"] == pytest.approx(0.08, abs=1e-9)


@pytest.mark.parametrize("name", ["temperature_c", "time_s", "approach", "stage_deg", "accel_y_g"])
@pytest.mark.parametrize("missing", [3, 60])
def test_missing_values_cost_poses_or_the_column_and_are_said(name: str, missing: int) -> None:
    targets = sweeps()
    poses = run_of(
        targets,
        temperature_c=np.linspace(20.0, 26.0, 100),
        approach=approaches(targets).tolist(),
        stage_deg=targets,
        accel_x_g=np.zeros(100),
        accel_y_g=np.sin(np.radians(targets)),
        accel_z_g=np.cos(np.radians(targets)),
    )
    holed = [replace(p, **{name: None}) if k % 33 < missing // 3 else p for k, p in enumerate(poses)]
    said = told(holed)
    assert said["verdict"] == "nothing"
    assert any(name in warning for warning in said["warnings"])


def test_of_two_identical_columns_one_is_accused_and_the_other_said_to_be_the_same() -> None:
    steps = np.random.default_rng(8).choice([-0.25, 0.25], 100)
    poses = [
        replace(p, reading_deg=p.reading_deg + 0.25 * float(v))
        for p, v in zip(run_of(sweeps()), steps, strict=True)
    ]
    said = told(with_column(with_column(poses, "supply_v", steps), "supply_mv", 1000.0 * steps))
    assert [(e["name"], e["covariate"]) for e in said["effects"]] == [("unnamed", "supply_v")]
    assert any("supply_mv says the same as supply_v" in warning for warning in said["warnings"])


@pytest.mark.parametrize(
    "of_error", [lambda e: e, lambda e: -e, lambda e: np.round(e, 2), np.abs, lambda e: e / 3.6]
)
def test_a_column_of_errors_that_a_logger_wrote_is_no_cause(of_error) -> None:
    poses = [replace(p, reading_deg=p.reading_deg - 0.8) for p in run_of(sweeps())]  # errors of either sign
    errors_deg = np.array([p.reading_deg - p.target_deg for p in poses])
    said = told(with_column(poses, "error", of_error(errors_deg)))
    assert any("error says the same as the reading less the elevation" in said_ for said_ in said["warnings"])
    assert all(e["covariate"] != "error" for e in said["effects"])


def test_a_reading_in_radians_is_refused_with_what_to_do() -> None:
    poses = [replace(p, reading_deg=math.radians(p.reading_deg)) for p in run_of(sweeps())]
    with pytest.raises(DiagnosisError, match="radians; convert reading_deg"):
        diagnose([poses])


@pytest.mark.parametrize("span_deg", [60.0, 360.0])
def test_a_reading_in_counts_is_refused_with_what_to_do(span_deg: float) -> None:
    theta = np.linspace(0.0, span_deg, 40)
    with pytest.raises(DiagnosisError, match="counts, or a smaller unit; convert reading_deg"):
        diagnose([run_of(theta, reading_deg=np.rint(theta / 360.0 * 2**14))])


@pytest.mark.parametrize("step_deg", [0.0, 0.5])
def test_a_sensor_whose_range_ends_before_the_stages_is_refused_with_where(step_deg: float) -> None:
    poses = run_of(sweeps())
    if step_deg:  # counts that each stand for several elevations are no end
        poses = [replace(p, reading_deg=step_deg * round(p.reading_deg / step_deg)) for p in poses]
    responses_of([poses])  # is not refused
    clipped = [replace(p, reading_deg=max(p.reading_deg, -40.0)) for p in poses]
    with pytest.raises(DiagnosisError, match=r"stop at -40 from -60° to -4.° \(.* poses\)"):
        responses_of([clipped])


def test_a_sensor_that_stops_at_both_ends_under_noise_is_refused_with_both() -> None:
    theta = np.arange(-80.0, 81.0, 4.0)
    noise_deg = np.random.default_rng(1).normal(0.0, 0.02, len(theta))
    with pytest.raises(
        DiagnosisError, match=r"from -80° to -60° \(6 poses\) and .* from 60° to 80° \(6 poses\)"
    ):
        diagnose([run_of(theta, reading_deg=np.clip(theta, -60.0, 60.0) + noise_deg)])


@pytest.mark.parametrize("one_more", [0.0, 0.0625])
def test_a_sensor_that_stops_at_both_ends_to_within_a_count_is_refused_with_both(one_more: float) -> None:
    theta = np.linspace(-60.0, 60.0, 61)
    counts = np.round(np.clip(0.4 * theta, -10.0, 14.0) / 0.0625) * 0.0625
    counts[[0, -1]] += one_more, -one_more  # the first reading and the last are a count away from the stop
    with pytest.raises(DiagnosisError, match=r"stop at -10 from -60° to -2.° .* and at 14 from 3.° to 60°"):
        diagnose([run_of(theta, reading_deg=counts)])


AN_EVEN_ARC = np.linspace(0.0, 120.0, 25)


@pytest.mark.parametrize(
    ("theta", "count_deg"),
    [
        (np.concatenate([[0.0, 0.01, -0.01, 0.02, 0.0], AN_EVEN_ARC]), 0.25),  # waited at home
        (60.0 * np.linspace(-1.0, 1.0, 61) ** 3, 2.0),  # densest where it is of least use
        (np.repeat(AN_EVEN_ARC, 5) + np.tile([0.0, 0.01, 0.02, -0.01, -0.02], 25), 5.0),
        (np.concatenate([AN_EVEN_ARC, AN_EVEN_ARC[::-1]]), 10.0),
        (np.linspace(-200.0, 200.0, 41), 1.0),  # over a turn, read within one
    ],
)
def test_what_repeats_a_reading_is_no_end_of_a_range(theta: np.ndarray, count_deg: float) -> None:
    within_a_turn = (theta + 180.0) % 360.0 - 180.0
    responses_of([run_of(theta, reading_deg=np.round(within_a_turn / count_deg) * count_deg)])  # not refused


def test_what_follows_the_stage_only_with_its_effect_has_no_error_before_it() -> None:
    theta = np.linspace(-60.0, 60.0, 49)
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(theta))
    said = told(run_of(theta, reading_deg=np.abs(theta + noise)), cross_fit=True)
    assert [e["name"] for e in said["effects"]] == ["unnamed"]
    assert {said["base"][of] for of in ("fit_rms_deg", "held_out_rms_deg", "blocked_rms_deg")} == {None}
    assert said["final"]["held_out_rms_deg"] < 0.03


def test_counts_that_start_anew_are_not_taken_for_readings_of_a_turn() -> None:
    theta = np.linspace(0.0, 360.0, 73)
    with pytest.raises(DiagnosisError, match="not seen to follow the 360°"):
        diagnose([run_of(theta, reading_deg=np.rint(theta / 360.0 * 2**14 + 5000.0) % 2**14)])


@pytest.mark.parametrize("bias_deg", [-106.0, 102.0])
def test_a_turn_whose_readings_start_anew_is_not_taken_for_radians(bias_deg: float) -> None:
    """A straight line through such a sawtooth may have the slope of radians."""
    theta = np.linspace(0.0, 358.0, 180)
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(theta))
    wrapped = (theta + bias_deg + noise + 180.0) % 360.0 - 180.0
    assert told(run_of(theta, reading_deg=wrapped))["verdict"] == "nothing"


def test_an_order_of_a_sensor_that_counts_against_the_stage_is_found_and_no_step_of_a_turn() -> None:
    theta = np.random.default_rng(1).uniform(0.0, 360.0, 100)
    error = 0.2 * np.sin(np.radians(3.0 * theta)) + np.random.default_rng(2).normal(0.0, 0.02, 100)
    said = told(run_of(theta, reading_deg=(12.0 - theta + error + 180.0) % 360.0 - 180.0))
    assert [e["name"] for e in said["effects"]] == ["stage_periodic"]
    assert said["effects"][0]["parameters"]["period_deg"]["value"] == pytest.approx(120.0, abs=0.5)
    assert said["final"]["fit_rms_deg"] < 0.03


def test_some_readings_off_by_a_whole_turn_are_taken_on_the_turn_of_the_others() -> None:
    poses = run_of(sweeps())
    off = [replace(p, reading_deg=p.reading_deg + 360.0 * (k % 3 == 0)) for k, p in enumerate(poses)]
    said, straight = told(off), told(poses)
    assert said["verdict"] == "nothing"
    assert said["base"] == pytest.approx(straight["base"])
    assert "some readings were taken on another turn" in " ".join(said["warnings"])


def test_readings_all_of_another_turn_have_it_in_their_bias() -> None:
    poses = run_of(sweeps())
    said, straight = told([replace(p, reading_deg=p.reading_deg + 360.0) for p in poses]), told(poses)
    assert said["verdict"] == "nothing"
    bias_deg = straight["base"]["bias_deg"] + 360.0
    assert said["base"] == pytest.approx({**straight["base"], "bias_deg": bias_deg})
    assert not any("another turn" in sentence for sentence in said["warnings"])


@pytest.mark.parametrize(("at", "size_deg"), [(0, 1.0), (41, -30.0), (99, 300.0), (99, 1.0)])
def test_one_wild_outlier_is_left_out_and_named(at: int, size_deg: float) -> None:
    poses = run_of(sweeps(), seed=1)  # a fixed draw: one in a hundred has something to say by itself
    poses[at] = replace(poses[at], reading_deg=poses[at].reading_deg + size_deg)
    said = told(poses)
    assert (said["verdict"], said["n_poses"]) == ("nothing", 99)
    assert any(f"pose {at} " in warning and "left out" in warning for warning in said["warnings"])


def test_an_outlier_does_not_hide_an_effect() -> None:
    targets = sweeps()
    poses = [
        replace(p, reading_deg=p.reading_deg - 0.04 * (p.approach or 0))
        for p in run_of(targets, approach=approaches(targets).tolist())
    ]
    poses[41] = replace(poses[41], reading_deg=poses[41].reading_deg + 5.0)
    assert [e["name"] for e in told(poses)["effects"]] == ["backlash"]


def test_a_covariate_that_is_the_row_number_is_not_accused() -> None:
    poses = with_column(run_of(sweeps(), seed=1), "row", np.arange(100.0))
    drifting = [replace(p, reading_deg=p.reading_deg + 3e-4 * (p.time_s or 0.0)) for p in poses]
    assert told(poses)["verdict"] == "nothing"
    said = told(drifting)
    assert [e["name"] for e in said["effects"]] == ["time_drift"]
    assert any("row says the same as" in warning for warning in said["warnings"])


@pytest.fixture(scope="module")
def warm_up() -> dict[str, Any]:
    path = DATA / "mpu6050_warmup_poses.csv"
    if not path.exists():
        pytest.skip(f"measured data are not here: {path}")
    return document(diagnose([read_poses(path.read_bytes()).poses]), ["1"])


def test_a_measured_warm_up_is_traced_to_temperature_and_not_to_time(warm_up: dict[str, Any]) -> None:
    names = [effect["name"] for effect in warm_up["effects"]]
    linear = warm_up["effects"][0]
    assert names == ["temperature_bias", "temperature_curvature"]
    assert linear["parameters"]["deg_per_c"]["value"] == pytest.approx(0.0164, abs=0.0005)
    assert (linear["origin"], linear["verdict"]) == ("sensor", "named")


def test_a_measured_warm_up_before_and_after(warm_up: dict[str, Any]) -> None:
    assert warm_up["base"]["fit_rms_deg"] == pytest.approx(0.062, abs=0.001)
    assert warm_up["final"]["fit_rms_deg"] <= 0.0064
    # one fold in four cannot tell the second-order term from noise that wanders, and does without
    assert warm_up["final"]["held_out_rms_deg"] <= 0.009


def test_rows_that_are_repeated_leave_no_freedom_for_a_curve():
    """Five places, each twice over: what bends through all of them has been tested by none."""
    there = np.repeat([0.0, 20.0, 45.0, 60.0, 90.0], 2)
    bent = np.repeat([0.0, 1.3, -0.4, 0.9, 0.2], 2)
    table = [
        Pose(float(x), float(x + y), covariates={"load": float(y)}) for x, y in zip(there, bent, strict=True)
    ]
    assert diagnose([table], bootstraps=199).findings.found == ()


def test_a_sensor_that_follows_less_is_off_by_what_it_is_off_a_line() -> None:
    """A potentiometer near its end: the slope of the good part, times the range, is no error."""
    angle_deg = np.arange(30.0, 151.0, 5.0)
    noise_deg = np.random.default_rng(5).normal(0.0, 0.3, len(angle_deg))
    reading_deg = angle_deg + 0.8 * np.maximum(45.0 - angle_deg, 0.0) + noise_deg
    diagnosed = diagnose(
        [posed(target_deg=angle_deg, reading_deg=reading_deg)], bootstraps=199, cross_fit=False
    )
    kink = next(
        e for e in document(diagnosed, ["a run"])["effects"] if "shape: kink" in " ".join(e["evidence"])
    )
    off_deg = reading_deg - np.polyval(np.polyfit(angle_deg, reading_deg, 1), angle_deg)
    assert kink["parameters"]["size_deg"]["value"] == pytest.approx(np.ptp(off_deg), rel=0.25)
