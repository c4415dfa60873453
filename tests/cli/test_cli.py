"""The command line as a person or script uses it: exit status, standard output, one line of reason."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import httpx
import pytest
from support import QUICK, ended, wait_for

from calrig.store import Store

CONFIG = """
[[rig]]
name = "bench-1"
reference = { std_deg = 0.29, kind = "common" }
simulated = { seed = 1, time_scale = 20.0, mount = { offset_deg = 0.8 } }
"""
POSES = "target_deg,reading_deg\n-30,-29.5\n0,0.4\n30,30.6\n"
CALRIG = (sys.executable, "-m", "calrig")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a configuration, a plan and poses; the store of every command lies in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALRIG_DB", str(tmp_path / "calrig.db"))
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "calrig.toml").write_text(CONFIG)
    (tmp_path / "plan.json").write_text(json.dumps(QUICK))
    (tmp_path / "poses.csv").write_text(POSES)
    return tmp_path


def calrig(*arguments: str, status: int = 0) -> subprocess.CompletedProcess[str]:
    """Runs a command; whatever a user does, there is never a traceback."""
    done = subprocess.run([*CALRIG, *arguments], capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode == status, done.stdout + done.stderr
    return done


def reason(*arguments: str, status: int) -> str:
    """The one line on standard error with which a command fails."""
    done = calrig(*arguments, status=status)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    return line


def test_version():
    assert re.fullmatch(r"calrig \d+\.\d+\.\d+", calrig("--version").stdout.strip())


def test_wrong_usage_is_2():
    assert "--unitt" in calrig("run", "--unitt", "A", status=2).stderr
    calrig("frobnicate", status=2)
    calrig("run", status=2)
    calrig("serve", "--port", "70000", status=2)


def test_rigs_lists_what_is_configured(folder):
    shown = calrig("rigs").stdout
    assert "bench-1" in shown
    assert "simulated" in shown


def test_a_run_ends_in_a_table(folder):
    done = calrig("run", "--unit", "AS-0042", "--plan", "plan.json", "--operator", "Ada")
    (bias,) = re.findall(r"│ bias .*", done.stdout)
    value, std, stage = (float(number) for number in re.findall(r"(-?\d+\.\d+)°", bias))
    assert value == pytest.approx(0.8, abs=0.2)  # the simulated mount's offset
    assert std == pytest.approx(0.01, abs=0.009)
    assert stage == pytest.approx(0.29, rel=0.01)  # what the rig says, times the scale
    assert done.stderr == ""


def test_on_a_terminal_a_run_shows_how_far_it_is(folder):
    near, far = pty.openpty()
    command = [*CALRIG, "run", "--unit", "AS-0042", "--plan", "plan.json", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=far, text=True) as process:
        os.close(far)
        shown = _everything(near)
        assert json.loads(process.stdout.read())["status"] == "completed"
    assert "6/6" in shown
    assert re.search(r"[+-]\d+\.\d°", shown)
    assert "left" in shown


def _everything(terminal: int) -> str:
    """What was written to a terminal until its other end was closed."""
    parts = []
    while True:
        try:
            part = os.read(terminal, 4096)
        except OSError:  # how Linux tells that nobody is left at the other end
            break
        parts.append(part)
    os.close(terminal)
    return b"".join(parts).decode()


def test_a_run_in_json_is_one_document_on_standard_output(folder):
    run = json.loads(calrig("run", "--unit", "AS-0042", "--plan", "plan.json", "--json").stdout)
    assert (run["status"], run["unit"], run["result"]["n_poses"]) == ("completed", "AS-0042", 6)
    assert run["result"]["bias_deg"] == pytest.approx(0.8, abs=0.2)  # the simulated mount's offset


def test_a_failed_run_is_1_and_json_still_says_what_happened(folder):
    (folder / "calrig.toml").write_text(
        '[[rig]]\nname = "ghost"\n'
        'stage = { driver = "smc100", port = "/dev/ttyABSENT0" }\n'
        'imu = { driver = "calrig", port = "/dev/ttyABSENT1" }\n'
    )
    done = calrig("run", "--unit", "A", "--json", status=1)
    assert "/dev/ttyABSENT0" in json.loads(done.stdout)["error"]
    assert "/dev/ttyABSENT0" in done.stderr.splitlines()[-1]


def test_ctrl_c_aborts_the_run_and_keeps_its_poses(folder):
    (folder / "plan.json").write_text(json.dumps({**QUICK, "sweeps": 300}))
    command = [*CALRIG, "run", "--unit", "A", "--plan", "plan.json", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    database = folder / "calrig.db"
    wait_for(lambda: database.exists() and _poses_stored(database), "first pose")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=10)
    run = json.loads(out)
    assert (process.returncode, run["status"]) == (1, "aborted"), err
    assert run["progress"]["poses_done"] >= 1
    assert "Traceback" not in err


def _poses_stored(database: Path) -> int:
    import sqlite3

    try:
        with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
            return connection.execute("SELECT count(*) FROM pose").fetchone()[0]
    except sqlite3.OperationalError:  # not made yet
        return 0


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        pytest.param('{\n  "sweeps": 4,\n  "step_deg" 5\n}', "plan.json, line 3, column 14", id="no JSON"),
        pytest.param(
            '{\n  "sweeps": 4,\n  "stepp": 5\n}', "plan.json, line 3, column 3: stepp", id="unknown"
        ),
        pytest.param('{"sweeps": "many"}', "plan.json, line 1, column 2: sweeps", id="wrong value"),
        pytest.param('{"sweeps": 9999}', "plan.json: the plan has", id="too many poses"),
        pytest.param('{"elevations_deg": [120]}', "120", id="beyond the limits"),
        pytest.param("[]", "plan.json", id="no object"),
    ],
)
def test_a_plan_at_fault_is_2_and_says_where(folder, plan, words):
    (folder / "plan.json").write_text(plan)
    assert words in reason("run", "--unit", "A", "--plan", "plan.json", status=2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        pytest.param(["--plan", "absent.json"], "absent.json", id="no plan"),
        pytest.param(["--rig", "bench-9"], "bench-9", id="unknown rig"),
        pytest.param(["--config", "absent.toml"], "absent.toml", id="no configuration"),
        pytest.param(["--unit", ""], "serial", id="empty serial"),
    ],
)
def test_wrong_input_of_a_run_is_2(folder, arguments, words):
    unit = [] if "--unit" in arguments else ["--unit", "A"]
    assert words in reason("run", *unit, *arguments, status=2)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        pytest.param("[[rig]\n", "line 1", id="no TOML"),
        pytest.param('[[rig]]\nname = "x"\nsimulated = { presset = "demo" }', "presset", id="unknown option"),
        pytest.param('[[rig]]\nname = "x"\nsimulatd = {}', "simulatd", id="unknown key"),
    ],
)
def test_a_configuration_at_fault_is_2(folder, config, words):
    (folder / "calrig.toml").write_text(config)
    assert words in reason("run", "--unit", "A", status=2)


def test_import_prints_the_run_id_and_export_gives_the_calibration_and_its_poses(folder):
    imported = calrig("import", "poses.csv", "--unit", "A/1")
    assert (imported.stdout, imported.stderr) == ("1\n", "")
    by_run = json.loads(calrig("export", "1").stdout)
    assert by_run == json.loads(calrig("export", "--unit", "A/1").stdout)
    assert (by_run["schema"], by_run["unit"], by_run["run_id"]) == ("calrig.calibration/1", "A/1", "1")
    text = calrig("export", "--unit", "A/1", "--format", "csv").stdout
    assert text == calrig("export", "1", "--format", "csv").stdout
    (folder / "again.csv").write_text(text)
    calrig("import", "again.csv", "--unit", "B")
    assert json.loads(calrig("export", "--unit", "B").stdout)["bias_deg"] == by_run["bias_deg"]


def test_a_bad_file_is_2_with_line_and_column_and_a_missing_one_too(folder):
    (folder / "poses.csv").write_text(POSES.replace("30.6", "thirty"))
    said = reason("import", "poses.csv", "--unit", "A", status=2)
    assert all(word in said for word in ("poses.csv", "line 4", "reading_deg"))
    assert "absent.csv" in reason("import", "absent.csv", "--unit", "A", status=2)


def test_what_there_is_not_to_export_is_1(folder):
    calrig("import", "poses.csv", "--unit", "A")
    assert "99" in reason("export", "99", status=1)
    assert "nope" in reason("export", "--unit", "nope", status=1)
    calrig("export", status=2)
    calrig("export", "1", "--unit", "A", status=2)


def test_a_store_that_is_none_is_1(folder, monkeypatch):
    (folder / "calrig.db").write_text("this is not a database at all, and it is longer than its header")
    assert "calrig.db" in reason("import", "poses.csv", "--unit", "A", status=1)
    assert "elsewhere.db" in reason("export", "1", "--db", "elsewhere.db", status=1)


class Served:
    """`calrig serve` as a process, and a client of it."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [*CALRIG, "serve", "--port", "0", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.line = self.process.stdout.readline()
        found = re.search(r"http://[\d.]+:\d+", self.line)
        assert found, self.line + (self.process.stderr.read() if self.process.stderr else "")
        self.client = httpx.Client(base_url=found.group(), timeout=20)

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def end(self, sign: signal.Signals) -> tuple[int, str]:
        """Sends a signal; returns exit status and standard error. Five seconds are all it has."""
        self.process.send_signal(sign)
        _, err = self.process.communicate(timeout=5)
        return self.process.returncode, err


