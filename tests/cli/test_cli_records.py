"""`calrig import`, `export`, `backup`: what goes into the store comes out; a refusal touches nothing."""

from __future__ import annotations

import json
import os
import re
from uuid import UUID

import pytest
from command_line import POSES, calrig, reason
from support import LONG, wait_for

from calrig.calibration.poses import Pose
from calrig.settings import store_url
from calrig.store import Store


def test_import_prints_the_run_id_and_export_gives_the_calibration_and_its_poses(folder):
    imported = calrig("import", "poses.csv", "--unit", "A/1")
    run_id = imported.stdout.rstrip("\n")
    assert str(UUID(run_id)) == run_id
    assert imported.stderr.startswith("· Not judged: the noise of a reading is not known")
    exported = calrig("export", run_id)
    assert exported.stderr == imported.stderr
    by_run = json.loads(exported.stdout)
    assert by_run == json.loads(calrig("export", "--unit", "A/1").stdout)
    assert (by_run["schema"], by_run["unit"], by_run["run_id"]) == ("calrig.calibration/2", "A/1", run_id)
    assert "A/1" in calrig("export", run_id, "--format", "c-header").stdout
    why = calrig("export", run_id, "--format", "ardupilot", status=1).stderr
    assert "bias and scale of an angle" in why
    assert "no noise was measured" in reason("export", "--unit", "A/1", "--format", "vins", status=1)
    text = calrig("export", "--unit", "A/1", "--format", "csv").stdout
    assert text == calrig("export", run_id, "--format", "csv").stdout
    (folder / "again.csv").write_text(text)
    calrig("import", "again.csv", "--unit", "B")
    assert json.loads(calrig("export", "--unit", "B").stdout)["bias_deg"] == by_run["bias_deg"]


def test_import_export_and_api_say_the_same_of_the_limits_of_the_configuration(folder):
    limit = '[[limit]]\nname = "flight"\nunits = "A*"\nscale = [0.9, 1.0]\n'
    (folder / "calrig.toml").write_text(limit + (folder / "calrig.toml").read_text())
    done = calrig("import", "poses.csv", "--unit", "A")
    run_id, imported = done.stdout.strip(), done.stderr
    assert imported.startswith("· Fail against the limits “flight” (simple rule).\n· Scale 1.0")
    assert calrig("export", "--unit", "A").stderr.endswith(imported)  # a draft: what fails is not released
    with Store.open(store_url(), writer=None) as store:
        run = store.runs.get(run_id)
        (revision,) = store.revisions.of("A")
        assert imported.splitlines() == [f"· {said}" for said in run.verdict.says]
        assert revision.verdict == run.verdict.to_dict()
        assert revision.status == "draft"


def test_a_bad_file_is_2_with_line_and_column_and_a_missing_one_too(folder):
    (folder / "poses.csv").write_text(POSES.replace("30.6", "thirty"))
    said = reason("import", "poses.csv", "--unit", "A", status=2)
    assert all(word in said for word in ("poses.csv", "line 4", "reading_deg"))
    assert "absent.csv" in reason("import", "absent.csv", "--unit", "A", status=2)


def test_what_there_is_not_to_export_is_1(folder):
    calrig("import", "poses.csv", "--unit", "A")
    assert "99" in reason("export", "99", status=1)
    assert "nope" in reason("export", "--unit", "nope", status=1)
    both_or_neither = "calrig: export: name either a RUN_ID or --unit SERIAL"
    assert reason("export", status=2) == reason("export", "1", "--unit", "A", status=2) == both_or_neither


def test_the_beginning_of_an_id_will_do_where_no_other_begins_so(folder):
    first, second = ("0123abcd-0000-4000-8000-000000000000", "0123abce-0000-4000-8000-000000000000")
    with Store.open(store_url(), writer="import") as store:
        for run_id, reading_deg in ((first, 0.5), (second, 0.7)):
            poses = [Pose(0.0, reading_deg), Pose(10.0, 10.0)]
            given = {"plan": None, "status": "completed", "provenance": {}, "poses": poses}
            store.runs.create(unit="A", rig=None, run_id=run_id, **given)
    for typed in ("0123abcd", "0123ABCD-0", first):
        assert "\n0.0,0.5\n" in calrig("export", typed, "--format", "csv").stdout
    assert reason("export", "0123ab", "--format", "csv", status=2) == (
        f"calrig: run 0123ab: several ids begin so ({first}, {second}): type more of the one that is meant"
    )
    for typed in ("0123a", "0123abcf", "123abcd"):
        assert reason("export", typed, status=1) == f"calrig: there is no run {typed}"


def test_a_store_that_is_none_is_1(folder):
    (folder / "calrig.db").write_text("this is not a database at all, and it is longer than its header")
    assert "calrig.db" in reason("import", "poses.csv", "--unit", "A", status=1)
    assert "elsewhere.db" in reason("export", "1", "--db", "elsewhere.db", status=1)
    assert "calrig.db" in reason("backup", "copy.db", status=1)
    assert list(folder.glob("copy.db*")) == []


def test_a_store_that_is_being_written_is_1_and_says_by_whom(folder):
    with Store.open(f"sqlite:///{folder / 'calrig.db'}", writer="serve"):
        said = reason("import", "poses.csv", "--unit", "A", status=1)
    assert "calrig serve" in said
    assert f"process {os.getpid()}" in said


