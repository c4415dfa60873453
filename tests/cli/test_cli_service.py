"""Commands beside a running service: they find it by the store's lock, and do there what they do here."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import random
import re
import signal
import socket
import threading
from pathlib import Path

import pytest
from command_line import POSES, calrig, reason
from support import LONG, QUICK, running_service, serving, wait_for
from typer.testing import CliRunner

import calrig as package
from calrig.api import jobs
from calrig.calibration.poses import Pose
from calrig.cli import options
from calrig.cli.main import app
from calrig.settings import store_url
from calrig.store import Store, back_up
from calrig.store.sqlite import lock as listener
from calrig.store.sqlite.lock import answering_at

DOCS = Path(package.__file__).parent / "docs"
TURNED = {**QUICK, "sweeps": 1, "mounts_deg": [0, 90]}


@pytest.fixture(scope="module")
def served(rig, launch_rig, tmp_path_factory):
    """A service that has said in its store's lock where it answers; a client of it, and the store's path."""
    clamped = launch_rig("clamped", clamp={})
    path = tmp_path_factory.mktemp("served") / "calrig.db"
    with running_service(path, rig, clamped) as service, serving(service) as client:
        service.store.answers_at(str(client.base_url))
        yield service, client, path


@pytest.fixture
def there(served, folder, monkeypatch):
    """The client, where commands find the service without being told."""
    _, client, path = served
    monkeypatch.setenv("CALRIG_DB", str(path))
    for name, plan in (("quick", QUICK), ("long", LONG), ("turned", TURNED)):
        (folder / f"{name}.json").write_text(json.dumps(plan))
    return client


@pytest.fixture(autouse=True)
def _somebody_has_time(monkeypatch):
    """To wait for what is completed, however busy the machine."""
    monkeypatch.setattr(options, "PATIENCE_S", 60.0)


def pressed_when(look):
    """Ctrl-C, once there is something to be seen."""

    def press():
        wait_for(look, "a moment for Ctrl-C")
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=press, daemon=True).start()


def completed(*words):
    """What a shell offers for the last word."""
    typed = {"COMP_WORDS": " ".join(("calrig", *words)), "COMP_CWORD": str(len(words))}
    asked = CliRunner().invoke(
        app, [], prog_name="calrig", env={"_CALRIG_COMPLETE": "complete_bash", **typed}
    )
    assert not asked.stderr
    return asked.stdout.split()


def newest(client):
    return client.get("/api/runs?limit=1").json()["items"][0]


def test_a_run_is_the_services_and_ends_with_its_verdict(there):
    printed = calrig("run", "--unit", "AS-1", "--plan", "quick.json", "--operator", "Ada").stdout
    run = newest(there)
    assert (run["unit"], run["operator"], run["status"]) == ("AS-1", "Ada", "completed")
    assert f"run {run['id']}: unit AS-1, on bench-1" in printed
    assert printed.splitlines()[-1] == f"· {run['verdict']['says'][-1]}"
    assert calrig("watch", run["id"][:8]).stdout == printed
    assert json.loads(calrig("watch", run["id"], "--json").stdout) == run
    assert completed("watch", run["id"][:4]) == [run["id"]]
    assert completed("run", "--rig", "b") == ["bench-1"]
    assert completed("run", "--unit", "AS") == ["AS-1"]


def test_names_are_completed_from_the_store_and_without_one_nothing_is_said(folder):
    (folder / "calrig.db").unlink()
    assert completed("watch", "") == completed("run", "--unit", "") == []
    assert not (folder / "calrig.db").exists()
    calrig("import", "poses.csv", "--unit", "KEPT-1")
    assert completed("export", "--unit", "K") == ["KEPT-1"]
    assert completed("run", "--rig", "") == ["bench-1"]


def test_what_was_imported_is_exported_and_diagnosed_as_without_the_service(there, folder, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)  # as of large files: what is long goes on as a job
    imported = calrig("import", "poses.csv", "--unit", "A/1")
    run_id = imported.stdout.strip()
    assert newest(there)["id"] == run_id
    back_up(store_url(), folder / "copy.db")
    for arguments in (
        ("export", "--unit", "A/1"),
        ("export", run_id[:8], "--format", "csv"),
        ("export", "--unit", "A/1", "--format", "c-header"),
        ("export", "--unit", "A/1", "--format", "csv"),
        ("export", "--unit", "A/1", "--format", "dcc"),
    ):
        asked, here = calrig(*arguments), calrig(*arguments, "--db", "copy.db")
        assert (asked.stdout_bytes, asked.stderr) == (here.stdout_bytes, here.stderr), arguments
    calrig("export", "--unit", "A/1", "--format", "archive", "-o", "a.zip")
    assert "a.zip: intact" in calrig("verify", "a.zip").stdout
    assert "a.zip: exists" in reason(
        "export", "--unit", "A/1", "--format", "archive", "-o", "a.zip", status=2
    )
    assert "no unit 'B'" in reason("export", "--unit", "B", "--format", "archive", "-o", "b.zip", status=1)
    assert not (folder / "b.zip").exists()
    for option in (("--parquet", "all"), ("--unit", "A/1", "--format", "dcc", "--sign", "k", "--cert", "c")):
        there_alone = reason("export", *option, "--server", there.base_url, status=2)
        assert "for the machine that has the store" in there_alone
    for arguments, status in (
        (("export", "nope"), 1),
        (("export", "--unit", "A/1", "--format", "vins"), 1),
        (("diagnose", run_id), 2),
    ):
        said, here = reason(*arguments, status=status), reason(*arguments, "--db", "copy.db", status=status)
        assert said.replace(f"{there.base_url}: ", "").split()[-4:] == here.split()[-4:]
    (folder / "poses.csv").write_text(POSES.replace("30.6", "thirty"))
    assert "poses.csv: line 4" in reason("import", "poses.csv", "--unit", "A", status=2)


def test_a_log_is_studied_by_the_service_as_here_and_kept_there(there, folder):
    rng = random.Random(2)
    rows = (f"{k / 50},{rng.gauss(0, 0.01):.5f},{rng.gauss(1, 0.01):.5f}" for k in range(500))
    (folder / "log.csv").write_text("\n".join(["time_s,accel_y_g,accel_z_g", *rows]))
    at = "--server", there.base_url
    asked, here = calrig("noise", "log.csv", "--json", *at), calrig("noise", "log.csv", "--json")
    assert json.loads(asked.stdout) == json.loads(here.stdout)
    kept = there.get("/api/log-studies").json()[0]
    assert (kept["kind"], kept["file_name"]) == ("noise", "log.csv")
    (folder / "log.csv").write_text("time_s,accel_y_g\n0,x\n")
    assert "log.csv: line 2, column accel_y_g" in reason("filters", "log.csv", *at, status=2)


def test_what_was_done_before_ctrl_c_came_is_said_to_be_kept(there, folder, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    readable, writable = os.pipe()
    os.write(writable, POSES.encode())
    os.close(writable)

    def press(share):
        if share == 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as left:
        package.Client(str(there.base_url)).import_poses(f"/dev/fd/{readable}", "LATE", told=press)
    os.close(readable)
    (note,) = left.value.__notes__
    assert note.endswith(f"{there.base_url}/api/runs/{newest(there)['id']}")
    assert newest(there)["unit"] == "LATE"


def test_the_example_notebook_runs_and_a_diagnosis_is_kept_with_its_run(there, monkeypatch, capsys):
    monkeypatch.setenv("CALRIG_SERVER", str(there.base_url))
    notebook = json.loads((DOCS / "tutorial" / "example.ipynb").read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    space: dict = {}
    for cell in cells:
        exec("".join(cell["source"]), space)
    run, printed = space["run"], capsys.readouterr().out
    assert printed.count("° reads ") == run.result.n_poses == 10
    assert f"bias {run.result.bias_deg:.4f} ±" in printed
    assert space["diagnosis"].says[0] in printed
    assert "AS-0043 ['" in printed

    shown = calrig("diagnose", run.id[:8], "--json")
    assert json.loads(shown.stdout) == there.get(f"/api/runs/{run.id}/diagnosis").json()


def test_ctrl_c_aborts_the_run_at_the_service_and_a_paused_one_is_resumed(there):
    pressed_when(lambda: newest(there)["unit"] == "C" and newest(there)["progress"]["poses_done"] >= 1)
    done = calrig("run", "--unit", "C", "--plan", "long.json", "--json", status=1)
    run = json.loads(done.stdout)
    assert (run["status"], run["id"]) == ("aborted", newest(there)["id"])
    assert f"run {run['id']} aborted" in done.stderr

    run_id = there.post("/api/runs", json={"unit": "C", "plan": LONG}).json()["id"]
    assert "is busy" in reason("run", "--unit", "D", status=1)
    there.post(f"/api/runs/{run_id}/pause").raise_for_status()
    wait_for(lambda: there.get(f"/api/runs/{run_id}").json()["status"] == "paused", "pause")
    pressed_when(lambda: there.get(f"/api/runs/{run_id}").json()["status"] == "running")
    assert f"run {run_id} aborted" in calrig("resume", run_id, status=1).stderr
    assert f"run {run_id} aborted" in calrig("watch", run_id, status=1).stderr


def test_a_unit_to_be_turned_is_asked_for_on_the_terminal(there, folder):
    arguments = ["run", "--unit", "E", "--rig", "clamped", "--plan", "turned.json", "--json"]
    done = CliRunner().invoke(app, arguments, input="\nc\n", catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert re.search(r"90°.* press Enter \(c and Enter", done.stderr)
    assert "turn it by a further 90" in done.stderr.replace("89.", "90.").replace("91.", "90.")
    assert json.loads(done.stdout)["progress"]["poses_done"] == 6
    of_unit = calrig("export", "--unit", "E", "--format", "csv").stdout
    assert of_unit.splitlines()[0].endswith(",mount,mount_axis")
    back_up(store_url(), folder / "turned.db")
    assert calrig("export", "--unit", "E", "--format", "csv", "--db", "turned.db").stdout == of_unit
    done = CliRunner().invoke(app, arguments, input="", catch_exceptions=False)
    assert done.exit_code == 1
    assert "standard input has ended" in done.stderr
    assert newest(there)["status"] == "aborted"


def test_what_a_service_cannot_be_told_is_2_and_rigs_are_its(there, folder):
    for option in (("--record", "wires"), ("--config", "calrig.toml")):
        assert "holds the store" in reason("run", "--unit", "A", *option, status=2)
    for command in (("run", "--unit", "A"), ("plan", "--time", "60")):
        assert "no rig 'bench-9'; configured: bench-1, clamped" in reason(
            *command, "--rig", "bench-9", status=2
        )
    rigs = [(rig["name"], rig["state"]) for rig in json.loads(calrig("rigs", "--json").stdout)["rigs"]]
    assert rigs == [("bench-1", "idle"), ("clamped", "idle")]
    assert "ABSENT" in calrig("rigs", "--config", "calrig.toml").stdout
    design = json.loads(calrig("plan", "--time", "60", "--no-trace", "--json").stdout)
    assert design["expected"]["duration_s"] <= 60
    assert "certificate" in reason("plan", "--target-u", "0.0001", status=1)


def test_a_token_goes_to_nobody_but_this_users_own_service(served, folder, tmp_path, monkeypatch):
    _, client, path = served
    lock = path.with_name("calrig.db.lock")
    address = str(client.base_url)
    assert answering_at(path) == address
    mode = lock.stat().st_mode
    lock.chmod(0o664)
    assert answering_at(path) is None, "others could have written the address"
    lock.chmod(mode)
    said = json.loads(lock.read_text())
    assert said["what"] == "tests"
    for change in ({"pid": 2**22 + 1}, {"host": "elsewhere"}, {"at": None}, {"pid": "1"}):
        lock.write_text(json.dumps({**said, **change}))
        assert answering_at(path) is None, change
    lock.write_text(json.dumps(said))
    assert answering_at(path) == address
    assert answering_at(tmp_path / "absent.db") is None
    with Store.open(store_url(str(tmp_path / "other.db")), writer="serve") as store:
        with socket.create_server(("127.0.0.1", 0)) as ours:
            here = f"http://127.0.0.1:{ours.getsockname()[1]}"
            store.answers_at(here)
            assert answering_at(tmp_path / "other.db") == here
            with monkeypatch.context() as context:
                context.setattr(os, "geteuid", lambda: os.getuid() + 1)
                assert not listener.is_ours(here), "another user listens there"
        assert answering_at(tmp_path / "other.db") is None, "the port is anybody's now"
        assert "--server http://HOST:PORT" in reason(
            "import", folder / "poses.csv", "--unit", "A", "--db", tmp_path / "other.db", status=1
        )
    assert answering_at(tmp_path / "other.db") is None, "nobody holds it any more"


def test_a_named_store_goes_before_the_variable_and_a_named_server_before_the_lock(there, monkeypatch):
    monkeypatch.setenv("CALRIG_SERVER", "http://127.0.0.1:1")
    assert "does not answer" in reason("export", "--unit", "A", status=1)
    assert "own.db" in reason("export", "--unit", "A", "--db", "own.db", status=1)
    assert "there is no run 99" in reason("export", "99", "--server", there.base_url, status=1)


def test_a_run_of_another_program_is_watched_in_the_file(folder):
    with Store.open(store_url(), writer="run") as store:
        given = {"plan": None, "provenance": {}, "poses": [Pose(0.0, 0.5)]}
        run = store.runs.create(unit="A", rig=None, status="running", **given)
        said = []
        watcher = threading.Thread(target=lambda: said.append(reason("watch", run.id, status=1)), daemon=True)
        watcher.start()
        store.runs.update(run.id, status="interrupted", error="the power went")
        watcher.join()
    (ending,) = said
    assert f"run {run.id} interrupted: the power went" in ending
    assert f"`calrig resume {run.id}`" in ending
    with Store.open(store_url(), writer="run") as store:
        left = store.runs.create(unit="A", rig=None, status="running", **given)
    assert "is running in the store" in reason("watch", left.id[:8], status=1)


def test_a_task_that_is_cancelled_cancels_the_work_that_it_waits_for(there, served, monkeypatch, caplog):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    caplog.set_level(logging.INFO, "calrig.api.job")
    service, _, _ = served
    poses = [
        Pose(k % 121 - 60.0, k % 121 - 59.0 + 0.1 * (k % 7), covariates={"a": k % 11}) for k in range(3000)
    ]
    given = {"plan": None, "status": "completed", "provenance": {}, "poses": poses}
    slow = service.store.runs.create(unit="SLOW", rig=None, **given)

    async def work():
        begun = asyncio.Event()
        loop = asyncio.get_running_loop()
        client = package.AsyncClient(str(there.base_url))
        told = {"told": lambda _share: loop.call_soon_threadsafe(begun.set)}
        asked = asyncio.create_task(client.diagnose(slow.id, **told))
        await begun.wait()
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked

    asyncio.run(work())
    wait_for(lambda: any("cancelled" in record.message for record in caplog.records), "end of the job")