@pytest.fixture
def served(folder):
    with Served() as served:
        yield served


def test_serve_says_where_and_what_and_a_run_goes_through(served):
    assert "calrig.db" in served.line
    assert "bench-1 (simulated)" in served.line
    run_id = served.client.post("/api/runs", json={"unit": "A", "plan": QUICK}).json()["id"]
    assert ended(served.client, run_id)["status"] == "completed"
    assert served.client.get("/").headers["content-type"].startswith("text/html")
    assert (
        served.client.get("/web/vendor/plotly-partial.min.js")
        .headers["content-type"]
        .startswith("text/javascript")
    )


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_serve_ends_in_order_with_a_run_and_a_browser_on_it(served, sign, folder):
    run_id = served.client.post("/api/runs", json={"unit": "A", "plan": {**QUICK, "sweeps": 300}}).json()[
        "id"
    ]
    watched = threading.Event()

    def watch() -> None:
        with served.client.stream("GET", f"/api/runs/{run_id}/events") as answer:
            for line in answer.iter_lines():
                if line == "event: pose":
                    watched.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    assert watched.wait(20)
    status, err = served.end(sign)
    watcher.join(5)
    assert status == 0
    assert re.findall(r"Z (?:error|critical) .*|Traceback", err) == []
    with Store.open(f"sqlite:///{folder / 'calrig.db'}", writer=None) as store:
        run = store.run(run_id)
    assert run.status == "interrupted"
    assert run.progress["poses_done"] >= 1


def test_a_service_that_was_killed_leaves_no_device_behind_and_a_run_that_says_so(served):
    psutil = pytest.importorskip("psutil")
    plan = {**QUICK, "sweeps": 300}
    run_id = served.client.post("/api/runs", json={"unit": "A", "plan": plan}).json()["id"]
    devices = psutil.Process(served.process.pid).children(recursive=True)
    assert devices
    served.process.kill()
    served.process.communicate()
    _, alive = psutil.wait_procs(devices, timeout=10)
    assert not alive
    with Served() as again:
        assert again.client.get(f"/api/runs/{run_id}").json()["status"] == "interrupted"


def test_a_store_that_is_held_says_by_whom(served):
    said = reason("import", "poses.csv", "--unit", "A", status=1)
    assert f"process {served.process.pid}" in said
    assert "calrig serve" in said
    assert calrig("rigs").returncode == 0


def test_a_port_in_use_is_1_and_says_which_and_what_to_do(folder):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = reason("serve", "--port", str(port), status=1)
    assert f"127.0.0.1:{port} is in use" in said
    assert "--port" in said
