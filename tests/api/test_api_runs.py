"""Starting a run over HTTP, watching it, asking things of it; and everything a client can get wrong."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime

import httpx
import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo
from simulated_devices import plug
from support import (
    LONG,
    PATIENCE_S,
    POSES,
    QUICK,
    declared,
    ended,
    imported,
    running_service,
    serving,
    wait_for,
)

from calrig.api import runs
from calrig.runs.single_flight import SingleFlight
from calrig.settings import BoardSettings, RigSettings, StageSettings


def start(client: httpx.Client, unit: str = "AS-0042", plan: dict | None = None, **fields):
    answer = client.post("/api/runs", json={"unit": unit, "plan": plan or QUICK, **fields})
    assert answer.status_code == 201, answer.text
    return answer.json()


def begun(client: httpx.Client, run_id: str) -> dict:
    """The run once it has taken its first pose."""
    return wait_for(
        lambda: (run := client.get(f"/api/runs/{run_id}").json())["progress"]["poses_done"] and run,
        "first pose",
    )


@pytest.fixture
def long_run(shared_client):
    """A run that is under way, aborted after the test."""
    run = start(shared_client, plan=LONG)
    yield begun(shared_client, run["id"])
    shared_client.post(f"/api/runs/{run['id']}/abort")


def test_health_says_the_version(shared_client):
    assert shared_client.get("/api/health").json() == {"status": "ok", "version": "0.1.0"}


def test_a_run_goes_from_start_to_result(shared_client):
    run = start(shared_client, operator="Ada", note="first light")
    assert run["status"] in {"queued", "running"}
    assert (run["operator"], run["note"], run["rig"]) == ("Ada", "first light", "bench-1")
    run = ended(shared_client, run["id"])
    assert (run["status"], run["error"]) == ("completed", None)
    done = {"poses_done": 6, "poses_total": 6, "fraction": 1.0, "remaining_s": 0.0, "waiting_for": None}
    assert run["progress"] == done
    assert run["result"]["bias_deg"] == pytest.approx(0.8, abs=0.2)  # the simulated mount's offset
    assert run["result"]["gyro"]["bias_dps"] == pytest.approx([1.4, -0.6, 0.3], abs=0.1)
    assert run["created_at"].endswith("Z")
    assert run["finished_at"].endswith("Z")


def test_a_rig_is_idle_then_busy_and_refuses_a_second_run(shared_client, long_run):
    (rig,) = shared_client.get("/api/rigs").json()
    assert rig == {
        "name": "bench-1",
        "stage": "smc100",
        "imu": "calrig",
        "simulated": True,
        "state": "busy",
        "run_id": long_run["id"],
        "bench": None,  # of a centre's rigs
        "hall": None,
        "last_seen_at": None,
        "clamp": None,
        "stop_asked_at": None,
    }
    refused = shared_client.post("/api/runs", json={"unit": "AS-2"})
    assert refused.status_code == 409
    assert long_run["id"] in refused.json()["detail"]
    shared_client.post(f"/api/runs/{long_run['id']}/abort")
    assert shared_client.get("/api/rigs").json()[0]["state"] == "idle"


def test_abort_keeps_the_poses_measured_so_far(shared_client, long_run):
    run = shared_client.post(f"/api/runs/{long_run['id']}/abort").json()
    assert run["status"] == "aborted"
    assert len(shared_client.get(f"/api/runs/{run['id']}/poses").json()) == run["progress"]["poses_done"] > 0
    again = shared_client.post(f"/api/runs/{run['id']}/abort")
    assert again.status_code == 409


def test_pause_holds_after_the_pose_and_resume_goes_on(shared_client, long_run):
    url = f"/api/runs/{long_run['id']}"
    assert shared_client.post(f"{url}/pause").status_code == 200
    held = wait_for(lambda: (run := shared_client.get(url).json())["status"] == "paused" and run, "pause")
    assert shared_client.post(f"{url}/resume").status_code == 200
    done = held["progress"]["poses_done"]
    wait_for(lambda: shared_client.get(url).json()["progress"]["poses_done"] > done, "next pose")


def test_resuming_what_is_not_paused_is_a_conflict(shared_client, long_run):
    assert shared_client.post(f"/api/runs/{long_run['id']}/resume").status_code == 409


def test_a_voided_run_stays_with_its_reason_and_counts_no_more(shared_client):
    run_id = imported(shared_client, "V-1")["id"]
    assert shared_client.get("/api/units/V-1/calibration").status_code == 200
    run = shared_client.post(f"/api/runs/{run_id}/void", json={"reason": "the table was bumped"}).json()
    assert run["voided"]["reason"] == "the table was bumped"
    (revision,) = shared_client.get("/api/units/V-1/calibrations").json()
    assert revision["status"] == "in_force", "there is nothing to put in its place"
    assert revision["stale"] == [f"Run {run_id[:8]} has been voided: the table was bumped"]
    assert shared_client.get("/api/compare?unit=V-1").json()["units"][0]["runs"] == []
    assert shared_client.get(f"/api/runs/{run_id}").json()["result"] == run["result"]


def test_an_excluded_pose_stays_and_the_result_is_computed_without_it(shared_client):
    run = imported(shared_client, "E-1")
    url = f"/api/runs/{run['id']}"
    changed = shared_client.post(f"{url}/poses/2/exclude", json={"reason": "somebody sneezed"}).json()
    assert changed["result"]["n_poses"] == run["result"]["n_poses"] - 1
    assert changed["result"]["bias_deg"] != run["result"]["bias_deg"]
    poses = shared_client.get(f"{url}/poses").json()
    assert [pose["excluded"] for pose in poses] == [None, None, "somebody sneezed", None]
    assert len(shared_client.get(f"{url}/poses?format=csv").text.splitlines()) == 1 + 3


def test_poses_excluded_one_after_the_other_are_all_out_of_result_and_calibration(shared_client):
    run = imported(shared_client, "AS-out")
    for index in (0, 3):
        shared_client.post(f"/api/runs/{run['id']}/poses/{index}/exclude", json={"reason": "a bumped table"})
    assert shared_client.get(f"/api/runs/{run['id']}").json()["result"]["n_poses"] == 2
    assert shared_client.get("/api/units/AS-out/calibration").json()["range_deg"] == [-10, 10]


def test_runs_are_listed_newest_first_page_by_page(client):
    made = [imported(client, unit)["id"] for unit in ("A", "B", "A")]
    first = client.get("/api/runs?limit=2").json()
    rest = client.get("/api/runs", params={"limit": 2, "cursor": first["next_cursor"]}).json()
    assert [run["id"] for run in first["items"] + rest["items"]] == made[::-1]
    assert rest["next_cursor"] is None
    assert [run["id"] for run in client.get("/api/runs?unit=A").json()["items"]] == [made[2], made[0]]
    assert client.get("/api/runs?status=failed").json()["items"] == []


PATHS = [
    ("GET", ""),
    ("GET", "/events"),
    ("GET", "/poses"),
    ("GET", "/samples"),
    ("GET", "/figures/timeline"),
    ("POST", "/abort"),
    ("POST", "/pause"),
    ("POST", "/resume"),
    ("POST", "/void"),
    ("POST", "/poses/0/exclude"),
]


def test_a_run_is_known_by_its_whole_id_alone(shared_client):
    run_id = imported(shared_client, "K-1")["id"]
    assert shared_client.get(f"/api/runs/{run_id}").status_code == 200
    for other in (run_id[:8], run_id.upper(), f"{run_id}0"):
        assert shared_client.get(f"/api/runs/{other}").status_code == 404


@pytest.mark.parametrize("run_id", ["999", "nope", "1 OR 1=1", "-1", "9" * 40])
@pytest.mark.parametrize(("method", "path"), PATHS)
def test_an_unknown_run_is_404_on_every_path(shared_client, method, path, run_id):
    answer = shared_client.request(method, f"/api/runs/{run_id}{path}")
    assert (answer.status_code, list(answer.json())) == (404, ["detail"])


@pytest.mark.parametrize(
    ("body", "words"),
    [
        pytest.param({"unit": ""}, "serial", id="empty serial"),
        pytest.param({"unit": "x" * 10_240}, "serial", id="10 kB serial"),
        pytest.param({"unit": "A\x00B"}, "serial", id="unprintable serial"),
        pytest.param({}, "Unit's serial number is missing", id="no unit"),
        pytest.param({"unit": "A", "rigg": "bench-1"}, "rigg", id="unknown field"),
        pytest.param({"unit": "A", "plan": {"swepes": 4}}, "swepes", id="unknown plan field"),
        pytest.param({"unit": "A", "plan": {"sweeps": 0}}, "Sweeps must be at least 1", id="no poses"),
        pytest.param({"unit": "A", "plan": {"elevations_deg": []}}, "Elevations", id="no elevations"),
        pytest.param({"unit": "A", "plan": {"sweeps": 10_000}}, "poses", id="100,000 poses"),
        pytest.param(
            {"unit": "A", "plan": {"elevations_deg": [0] * 100_000}}, "10000", id="100,000 elevations"
        ),
        pytest.param({"unit": "A", "plan": {"elevations_deg": [0, 91]}}, "91", id="beyond the limits"),
        pytest.param({"unit": "A", "plan": {"kind": "diagnosis"}}, "kind", id="unknown kind"),
    ],
)
def test_a_run_that_cannot_be_is_422_and_nothing_is_stored(shared_client, body, words):
    before = shared_client.get("/api/runs").json()
    answer = shared_client.post("/api/runs", json=body)
    assert answer.status_code == 422
    assert words in answer.json()["detail"]
    assert shared_client.get("/api/runs").json() == before


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(b'{"unit": "A", "plan": {"dwell_s": NaN}}', id="NaN"),
        pytest.param(b'{"unit": "A", "plan": {"dwell_s": 1e999}}', id="infinity"),
        pytest.param(b'{"unit": "\\ud800"}', id="half a character"),
        pytest.param(b'{"unit": "A"', id="cut off"),
        pytest.param(b"[" * 100_000, id="deep"),
        pytest.param(b"\xff\xfe", id="not text"),
    ],
)
def test_a_body_that_is_no_json_is_422(shared_client, text):
    answer = shared_client.post("/api/runs", content=text, headers={"Content-Type": "application/json"})
    assert (answer.status_code, list(answer.json())) == (422, ["detail"])


def test_an_unknown_rig_is_404_and_says_which_there_are(shared_client):
    answer = shared_client.post("/api/runs", json={"unit": "A", "rig": "bench-9"})
    assert answer.status_code == 404
    assert "bench-1" in answer.json()["detail"]


def test_a_json_body_that_says_it_is_beyond_a_megabyte_is_413_at_once(shared_client):
    status, detail = declared(shared_client, "/api/runs", "application/json", n_bytes=1_000_001)
    assert (status, "1 MB" in detail) == (413, True)


def test_a_json_body_that_turns_out_to_be_beyond_a_megabyte_is_413(shared_client):
    chunks = (b'{"unit": "A", "note": "', *[b"x" * 10_000] * 110)
    headers = {"Content-Type": "application/json"}
    answer = shared_client.post("/api/runs", content=iter(chunks), headers=headers)
    assert answer.status_code == 413
    assert "1 MB" in answer.json()["detail"]


def test_a_port_that_is_not_there_becomes_a_failed_run_with_a_reason(store_path):
    absent = RigSettings(
        name="ghost",
        stage=StageSettings(driver="smc100", port="/dev/ttyABSENT0"),
        imu=BoardSettings(driver="calrig", port="/dev/ttyABSENT1"),
    )
    with running_service(store_path, absent) as service, serving(service) as client:
        assert client.get("/api/rigs").json()[0]["state"] == "unreachable"
        run = ended(client, start(client)["id"])
        assert (run["status"], run["progress"]["poses_done"]) == ("failed", 0)
        assert "/dev/ttyABSENT0" in run["error"]
        assert client.get("/api/rigs").json()[0]["run_id"] is None


def test_runs_are_found_over_http(shared_client):
    run = imported(shared_client, "Seek-1")
    asked = {"q": "sEEK", "kind": "import", "from": run["created_at"], "to": run["created_at"][:10]}
    found = shared_client.get("/api/runs", params=asked).json()["items"]
    assert [one["id"] for one in found] == [run["id"]]
    left = run["verdict"]["left"] or "no_limits"
    assert shared_client.get("/api/runs", params={**asked, "verdict": left}).json()["items"] == found
    none = shared_client.get("/api/runs", params={"q": "seek", "verdict": "fail"})
    assert none.json() == {"items": [], "next_cursor": None}
    looked_at = datetime.fromisoformat(none.headers["Calrig-Back-To"])
    assert looked_at == datetime.fromisoformat(run["created_at"])
    before = {"q": "seek", "to": run["created_at"]}
    assert shared_client.get("/api/runs", params=before).json()["items"] == []
    refused = shared_client.get("/api/runs", params={"from": "yesterday"})
    assert (refused.status_code, "from: 'yesterday'" in refused.json()["detail"]) == (422, True)


def test_an_estimate_says_the_walls_time_once_the_rig_has_told_how_fast_its_clocks_run(client):
    run = ended(client, start(client)["id"])
    said = client.post("/api/plans/estimate", json={"plan": QUICK}).json()
    began, finished = (datetime.fromisoformat(run[key]) for key in ("started_at", "finished_at"))
    assert said["wall_s"] == pytest.approx((finished - began).total_seconds(), rel=1e-3)


def test_a_look_at_the_ports_tells_who_answers_and_what_to_configure(shared_client, monkeypatch):
    plug(monkeypatch, ttyUSB0="grbl", ttyUSB1="calrig")
    answer = shared_client.post("/api/rigs/scan").raise_for_status().json()
    on = {one["port"]: one for one in answer["found"]}
    assert (on["ttyUSB0"]["kind"], on["ttyUSB0"]["driver"]) == ("stage", "grbl")
    assert "AS-0042" in on["ttyUSB1"]["identity"]
    assert 'driver = "calrig", port = "ttyUSB1"' in answer["stanza"]
    assert 'name = "bench-2"' in answer["stanza"]  # the service's own rig is bench-1


def test_without_a_port_there_is_nothing(shared_client, monkeypatch):
    monkeypatch.setattr(list_ports, "comports", list)
    assert shared_client.post("/api/rigs/scan").json() == {"found": [], "stanza": ""}


def test_the_ports_of_the_services_own_rigs_stay_free_for_a_stop(shared_client, rig, monkeypatch):
    ports = [rig.stage.port, rig.imu.port]
    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(port) for port in ports])
    answer = shared_client.post("/api/rigs/scan").raise_for_status().json()
    assert [(one["port"], one["kind"]) for one in answer["found"]] == [(p, "busy") for p in sorted(ports)]
    assert all("a rig of this service" in one["identity"] for one in answer["found"])


def test_who_asks_while_the_ports_are_looked_at_shares_that_look_and_takes_no_thread(
    shared_client, monkeypatch
):
    looks, go_on = [], threading.Event()

    def look(*, ours):
        looks.append(ours)
        assert go_on.wait(PATIENCE_S)
        return []

    shared: list = []
    share = SingleFlight.share
    monkeypatch.setattr(SingleFlight, "share", lambda *of: (share(*of), shared.append(of))[0])
    monkeypatch.setattr(runs.ports, "scan", look)
    crowd = 60  # more than there are threads for requests
    with ThreadPoolExecutor(crowd) as beside:
        asked = [beside.submit(shared_client.post, "/api/rigs/scan") for _ in range(crowd)]
        wait_for(lambda: len(shared) == crowd, "all of them")
        assert shared_client.get("/api/rigs").status_code == 200
        go_on.set()
        assert {answer.result().status_code for answer in asked} == {200}
    assert len(looks) == 1


def test_an_import_into_a_store_whose_file_was_deleted_is_refused(client, store_path):
    imported(client, "AS-1")
    store_path.unlink()
    refused = client.post("/api/imports", files={"file": ("poses.csv", POSES)}, data={"unit": "AS-2"})
    assert refused.status_code == 503
    assert "was deleted or replaced by another file" in refused.json()["detail"]
    assert not store_path.exists()