def test_a_backup_of_an_idle_store_is_the_store(folder):
    run_id = calrig("import", "poses.csv", "--unit", "A").stdout.strip()
    assert calrig("backup", "copy.db").stdout.startswith("copy.db: 1 runs, 3 poses, ")
    copied = calrig("export", run_id, "--db", "copy.db").stdout
    assert json.loads(copied) == json.loads(calrig("export", run_id).stdout)


def entered(store):
    """The heads of backups that a store's audit log has, and how many entries were there before each."""
    found = store.trail.entries(what=["backed_up"])
    return [(one.seq - 1, one.detail["trail_seq"]) for one in found]


def test_a_backup_is_entered_in_the_audit_log_with_its_newest_entry(folder):
    calrig("import", "poses.csv", "--unit", "A")
    told = calrig("backup", "one.db").stdout + calrig("backup", "two.db").stdout
    with Store.open(f"sqlite:///{folder / 'calrig.db'}", writer=None) as store:
        acts = [one.detail for one in store.trail.entries(what=["backed_up"])]
        assert entered(store) == [(one["trail_seq"], one["trail_seq"]) for one in acts]
        assert store.trail.broken_link() is None
    assert len(acts) == 2
    assert all(f"{one['trail_seq']}, SHA-256 {one['trail_sha256']}" in told for one in acts)


def test_a_backup_of_a_store_that_is_served_is_entered_by_the_service(client, store_path, tmp_path, service):
    files = {"file": ("p.csv", "target_deg,reading_deg\n0,0.1\n9,9.1\n")}
    client.post("/api/imports", files=files, data={"unit": "B"}).raise_for_status()
    service.store.answers_at(str(client.base_url))
    assert calrig("backup", tmp_path / "copy.db", "--db", store_path).stderr == ""
    ((before, head),) = entered(service.store)
    assert before == head
    wrong = {"seq": head, "sha256": "0" * 64}
    assert client.post("/api/trail/backups", json=wrong).status_code == 409


def test_a_backup_of_a_store_that_another_program_writes_says_that_it_is_not_entered(folder):
    calrig("import", "poses.csv", "--unit", "A")
    with Store.open(f"sqlite:///{folder / 'calrig.db'}", writer="run"):
        done = calrig("backup", "copy.db")
    assert (folder / "copy.db").exists() and "not in the audit log" in done.stderr


def test_a_backup_in_the_middle_of_a_run_is_one_file_with_every_pose_announced_before(
    client, store_path, tmp_path
):
    run_id = client.post("/api/runs", json={"unit": "AS-1", "plan": LONG}).raise_for_status().json()["id"]

    def poses():
        return client.get(f"/api/runs/{run_id}/poses").raise_for_status().json()

    wait_for(lambda: len(poses()) >= 4, "four poses")
    announced = poses()
    said = calrig("backup", tmp_path / "copy.db", "--db", store_path).stdout
    assert client.get(f"/api/runs/{run_id}").json()["status"] == "running", "the run goes on"
    assert re.search(r"copy\.db: 1 runs, \d+ poses, \d+\.\d MB\n.*log: 1, SHA-256 [0-9a-f]{64}\n$", said)
    assert [p.name for p in tmp_path.glob("copy.db*")] == ["copy.db"], "one self-contained file"
    client.post(f"/api/runs/{run_id}/abort").raise_for_status()

    with Store.open(f"sqlite:///{tmp_path / 'copy.db'}", writer=None) as copy:
        kept = [stored.pose.reading_deg for stored in copy.poses.of(run_id)]
    assert kept[: len(announced)] == [pose["reading_deg"] for pose in announced]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("copy.db", "copy.db: exists and is not overwritten"),
        (".", "is a folder"),
        ("nowhere/copy.db", "not there"),
    ],
)
def test_a_file_that_a_backup_would_spoil_or_cannot_make_is_2(folder, name, words):
    (folder / "copy.db").write_text("precious")
    assert words in reason("backup", name, status=2)
    assert (folder / "copy.db").read_text() == "precious"


def test_names_of_another_encoding_are_taken_or_refused_in_words(folder):
    latin = os.fsdecode(b"poses-\xe4.csv")
    (folder / latin).write_text(POSES)
    run_id = calrig("import", latin, "--unit", "A", "--db", latin + ".db").stdout.strip()
    with Store.open(store_url(latin + ".db"), writer=None) as store:
        assert store.runs.get(run_id).provenance["imported_from"] == "poses-\\udce4.csv"
    odd = os.fsdecode(b"\xe4")
    assert "UTF-8" in reason("import", "poses.csv", "--unit", "A", "--rig", odd, status=1)
    calrig("import", "poses.csv", "--unit", "A")
    assert "UTF-8" in reason("export", "--unit", odd, status=1)


@pytest.mark.parametrize("empty", ["", " "])
def test_an_empty_name_of_a_store_is_2_and_no_other_store_is_taken(folder, empty):
    assert "--db is empty" in reason("import", "poses.csv", "--unit", "A", "--db", empty, status=2)


def test_a_certificate_goes_into_a_file_or_a_pipe_the_same(folder):
    calrig("import", "poses.csv", "--unit", "A")
    told = calrig("export", "--unit", "A", "--format", "pdf", "-o", "a.pdf")
    assert (told.stdout, told.stderr.startswith("· Not judged")) == ("", True)
    made = (folder / "a.pdf").read_bytes()
    assert made.startswith(b"%PDF-")
    assert calrig("export", "--unit", "A", "--format", "pdf").stdout_bytes == made
    assert "is a folder" in calrig("export", "--unit", "A", "--format", "pdf", "-o", folder, status=2).stderr
