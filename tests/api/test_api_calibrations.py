"""Issued calibrations over HTTP: the bytes as issued, the list, release, withdrawal, the feed."""

from __future__ import annotations

import base64
import hashlib
import json
import tempfile
from xml.etree import ElementTree

import pytest
from support import imported, running_service, serving
from typer.testing import CliRunner

import calrig
from calrig.analysis import certificates
from calrig.cli.main import app
from calrig.errors import WorkError
from calrig.export.archive.check import check_archive

POSES = "target_deg,reading_deg\n-30,-29.5\n0,0.4\n30,30.6\n"


@pytest.fixture(scope="module")
def client(rig, tmp_path_factory):
    """A client of a service whose rig has its drafts released by a person."""
    path = tmp_path_factory.mktemp("issued") / "calrig.db"
    with (
        running_service(path, rig.model_copy(update={"release": "manual"})) as service,
        serving(service) as one,
    ):
        yield one


@pytest.fixture
def unit(client, request):
    """The address of a unit whose two drafts nobody has released."""
    serial = request.node.name[:90]
    for reading in ("0.4", "0.5"):
        imported(client, serial, POSES.replace("0.4", reading))
    return f"/api/units/{serial}"


def act(client, unit, revision, what, reason="reviewed"):
    return client.post(f"{unit}/calibrations/{revision}/{what}", json={"reason": reason})


def test_nothing_is_in_force_until_released_and_then_the_bytes_stay(client, unit):
    assert client.get(f"{unit}/calibration").status_code == 404
    draft = client.get(f"{unit}/calibration", params={"revision": "latest"})
    assert draft.json()["revision"] == 2
    released = act(client, unit, 2, "release").raise_for_status().json()
    assert (released["revision"], released["status"], released["stale"]) == (2, "in_force", [])
    in_force = client.get(f"{unit}/calibration")
    assert in_force.content == draft.content == client.get(f"{unit}/calibration?revision=2").content
    document = in_force.json()
    sha256 = document.pop("sha256")
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    assert sha256 == released["sha256"] == hashlib.sha256(text.encode()).hexdigest()
    assert in_force.headers["etag"] == f'"{sha256}"'
    assert document["unit"] in client.get(f"{unit}/calibration?format=c-header").text


def test_the_list_says_of_each_what_came_of_it(client, unit):
    act(client, unit, 1, "release")
    act(client, unit, 2, "release", "newer")
    act(client, unit, 2, "withdraw", "the clamp was loose")
    listed = client.get(f"{unit}/calibrations").json()
    assert [(one["revision"], one["status"]) for one in listed] == [(2, "withdrawn"), (1, "superseded")]
    assert listed[0].keys() >= {
        "run_id", "effects", "issued_at", "issued_by", "reason", "sha256", "verdict", "stale",
    }  # fmt: skip
    assert client.get(f"{unit}/calibration").status_code == 404
    assert client.get(unit).json()["revision_in_force"] is None
    assert act(client, unit, 1, "release").status_code == 200, "a superseded one may be released again"


def test_a_row_has_the_figures_of_its_document_and_their_change_against_the_one_in_force(client, unit):
    act(client, unit, 1, "release")
    draft, in_force = client.get(f"{unit}/calibrations").json()
    for row in (draft, in_force):
        document = client.get(f"{unit}/calibration?revision={row['revision']}").json()
        for name in ("bias_deg", "scale", "expanded_uncertainty_deg"):
            assert row[name] == document[name]
        assert row["bias_std_deg"] == pytest.approx(document["covariance"][0][0] ** 0.5)
        assert row["verdict"]["answer"] == "no_limits"
    assert in_force["change"] is None
    assert draft["change"]["revision"] == 1
    assert draft["change"]["bias_deg"] == pytest.approx(0.1 / 3), "one reading of three is 0.1° more"
    assert draft["change"]["expanded_uncertainty_deg"] is None, "no reference, so U is not known"


