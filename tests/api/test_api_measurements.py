"""Poses and samples as JSON, CSV and npz; imports; units; the calibration; comparison; figures."""

from __future__ import annotations

import io
from urllib.parse import quote

import numpy as np
import pytest
from support import QUICK, declared, ended, running_service, serving

from calrig.analysis import comparison
from calrig.api import units

POSES = """\
target_deg,reading_deg,pass,approach,time_s,supply_v
-30,-29.5,0,1,1.0,3.3
0,0.4,0,1,2.0,
30,30.6,0,1,3.0,3.2
"""
SERIALS = ["AS-0042", "AS/0042", "a/b/c", "<b>é</b>", "50 %", "x?y=1&z#f", "calibration"]


@pytest.fixture(scope="module")
def measured(rig, tmp_path_factory):
    """A client and a completed run with its samples."""
    path = tmp_path_factory.mktemp("measured") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        run_id = client.post("/api/runs", json={"unit": "AS/1", "plan": QUICK}).json()["id"]
        yield client, ended(client, run_id)


def upload(client, content, unit="AS-1", **fields):
    return client.post("/api/imports", files={"file": ("poses.csv", content)}, data={"unit": unit, **fields})


def test_poses_as_csv_come_back_in_as_the_same_run(measured):
    client, run = measured
    text = client.get(f"/api/runs/{run['id']}/poses", headers={"Accept": "text/csv"}).text
    assert text == client.get(f"/api/runs/{run['id']}/poses?format=csv").text
    again = upload(client, text, unit="copy").json()
    for figure in ("bias_deg", "scale", "rms_raw_deg", "rms_calibrated_deg", "n_poses"):
        assert again["result"][figure] == pytest.approx(run["result"][figure], rel=1e-12)


@pytest.mark.parametrize("accept", ["*/*", "application/json", "application/json, text/csv", "text/html"])
def test_poses_are_json_unless_csv_is_asked_for(measured, accept):
    client, run = measured
    poses = client.get(f"/api/runs/{run['id']}/poses", headers={"Accept": accept}).json()
    assert [pose["index"] for pose in poses] == list(range(6))
    assert [pose["target_deg"] for pose in poses] == [-40, 0, 40, 40, 0, -40]
    assert [pose["pass"] for pose in poses] == [0, 0, 0, 1, 1, 1]


def test_samples_are_the_same_in_csv_and_npz(measured):
    client, run = measured
    url = f"/api/runs/{run['id']}/samples"
    arrays = np.load(io.BytesIO(client.get(f"{url}?format=npz").content))
    table = np.genfromtxt(io.StringIO(client.get(url).text), delimiter=",", names=True)
    assert list(arrays) == list(table.dtype.names)
    for name in arrays:
        np.testing.assert_array_equal(arrays[name], table[name])
    assert np.all(np.diff(arrays["time_s"]) > 0)
    dwell = np.load(io.BytesIO(client.get(f"{url}?pose=2&format=npz").content))
    pose = client.get(f"/api/runs/{run['id']}/poses").json()[2]
    for name in (
        f"{what}_{axis}_{unit}" for what, unit in (("accel", "g"), ("gyro", "dps")) for axis in "xyz"
    ):
        assert pose[name] == pytest.approx(dwell[name].mean()), name


def test_the_errors_of_the_poses_make_up_the_result(measured):
    client, run = measured
    poses = client.get(f"/api/runs/{run['id']}/poses").json()
    for error, figure in (("raw_error_deg", "rms_raw_deg"), ("residual_deg", "rms_calibrated_deg")):
        squares = [pose[error] ** 2 for pose in poses]
        assert np.sqrt(np.mean(squares)) == pytest.approx(run["result"][figure])


