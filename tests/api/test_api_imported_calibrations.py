"""Imported poses with a reference are calibrations: U, limits, certificate, export and application."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import httpx
import numpy as np
import pypdf
import pytest
from command_line import calrig
from support import imported, running_service, serving

from calrig.settings import ReferenceSettings, RigSettings

BIAS_DEG, SCALE = 0.8, 0.998
STD_DEG = 0.03
LIMIT = {
    "name": "flight",
    "units": "IM-*",
    "max_error_deg": 0.6,
    "expanded_uncertainty_deg": 0.5,
    "rule": "guarded",
}


def poses(columns: str = "", cells: str = "") -> str:
    """Two sweeps with 0.02° of noise; further columns are the same in every row."""
    noise = np.random.default_rng(1).normal(0.0, 0.02, 26)
    angles = [*range(-60, 61, 10), *range(60, -61, -10)]
    rows = (f"{x},{BIAS_DEG + SCALE * x + e:.4f}{cells}" for x, e in zip(angles, noise, strict=True))
    return "\n".join([f"target_deg,reading_deg{columns}", *rows])


@pytest.fixture(scope="module")
def client(rig: RigSettings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    stated = ReferenceSettings(std_deg=STD_DEG, kind="common", certificate="K-2026-0815", issued_by="PTB")
    certified = rig.model_copy(update={"reference": stated, "release": "manual"})
    path = tmp_path_factory.mktemp("imports") / "calrig.db"
    with running_service(path, certified) as service, serving(service) as client:
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        yield client


def newest(client: httpx.Client, unit: str) -> dict[str, Any]:
    address = f"/api/units/{unit}/calibration"
    document: dict[str, Any] = client.get(address, params={"revision": "latest"}).raise_for_status().json()
    return document


@pytest.mark.parametrize(
    ("unit", "file", "form"),
    [
        ("IM-rig", poses(), {"rig": "bench-1"}),
        ("IM-form", poses(), {"reference_std_deg": "0.03", "reference_kind": "common"}),
        ("IM-columns", poses(",reference_std_deg,reference_kind", ",0.03,common"), {}),
        ("IM-units", poses(",Reference Std (mrad),Reference_Kind", f",{STD_DEG * np.pi / 0.18},Common"), {}),
        ("IM-wins", poses(",reference_std_deg,reference_kind", ",0.03,common"), {"rig": "bench-1"}),
    ],
)
def test_the_reference_of_rig_form_or_file_gives_the_same_uncertainty(client, unit, file, form):
    run = imported(client, unit, file, **form)
    verdict, document = run["verdict"], newest(client, unit)
    assert run["result"]["reference"]["kind"] == "common"
    assert run["result"]["reference"]["std_deg"] == pytest.approx(STD_DEG)
    assert document["uncertainty"]["type_b_deg"] == pytest.approx(STD_DEG)
    # never below the reference's own part, nor far above it: the noise averages out over 26 poses
    assert STD_DEG * 1.6 < document["expanded_uncertainty_deg"] < STD_DEG * 3.0
    assert document["coverage_factor"] > 1.6
    assert verdict["answer"] == "pass" and verdict["probability_of_conformity"] > 0.99


def test_without_a_reference_nothing_passes(client):
    run = imported(client, "IM-none", poses())
    assert run["verdict"]["answer"] == "undecided"
    assert newest(client, "IM-none")["expanded_uncertainty_deg"] is None
    assert "rig" not in run["provenance"]
    elsewhere = imported(client, "IM-elsewhere", poses(), rig="a bench of another house")
    assert newest(client, "IM-elsewhere")["expanded_uncertainty_deg"] is None
    assert elsewhere["rig"] == "a bench of another house"


def test_what_is_stated_wins_over_file_and_rig_and_the_contradiction_is_told(client):
    file = poses(",reference_std_deg", ",0.03")
    run = imported(client, "IM-stated", file, rig="bench-1", reference_std_deg="0.2")
    assert newest(client, "IM-stated")["uncertainty"]["type_b_deg"] == pytest.approx(0.2)
    assert any("0.03" in said and "0.2" in said for said in run["provenance"]["warnings"])
    assert "certificate" not in {k for k, v in run["provenance"]["rig"]["reference"].items() if v}


def test_an_excluded_pose_leaves_the_reference(client):
    run = imported(client, "IM-excluded", poses(), reference_std_deg="0.03")
    again = client.post(f"/api/runs/{run['id']}/poses/3/exclude", json={"reason": "touched"}).json()
    assert again["result"]["n_poses"] == 25
    assert again["result"]["reference"]["std_deg"] == STD_DEG
    assert newest(client, "IM-excluded")["revision"] == 2
    assert newest(client, "IM-excluded")["expanded_uncertainty_deg"] > STD_DEG


def test_a_reading_that_lost_a_digit_keeps_a_draft_until_it_is_excluded(client):
    lines = poses().splitlines()
    lines[6] = "-10,-90.9"
    run = imported(client, "IM-digit", "\n".join(lines))
    assert not run["verdict"]["reliable"]
    assert "−90.9° at −10°" in newest(client, "IM-digit")["warnings"][0]
    again = client.post(f"/api/runs/{run['id']}/poses/5/exclude", json={"reason": "a digit more"}).json()
    assert again["verdict"]["reliable"]
    assert (newest(client, "IM-digit")["revision"], newest(client, "IM-digit")["warnings"]) == (2, [])


def test_an_import_is_released_certified_exported_and_applied(client, tmp_path):
    unit = "IM-whole"
    imported(client, unit, poses(), rig="bench-1")
    address = f"/api/units/{unit}/calibration"
    assert client.get(address).status_code == 404  # a draft: the rig's release is manual
    client.post(f"{address}s/1/release", json={"reason": "reviewed"}).raise_for_status()
    document = client.get(address).raise_for_status().json()

    number = client.post(f"/api/units/{unit}/certificates", json={"revision": 1}).json()["number"]
    certificate = f"/api/certificates/{number}"
    pdf = client.get(certificate, params={"format": "pdf"}).raise_for_status().content
    text = "".join(page.extract_text() for page in pypdf.PdfReader(io.BytesIO(pdf)).pages)
    for words in (unit, "K-2026-0815", "poses.csv"):
        assert words in text
    dcc = client.get(certificate, params={"format": "dcc"}).raise_for_status().text
    assert "K-2026-0815" in dcc and "expandedUnc" in dcc

    file, readings = tmp_path / "calibration.json", tmp_path / "readings.csv"
    server = str(client.base_url)
    file.write_text(calrig("export", "--unit", unit, "--server", server).stdout)
    assert json.loads(file.read_text()) == document
    readings.write_text(f"reading_deg\n{BIAS_DEG + SCALE * 25.0}\n")
    names, row = calrig("apply", file, readings).stdout.splitlines()[-2:]
    applied = dict(zip(names.split(","), map(float, row.split(",")), strict=True))
    assert applied["elevation_deg"] == pytest.approx(25.0, abs=0.02)
    # common to all poses, it is no part of the elevation relative to its mean
    assert 0.0 < applied["elevation_std_deg"] < 2.0 * STD_DEG


def test_a_certificate_of_an_import_states_what_is_known_of_it_and_nothing_else(client):
    unit = "IM-elsewhere-certified"
    form = {"reference_std_deg": "0.03", "reference_certificate": "E-77/2026"}
    run = imported(client, unit, poses(), **form)
    client.post(f"/api/units/{unit}/calibrations/1/release", json={"reason": "ok"}).raise_for_status()
    number = client.post(f"/api/units/{unit}/certificates", json={"revision": 1}).json()["number"]
    pdf, dcc = (
        client.get(f"/api/certificates/{number}", params={"format": form}).raise_for_status().content
        for form in ("pdf", "dcc")
    )
    text = " ".join("".join(p.extract_text() for p in pypdf.PdfReader(io.BytesIO(pdf)).pages).split())
    assert "traceable to the certificate E-77/2026" in text and "E-77/2026" in dcc.decode()
    for unknown in ("die thermometer", "own clock", "rule of its rig"):
        assert unknown not in text and unknown not in dcc.decode()
    day = run["created_at"][:10]
    assert f"not stated; measured no later than {day}" in text
    root, names = ElementTree.fromstring(dcc), {"dcc": "https://ptb.de/dcc"}
    core = root.find(".//dcc:coreData", names)
    for tag in ("beginPerformanceDate", "endPerformanceDate"):
        assert core.findtext(f"dcc:{tag}", namespaces=names) == day
    said = root.find(".//dcc:statement[@refType='calrig_dates']", names)
    assert "not stated" in " ".join(said.itertext()) and "import" in " ".join(said.itertext())
    released = root.find(".//dcc:statement[@refType='calrig_release']", names)
    assert released.findtext("dcc:date", namespaces=names) is not None


@pytest.mark.parametrize(
    ("form", "field"),
    [
        ({"reference_std_deg": "0"}, "reference_std_deg"),
        ({"reference_std_deg": "nan"}, "reference_std_deg"),
        ({"reference_std_deg": "1e308"}, "reference_std_deg"),
        ({"reference_std_deg": "0.1", "reference_kind": "map"}, "reference_kind"),
        ({"reference_kind": "common"}, "reference_std_deg"),
        ({"reference_certificate": "K-1"}, "reference_std_deg"),
        ({"reference_std_deg": "0.1", "reference_certificate": "K\u202e1"}, "reference_certificate"),
    ],
)
def test_a_reference_that_states_nothing_is_refused_with_its_field(client, form, field):
    files = {"file": ("poses.csv", poses())}
    answer = client.post("/api/imports", files=files, data={"unit": "IM-bad", **form})
    assert answer.status_code == 422 and field in json.dumps(answer.json()["detail"])
    assert client.get("/api/units/IM-bad").status_code == 404


@pytest.mark.parametrize(
    ("columns", "rows", "line", "column"),
    [
        ("reference_std_deg", ("0.03", "0.04"), 3, "reference_std_deg"),
        ("reference_std_deg", ("0.03", "-1"), 3, "reference_std_deg"),
        ("reference_std_deg", ("0.03", "good"), 3, "reference_std_deg"),
        ("reference_std_deg,reference_kind", ("0.03,common", "0.03,map"), 3, "reference_kind"),
        ("reference_std_deg,reference_kind", ("0.03,common", "0.03,setting"), 3, "reference_kind"),
        ("reference_kind", ("common", "common"), 2, "reference_kind"),
    ],
)
def test_columns_that_state_no_reference_are_refused_with_line_and_column(
    client, columns, rows, line, column
):
    file = "\n".join(
        [f"target_deg,reading_deg,{columns}", *(f"{k},{k}.1,{row}" for k, row in enumerate(rows))]
    )
    answer = client.post("/api/imports", files={"file": ("f.csv", file)}, data={"unit": "IM-bad"})
    assert answer.status_code == 422
    said = json.dumps(answer.json()["detail"])
    assert f"line {line}" in said and column in said


def test_the_command_line_states_it_here_and_to_a_service(client, tmp_path):
    file, store = tmp_path / "poses.csv", tmp_path / "own.db"
    file.write_text(poses())
    stated = ("--reference-std", STD_DEG, "--reference-kind", "common", "--reference-certificate", "K-9")
    calrig("import", file, "--unit", "IM-there", *stated, "--server", str(client.base_url))
    calrig("import", file, "--unit", "IM-here", *stated, "--db", store)
    here = json.loads(calrig("export", "--unit", "IM-here", "--db", store).stdout)
    there = newest(client, "IM-there")
    assert here["expanded_uncertainty_deg"] == there["expanded_uncertainty_deg"] > STD_DEG
    for document in (here, there):
        assert document["provenance"]["rig"]["reference"]["certificate"] == "K-9"
    for bad in (
        ("--reference-std", 0),
        ("--reference-std", "inf"),
        ("--reference-kind", "common"),
        ("--reference-certificate", "K"),
    ):
        calrig("import", file, "--unit", "IM-bad", *bad, "--db", store, status=2)
