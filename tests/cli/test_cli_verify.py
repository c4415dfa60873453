"""`calrig export --format archive` and `calrig verify`: what a maker hands on, an auditor checks."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing

from command_line import calrig, reason


def test_an_archive_is_made_once_and_checked_without_the_store(folder):
    calrig("import", "poses.csv", "--unit", "A/1")
    said = calrig("export", "--unit", "A/1", "--format", "archive", "--out", "a.zip").stdout
    assert said == f"a.zip: {(folder / 'a.zip').stat().st_size / 1e3:.1f} kB\n"
    (folder / "calrig.db").unlink()
    lines = calrig("verify", "a.zip").stdout.splitlines()
    assert lines[0].startswith("a.zip: intact, 9 files of unit A/1 as of 20")
    assert lines[1:3] == ["1 revisions, 1 runs", "the poses give the numbers of revision 1"]
    assert lines[3].startswith("3 entries of the trail, whose head is 3: ")
    found = json.loads(calrig("verify", "a.zip", "--json").stdout)
    assert (found["intact"], found["refitted"], found["problems"]) == (True, [1], [])

    content = (folder / "a.zip").read_bytes()
    place = content.index(b"poses.csv") + len("poses.csv") + 30  # the zip's own extra data is before it
    damaged = bytes([content[place] ^ 1])
    (folder / "a.zip").write_bytes(content[:place] + damaged + content[place + 1 :])
    done = calrig("verify", "a.zip", status=1)
    assert done.stdout == ""
    assert "a.zip: the file: does not have the SHA-256" in done.stderr
    assert "poses.csv: " in done.stderr, "where it is"
    told = calrig("verify", "a.zip", "--json", status=1)
    assert len(json.loads(told.stdout)["problems"]) == len(told.stderr.splitlines()) == 2


def test_a_backup_and_an_archive_prove_that_nothing_was_cut_off_the_audit_log(folder):
    calrig("import", "poses.csv", "--unit", "A")
    calrig("export", "--unit", "A", "--format", "archive", "--out", "a.zip")
    told = calrig("backup", "copy.db").stdout
    calrig("import", "poses.csv", "--unit", "B")
    with closing(sqlite3.connect(folder / "calrig.db")) as store:
        seq, sha256 = store.execute("SELECT seq, sha256 FROM trail ORDER BY seq").fetchall()[2]
    assert f"{seq}, SHA-256 {sha256}" in told, "to be noted elsewhere"
    for anchor in ("copy.db", "a.zip"):
        assert f"head is {seq}: {sha256}" in calrig("verify", anchor, "--db", "calrig.db").stdout

    with closing(sqlite3.connect(folder / "calrig.db")) as store, store:
        store.execute("DELETE FROM trail WHERE seq >= 3")
    for anchor in ("copy.db", "a.zip"):
        assert calrig("verify", anchor).stderr == "", "by itself it is intact"
        failed = calrig("verify", anchor, "--db", "calrig.db", status=1)
        assert "calrig.db" in failed.stderr and sha256 in failed.stderr
    with closing(sqlite3.connect(folder / "copy.db")) as copy, copy:
        copy.execute("UPDATE trail SET who = 'eve' WHERE seq = 2")
    found = json.loads(calrig("verify", "copy.db", "--json", status=1).stdout)
    assert (found["intact"], found["trail"]["broken_at"]) == (False, 2)


def test_a_certificate_for_programs_goes_where_it_is_asked_to(folder):
    calrig("import", "poses.csv", "--unit", "A")
    export = ("export", "--unit", "A", "--format", "dcc")
    printed = calrig(*export).stdout
    assert printed.startswith("<?xml")
    calrig(*export, "--out", "a.xml")
    assert (folder / "a.xml").read_text() == printed
    assert "go together" in calrig(*export, "--sign", "key.pem", status=2).stderr
    failed = calrig(*export, "--sign", "key.pem", "--cert", "cert.pem", "--out", "b.xml", status=1)
    assert "key.pem: cannot be read" in failed.stderr
    assert not (folder / "b.xml").exists()
    (folder / "calrig.toml").write_text('[laboratory]\nsigning_key = "key.pem"\n')
    assert "signing_certificate" in calrig(*export, status=2).stderr


def test_what_is_no_archive_or_cannot_be_made_is_2(folder):
    calrig("import", "poses.csv", "--unit", "A")
    assert "is no zip file" in reason("verify", "poses.csv", status=2)
    assert "absent.zip: cannot be read" in reason("verify", "absent.zip", status=2)
    export = ("export", "--format", "archive")
    assert "--unit SERIAL --out FILE.zip" in reason(*export, "--unit", "A", status=2)
    assert "--unit SERIAL --out FILE.zip" in reason(*export, "--out", "a.zip", status=2)
    assert "exists and is not" in reason(*export, "--unit", "A", "--out", "poses.csv", status=2)
    assert "cannot be made" in reason(*export, "--unit", "A", "--out", "nowhere/a.zip", status=2)
    assert "there is no unit 'B'" in reason(*export, "--unit", "B", "--out", "b.zip", status=1)
    assert not (folder / "b.zip").exists()
    assert "not to --out" in reason("export", "--unit", "A", "--out", "b.json", status=2)