def test_the_samples_of_a_pose_are_those_its_means_come_from(measured):
    client, run = measured
    pose = client.get(f"/api/runs/{run['id']}/poses").json()[3]
    arrays = np.load(io.BytesIO(client.get(f"/api/runs/{run['id']}/samples?format=npz&pose=3").content))
    assert len(arrays["time_s"]) == pose["n_samples"]
    assert arrays["accel_y_g"].mean() == pytest.approx(pose["accel_y_g"], abs=1e-9)


@pytest.mark.parametrize(
    ("query", "status"), [("pose=99", 404), ("pose=-1", 422), ("pose=x", 422), ("format=xls", 422)]
)
def test_samples_that_are_not_there(measured, query, status):
    client, run = measured
    assert client.get(f"/api/runs/{run['id']}/samples?{query}").status_code == status


def test_an_imported_file_becomes_a_run(shared_client):
    made = upload(shared_client, ("\ufeff" + POSES.replace("\n", "\r\n")).encode(), "I-1")
    assert made.status_code == 201
    run = made.json()
    assert (run["status"], run["plan"], run["result"]["n_poses"]) == ("completed", None, 3)
    assert [pose["supply_v"] for pose in shared_client.get(f"/api/runs/{run['id']}/poses").json()] == [
        3.3,
        None,
        3.2,
    ]
    assert shared_client.get(f"/api/runs/{run['id']}").json() == run


@pytest.mark.parametrize(
    ("content", "words"),
    [
        pytest.param(POSES.replace("30.6", "thirty"), ("line 4", "reading_deg"), id="a word"),
        pytest.param("target_deg\n1\n", ("line 1", "reading_deg"), id="no readings"),
        pytest.param(b"\xff\xfe", ("UTF-8",), id="not text"),
        pytest.param("", ("empty",), id="empty"),
    ],
)
def test_a_bad_file_is_422_with_its_line_and_column_and_nothing_is_stored(shared_client, content, words):
    answer = upload(shared_client, content)
    assert answer.status_code == 422
    assert all(word in answer.json()["detail"] for word in ("poses.csv", *words))
    assert shared_client.get("/api/runs?unit=AS-1").json()["items"] == []


@pytest.mark.parametrize("unit", ["", " AS", "x" * 10_240])
def test_an_import_for_no_proper_serial_is_422(shared_client, unit):
    assert upload(shared_client, POSES, unit).status_code == 422


def test_an_import_without_a_file_or_as_something_else_is_422(shared_client):
    assert shared_client.post("/api/imports", data={"unit": "A"}).status_code == 422
    assert shared_client.post("/api/imports", json={"unit": "A"}).status_code == 422
    broken = {"Content-Type": "multipart/form-data; boundary=x"}
    assert shared_client.post("/api/imports", content=b"--y\r\n", headers=broken).status_code == 422


def test_an_import_beyond_what_an_upload_may_be_is_413(shared_client):
    kind = "multipart/form-data; boundary=x"
    status, detail = declared(shared_client, "/api/imports", kind, n_bytes=150_000_001)
    assert (status, "150 MB" in detail) == (413, True)


@pytest.mark.parametrize("serial", SERIALS)
def test_a_serial_number_may_hold_anything_printable(shared_client, serial):
    run_id = upload(shared_client, POSES, serial).json()["id"]
    url = f"/api/units/{quote(serial, safe='')}"
    unit = shared_client.get(url).json()
    assert (unit["serial"], unit["n_runs"], [run["id"] for run in unit["runs"]]) == (serial, 1, [run_id])
    assert shared_client.get(f"{url}/calibration").json()["unit"] == serial
    assert shared_client.get(f"{url}/figures/history").json()["data"]
    assert shared_client.get("/api/compare", params={"unit": serial}).json()["units"][0]["unit"] == serial