def test_release_says_what_it_supersedes_and_reasons_stand_in_the_list_and_the_feed(client, unit):
    assert act(client, unit, 1, "release", "first").json()["acts"][0]["supersedes"] is None
    assert act(client, unit, 2, "release", "newer").json()["acts"][0]["supersedes"] == 1
    withdrawn = act(client, unit, 2, "withdraw", "the clamp was loose").json()
    expected = [("released", "newer", 1), ("withdrawn", "the clamp was loose", None)]
    assert [(one["what"], one["reason"], one["supersedes"]) for one in withdrawn["acts"]] == expected
    feed = [one for one in client.get("/api/calibrations").json() if one["unit"] == unit.split("/")[-1]]
    acts = [(one["what"], one["reason"], one["supersedes"]) for one in feed if one["what"] != "drafted"]
    assert acts == [("released", "first", None), *expected]


def test_a_unit_whose_only_calibration_was_withdrawn_is_not_verified_nor_due_by_it(client, unit):
    before = client.get(unit).json()
    assert before["due_at"] is not None
    act(client, unit, 2, "release")
    act(client, unit, 2, "withdraw")
    assert client.get(unit).json()["due_at"] is not None, "revision 1 can still be released"
    act(client, unit, 1, "withdraw")
    after = client.get(unit).json()
    assert (after["due_at"], after["overdue"], after["due_method"]) == (None, False, None)
    assert "withdrawn" in after["due_says"]
    plan = {"unit": before["serial"], "plan": {"kind": "verification"}}
    assert client.post("/api/runs", json=plan).status_code == 409
    for number in (1, 2):
        answer = client.post("/api/runs", json={**plan, "plan": {**plan["plan"], "revision": number}})
        assert answer.status_code == 409 and f"revision {number}" in answer.json()["detail"]


def test_a_draft_of_a_run_is_made_by_request(client, unit):
    run_id = client.get(unit).json()["runs"][-1]["id"]
    body = {"run_id": run_id, "effects": [], "reason": "once more"}
    made = client.post(f"{unit}/calibrations", json=body)
    assert (made.status_code, made.json()["revision"], made.json()["run_id"]) == (201, 3, run_id)
    assert (made.json()["status"], made.json()["reason"]) == ("draft", "once more")


def test_the_certificate_for_programs_is_of_the_revision_asked_for(client, unit):
    answer = client.get(f"{unit}/calibration?revision=1&format=dcc").raise_for_status()
    assert answer.headers["content-type"] == "application/xml"
    issued = client.get(f"{unit}/calibration?revision=1")
    name = f"preview-{issued.json()['sha256'][:12]}-1.xml"
    assert answer.headers["content-disposition"] == f'attachment; filename="{name}"'
    root = ElementTree.fromstring(answer.content)
    assert root.tag == "{https://ptb.de/dcc}digitalCalibrationCertificate"
    inside = root.findtext(".//{https://ptb.de/dcc}dataBase64")
    assert base64.b64decode(inside) == issued.content
    assert client.get(f"{unit}/calibration?format=dcc").status_code == 404, "none is in force"


def test_a_downloaded_archive_is_whole_and_the_same_again(client, unit, tmp_path):
    answer = client.get(f"{unit}/archive").raise_for_status()
    assert answer.headers["content-type"] == "application/zip"
    assert answer.headers["content-disposition"].startswith('attachment; filename="archive-test_a_down')
    file = tmp_path / "unit.zip"
    file.write_bytes(answer.content)
    found = check_archive(file)
    assert (found.problems, found.unit, found.runs, found.refitted) == ([], unit.split("/")[-1], 2, [1, 2])
    assert client.get(f"{unit}/archive").content == answer.content
    assert client.get("/api/units/nobody/archive").status_code == 404


def test_an_archive_is_written_by_another_process_and_leaves_no_file(client, unit, monkeypatch, tmp_path):
    whole = client.get(f"{unit}/archive").raise_for_status().content
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(certificates, "unit_archive", None)  # of the service's own process
    assert client.get(f"{unit}/archive").raise_for_status().content == whole
    assert list(tmp_path.glob("calrig-*")) == []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    refused = client.get(f"{unit}/archive")
    assert (refused.status_code, "make room there" in refused.json()["detail"]) == (503, True)


