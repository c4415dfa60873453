"""Noise and filters over HTTP: of a static run, of a run with moves, of a log that somebody brings."""

from __future__ import annotations

import numpy as np
import pytest
from support import QUICK, ended

WHITE_MG_SQRT_S = 0.4
RATE_HZ = 100.0


def log_csv(seconds: float = 30.0) -> str:
    rng = np.random.default_rng(5)
    n = int(seconds * RATE_HZ)
    std_g = 1e-3 * WHITE_MG_SQRT_S * np.sqrt(RATE_HZ)
    columns = [np.arange(n) / RATE_HZ, *rng.normal(0.0, std_g, (2, n)), 1.0 + rng.normal(0.0, std_g, n)]
    rows = (",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True))
    return "\n".join(["time_s,accel_x_g,accel_y_g,accel_z_g", *rows])


@pytest.fixture(scope="module")
def static_run(shared_client):
    plan = {"kind": "static", "dwell_s": 20.0, "settle_s": 0.5}
    begun = shared_client.post("/api/runs", json={"unit": "N-1", "plan": plan}).raise_for_status().json()
    run = ended(shared_client, begun["id"])
    assert (run["status"], run["error"]) == ("completed", None)
    return run


def test_a_static_run_tells_the_noise_of_every_channel(shared_client, static_run):
    found = shared_client.get(f"/api/runs/{static_run['id']}/noise").raise_for_status().json()
    report = found["report"]
    assert report["rate_hz"] == pytest.approx(200.0, rel=1e-3)
    assert report["duration_s"] == pytest.approx(20.0, abs=0.1)
    gyro = report["channels"]["gyro_x_dps"]
    # The simulated chip has the data sheet's 0.005 °/s/√Hz one-sided: N is 1/√2 of it.
    assert gyro["coefficients"]["white"]["value"] == pytest.approx(0.005 / np.sqrt(2), rel=0.1)
    assert gyro["colour"] in {"white", "lines"}, "of 300 white logs one shows a line by chance"
    assert list(report["channels"])[-1] == "elevation_deg"
    assert report["summary"]
    assert {"Distribution, gyro_x_dps"} < {one["caption"] for one in found["figures"]}


def test_the_units_noise_is_in_kalibrs_file(shared_client, static_run):
    answer = shared_client.get("/api/units/N-1/calibration?format=kalibr").raise_for_status()
    assert f"unit N-1, static run {static_run['id']}" in answer.text
    density = float(answer.text.split("gyroscope_noise_density: ")[1].split()[0])
    assert np.degrees(density) == pytest.approx(0.005 / np.sqrt(2), rel=0.2)


def test_a_run_with_moves_has_no_static_log_but_its_filters_are_compared(shared_client):
    begun = shared_client.post("/api/runs", json={"unit": "N-2", "plan": QUICK}).json()
    run = ended(shared_client, begun["id"])
    refused = shared_client.get(f"/api/runs/{run['id']}/noise")
    assert (refused.status_code, "static plan" in refused.json()["detail"]) == (409, True)
    report = shared_client.get(f"/api/runs/{run['id']}/filters").raise_for_status().json()["report"]
    rows = {row["name"]: row for row in report["filters"]}
    assert rows["kalman_paper"]["jitter_deg"] < rows["raw"]["jitter_deg"]
    assert report["n_moves"] >= 4


def test_a_log_of_ones_own_is_analysed_and_not_stored(shared_client):
    before = shared_client.get("/api/runs").json()
    answer = shared_client.post("/api/noise", files={"file": ("mine.csv", log_csv())})
    channel = answer.raise_for_status().json()["report"]["channels"]["accel_x_g"]
    assert channel["coefficients"]["white"]["value"] == pytest.approx(1e-3 * WHITE_MG_SQRT_S, rel=0.1)
    assert shared_client.get("/api/runs").json() == before


@pytest.mark.parametrize("path", ["/api/noise", "/api/filters"])
def test_a_bad_log_is_refused_with_its_place(shared_client, path):
    text = "time_s,accel_y_g,accel_z_g\n0,0,1\n0.01,zero,1\n"
    answer = shared_client.post(path, files={"file": ("mine.csv", text)})
    assert answer.status_code == 422
    assert "mine.csv" in answer.json()["detail"]
    assert "line 3" in answer.json()["detail"]