def test_the_calibration_in_force_is_the_latest_that_counts(shared_client):
    first = upload(shared_client, POSES, "C-1").json()
    second = upload(shared_client, POSES.replace("0.4", "0.5"), "C-1").json()
    document = shared_client.get("/api/units/C-1/calibration").json()
    assert document["schema"] == "calrig.calibration/2"
    assert (document["run_id"], document["bias_deg"]) == (second["id"], second["result"]["bias_deg"])
    shared_client.post(f"/api/runs/{second['id']}/void", json={"reason": "wrong unit"})
    assert shared_client.get("/api/units/C-1/calibration").json()["run_id"] == first["id"]
    assert shared_client.get("/api/units/C-1").json()["active_run_id"] == first["id"]


@pytest.mark.parametrize(
    "path",
    [
        "/api/units/nope",
        "/api/units/nope/calibration",
        "/api/units/nope/figures/history",
        "/api/compare?unit=nope",
    ],
)
def test_an_unknown_unit_is_404(shared_client, path):
    answer = shared_client.get(path)
    assert (answer.status_code, list(answer.json())) == (404, ["detail"])


def test_a_unit_whose_scale_is_not_known_has_no_calibration(shared_client):
    upload(shared_client, "target_deg,reading_deg\n0,0.1\n0,0.2\n", "N-1")
    assert shared_client.get("/api/units/N-1").json()["active_run_id"] is None
    assert shared_client.get("/api/units/N-1/calibration").status_code == 404


def test_units_are_compared_in_the_order_asked_for(client):
    for unit, bias in (("A", 0.0), ("A", 0.1), ("B", 3.0), ("B", 3.1)):
        upload(client, f"target_deg,reading_deg\n-30,{-30 + bias}\n0,{bias}\n30,{30 + bias}\n", unit)
    compared = client.get("/api/compare?unit=B&unit=A").json()
    assert [unit["unit"] for unit in compared["units"]] == ["B", "A"]
    assert [run["bias_deg"] for run in compared["units"][1]["runs"]] == pytest.approx([0.0, 0.1])
    spread = compared["spread"]["bias_deg"]
    assert spread["within_unit_std"] == pytest.approx(0.1 / 2**0.5)
    assert spread["between_units_std"] == pytest.approx(3 / 2**0.5, rel=1e-3)
    assert "too few repeated runs" in spread["says"]
    upload(client, "target_deg,reading_deg\n-30,-29.9\n0,0.1\n30,30.1\n", "A")
    says = client.get("/api/compare").json()["spread"]["bias_deg"]["says"]
    assert "times the repeatability" in says
    assert [unit["unit"] for unit in client.get("/api/compare").json()["units"]] == ["A", "B"]


@pytest.mark.parametrize("name", ["timeline", "residual"])
def test_a_run_has_its_pictures(measured, name):
    client, run = measured
    figure = client.get(f"/api/runs/{run['id']}/figures/{name}").json()
    assert len(figure["data"][0]["x"]) >= 3


def test_many_units_are_compared_by_another_process(measured, monkeypatch):
    client, run = measured
    paths = [
        "/api/compare",
        f"/api/compare?unit={run['unit']}",
        "/api/compare/figures/bias",
        "/api/compare/figures/residuals",
    ]
    here = [client.get(path).raise_for_status().json() for path in paths]
    monkeypatch.setattr(units, "FEW_UNITS", 0)
    monkeypatch.setattr(comparison, "compared_runs", None)  # of the service's own process
    assert [client.get(path).raise_for_status().json() for path in paths] == here
    assert client.get("/api/compare?unit=nobody").status_code == 404


@pytest.mark.parametrize("name", ["bias", "scale", "rms", "residuals"])
def test_a_comparison_has_its_pictures(measured, name):
    client, run = measured
    figure = client.get(f"/api/compare/figures/{name}", params={"unit": run["unit"]}).json()
    assert figure["data"]


def test_pictures_that_there_are_not(measured):
    client, run = measured
    assert client.get(f"/api/runs/{run['id']}/figures/mona-lisa").status_code == 422
    assert client.get("/api/compare/figures/mona-lisa").status_code == 422
