"""What only a process shows: signals, a terminal, `python -m calrig`, a service that is killed.

Nothing here waits for a time: a test that hangs is ended by pytest's own limit.
"""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest
from command_line import RIG, calrig
from support import LONG, QUICK, program

from calrig.store import Store

CALRIG = (sys.executable, "-m", "calrig")
SIMULATED = """
[[rig]]
name = "bench-1"
reference = { std_deg = 0.29, kind = "common" }

[rig.simulated]
seed = 1
time_scale = 20.0
stage = { velocity_dps = 60.0, acceleration_dps2 = 240.0, homing_velocity_dps = 30.0 }
mount = { offset_deg = 0.8 }
"""


@pytest.fixture
def bench(folder):
    """As `folder`, with a rig that the command starts itself."""
    (folder / "calrig.toml").write_text(SIMULATED)
    (folder / "quick.json").write_text(json.dumps(QUICK))
    (folder / "long.json").write_text(json.dumps(LONG))
    return folder


@contextmanager
def on_a_terminal(*arguments):
    """A command whose standard error is a terminal: the process, and the terminal's other end."""
    near, far = pty.openpty()
    with program(*CALRIG, *arguments, stderr=far) as process:
        os.close(far)
        try:
            yield process, near
        finally:
            os.close(near)


def shown_until(pattern, terminal):
    """What was written to a terminal until something like the pattern came, or its other end was closed."""
    shown = ""
    while pattern is None or not re.search(pattern, shown):
        try:
            shown += os.read(terminal, 4096).decode(errors="replace")
        except OSError:  # how Linux tells that nobody is left at the other end
            assert pattern is None, shown
            break
    return shown


def test_on_a_terminal_a_run_shows_how_far_it_is_and_ends_in_a_table(bench):
    with on_a_terminal("run", "--unit", "AS-0042", "--plan", "quick.json") as (process, terminal):
        shown = shown_until(None, terminal)
        printed = process.stdout.read()
    assert process.returncode == 0, shown
    assert "6/6" in shown
    assert re.search(r"[+-]\d+\.\d°", shown)
    assert "left" in shown
    (bias,) = re.findall(r"│ bias .*", printed)
    value, noise, stage = (float(number) for number in re.findall(r"(-?\d+\.\d+)°", bias))
    assert value == pytest.approx(0.8, abs=0.2)  # the simulated mount's offset
    assert noise == pytest.approx(0.01, abs=0.009)
    assert stage == pytest.approx(0.29, rel=0.01)  # what the rig says, times the scale


def test_ctrl_c_aborts_the_run_and_keeps_its_poses(bench):
    with on_a_terminal("run", "--unit", "A", "--plan", "long.json", "--json") as (process, terminal):
        shown_until(r"[1-9]\d*/900", terminal)
        process.send_signal(signal.SIGINT)
        shown = shown_until(None, terminal)
        run = json.loads(process.stdout.read())
    assert (process.returncode, run["status"]) == (1, "aborted")
    assert run["progress"]["poses_done"] >= 1
    assert f"calrig: run {run['id']} aborted" in shown
    assert "Traceback" not in shown


def test_sigterm_ends_any_command_as_ctrl_c_does(folder):
    endless = folder / "endless.csv"
    os.mkfifo(endless)
    with (
        program(*CALRIG, "noise", endless, stderr=subprocess.PIPE) as process,
        endless.open("wb"),  # once this is open, the command reads
    ):
        said = None
        while said is None:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):  # a signal just before a system call does not end it
                _, said = process.communicate(timeout=20.0)
    assert (process.returncode, said) == (1, "calrig: interrupted\n")


def test_outputs_that_the_shell_has_closed_take_everything(folder):
    run_id = calrig("import", "poses.csv", "--unit", "A").stdout.strip()
    command = f"exec {shlex.join((*CALRIG, 'export', run_id))} >&-"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("· ")


TOLD_AT_THE_END = """
import atexit, os, sys
told = lambda: print(os.environ["OPENBLAS_NUM_THREADS"], "scipy.signal" in sys.modules, file=sys.stderr)
atexit.register(told)
from calrig.cli.start import main
main()
"""


@pytest.mark.parametrize("asked", [None, "2"])
def test_a_diagnosis_takes_one_thread_unless_told_and_loads_no_signal_package(folder, asked):
    """Where other programs work too, a second thread has cost several times the processor time."""
    rows = [f"{5 * k},{5.01 * k + 0.02 * (k * k % 7)}" for k in range(12)]
    (folder / "dozen.csv").write_text("\n".join(["target_deg,reading_deg", *rows]), encoding="utf-8")
    env = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", TOLD_AT_THE_END, "diagnose", "dozen.csv"],
        env=env if asked is None else {**env, "OPENBLAS_NUM_THREADS": asked},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, f"{asked or 1} False\n")


@contextmanager
def served(*arguments):
    """`calrig serve` on a free port: the process, and a client of it."""
    with program(*CALRIG, "serve", "--port", "0", *arguments, stderr=subprocess.PIPE) as process:
        line = process.stdout.readline()
        assert "bench-1 (simulated)" in line, process.stderr.read()
        if (maps := Path(f"/proc/{process.pid}/maps")).exists():
            assert "/scipy/" not in maps.read_text(), "a fifth of a second that only analyses need"
        (url,) = re.findall(r"http://[^, ]+", line)
        with httpx.Client(base_url=url, timeout=60) as client:
            yield process, client


def begin_long_run(client):
    """Begins a run; returns its id once its first pose is announced."""
    run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    with client.stream("GET", f"/api/runs/{run['id']}/events") as events:
        assert "event: pose" in events.iter_lines()
    return run["id"]


def test_sigterm_ends_a_service_in_order_with_a_run_and_a_browser_on_it(bench, monkeypatch):
    monkeypatch.setenv("CALRIG_LOG", "json")
    with served() as (process, client):
        run_id = begin_long_run(client)
        with client.stream("GET", f"/api/runs/{run_id}/events") as events:
            process.terminate()
            assert list(events.iter_lines())[-1] == "", "the stream ends between two events"
        _, err = process.communicate()
    assert process.returncode == 0, err
    log = [json.loads(line) for line in err.splitlines()]
    assert [line["run_id"] for line in log if "interrupted" in line["message"]] == [run_id]
    assert {line["level"] for line in log} <= {"info", "warning"}
    with Store.open(f"sqlite:///{bench / 'calrig.db'}", writer=None) as store:
        run = store.runs.get(run_id)
    assert run.status == "interrupted"
    assert run.progress.poses_done >= 1


def test_a_service_that_was_killed_leaves_no_device_behind_and_a_run_that_says_so(bench):
    psutil = pytest.importorskip("psutil")
    with served() as (process, client):
        run_id = begin_long_run(client)
        devices = psutil.Process(process.pid).children(recursive=True)
        assert devices
        process.kill()
        process.wait()
        _, alive = psutil.wait_procs(devices, timeout=60)
        assert not alive
    (bench / "calrig.toml").write_text(RIG)
    calrig("run", "--unit", "B", status=1)  # whoever writes next; its rig is not plugged in
    with Store.open(f"sqlite:///{bench / 'calrig.db'}", writer=None) as store:
        assert store.runs.get(run_id).status == "interrupted"