@pytest.mark.parametrize(
    ("path", "body", "status", "says"),
    [
        ("calibrations/9/release", {"reason": "x"}, 404, "has no revision 9"),
        ("calibrations/1/release", {"reason": " "}, 422, "a reason is needed"),
        ("calibrations/1/withdraw", {}, 422, "Reason is missing"),
        ("calibrations", {"run_id": "999"}, 404, "there is no run 999"),
        ("calibrations", {"run_id": "OTHER", "effects": ["latency"]}, 409, "run OTHER is of unit"),
    ],
)
def test_what_cannot_be_is_refused_with_why(client, unit, path, body, status, says):
    other = imported(client, "another", POSES)["id"]
    if body.get("run_id") == "OTHER":
        body, says = {**body, "run_id": other}, says.replace("OTHER", other)
    answer = client.post(f"{unit}/{path}", json=body)
    assert answer.status_code == status
    assert says in answer.json()["detail"]


@pytest.mark.parametrize(
    ("wanted", "status"), [("1", 200), ("3", 404), ("0", 422), ("one", 422), ("9" * 30, 422)]
)
def test_a_revision_is_asked_for_by_number(client, unit, wanted, status):
    assert client.get(f"{unit}/calibration", params={"revision": wanted}).status_code == status


def test_the_feed_tells_what_was_done_since_a_time_over_all_units(client, unit):
    act(client, unit, 1, "release")
    before = client.get("/api/calibrations").json()[-1]
    assert (before["what"], before["revision"], before["reason"]) == ("released", 1, "reviewed")
    act(client, unit, 1, "withdraw", "wrong")
    assert client.post(f"{unit}/calibrations/2/release").raise_for_status().json()["status"] == "in_force"
    since = client.get("/api/calibrations", params={"since": before["at"]}).json()
    assert [(one["what"], one["revision"], one["reason"]) for one in since] == [
        ("released", 1, "reviewed"),
        ("withdrawn", 1, "wrong"),
        ("released", 2, None),
    ]
    assert client.get("/api/calibrations", params={"since": "yesterday"}).status_code == 422


def test_a_verification_applies_the_revision_it_names_and_409_without_one(client, unit):
    plan = {"kind": "verification", "elevations_deg": [0], "sweeps": 1}
    serial = unit.rsplit("/", 1)[1]
    refused = client.post("/api/runs", json={"unit": serial, "plan": plan})
    assert (refused.status_code, "no calibration in force" in refused.json()["detail"]) == (409, True)
    refused = client.post("/api/runs", json={"unit": serial, "plan": {**plan, "revision": 7}})
    assert (refused.status_code, "no revision 7" in refused.json()["detail"]) == (409, True)
    wrong = client.post("/api/runs", json={"unit": serial, "plan": {"revision": 1}})
    assert (wrong.status_code, "only a verification" in wrong.json()["detail"]) == (422, True)


def test_a_program_applies_the_calibration_at_its_address(client, unit):
    act(client, unit, 2, "release")
    address = f"{client.base_url}{unit}/calibration"
    loaded = calrig.load(address)
    document = client.get(f"{unit}/calibration").json()
    assert (loaded.revision, loaded.document) == (2, document)
    done = CliRunner().invoke(app, ["apply", address], input=POSES)
    expected = (30.6 - document["bias_deg"]) / document["scale"]
    assert float(done.stdout.splitlines()[-1].split(",")[2]) == pytest.approx(expected, abs=1e-6)
    assert loaded.elevation_deg(30.6) == pytest.approx(expected)
    with pytest.raises(WorkError, match="has no revision 9"):
        calrig.load(f"{address}?revision=9")


def test_a_format_that_cannot_hold_the_calibration_says_why(client, unit):
    def refused(format_):
        answer = client.get(f"{unit}/calibration", params={"revision": "latest", "format": format_})
        return answer.status_code, answer.json()["detail"]

    status, why = refused("px4")
    assert (status, "revision 2" in why, "bias and scale of an angle" in why) == (409, True, True)
    status, why = refused("imucal")
    assert (status, "mount_axis" in why) == (409, True)
    status, why = refused("kalibr")
    assert (status, "no noise was measured" in why) == (409, True)
    assert refused("gazebo")[0] == 422
