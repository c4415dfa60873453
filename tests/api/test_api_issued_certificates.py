"""Issued certificates over HTTP: numbered, kept unchanged, corrected by new ones, in trail and archive."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pypdf
import pytest
from laboratory_keys import key_files
from pyhanko.keys import load_certs_from_pemder
from pyhanko.pdf_utils.reader import PdfFileReader
from pyhanko.sign.validation import validate_pdf_signature
from pyhanko.sign.validation.settings import KeyUsageConstraints
from pyhanko.sign.validation.status import PdfSignatureStatus, SignatureCoverageLevel
from pyhanko_certvalidator import ValidationContext
from signxml.verifier import XMLVerifier
from support import POSES, running_service, serving

from calrig.analysis import certificate_forms
from calrig.analysis.certificates import issue_certificate
from calrig.laboratory import LaboratorySettings
from calrig.settings import RigSettings
from calrig.store.errors import Refused

UNIT = "AS-7"
TYPES = {"pdf": "application/pdf", "dcc": "application/xml", "json": "application/json"}


@pytest.fixture
def lab(rig: RigSettings, tmp_path: Any) -> Iterator[tuple[httpx.Client, Any]]:
    """A laboratory with a calibrated unit."""
    laboratory = LaboratorySettings(name="First laboratory", authorised_by="Ada")
    with (
        running_service(tmp_path / "calrig.db", rig) as service,
        serving(service, laboratory=laboratory) as client,
    ):
        imported(client)
        yield client, service


def imported(client: httpx.Client) -> None:
    """Import a run of the unit and put its calibration in force."""
    files = {"file": ("poses.csv", POSES)}
    client.post("/api/imports", files=files, data={"unit": UNIT}).raise_for_status()
    newest = client.get(f"/api/units/{UNIT}/calibrations").json()[0]
    if newest["status"] == "draft":
        path = f"/api/units/{UNIT}/calibrations/{newest['revision']}/release"
        client.post(path, json={"reason": "a test"}).raise_for_status()


def issued(client: httpx.Client, **body: Any) -> dict[str, Any]:
    answer = client.post(f"/api/units/{UNIT}/certificates", json={"revision": 1, **body})
    assert answer.status_code == 201, answer.text
    told: dict[str, Any] = answer.json()
    return told


def served(client: httpx.Client, number: str) -> dict[str, bytes]:
    found = {}
    for form, kind in TYPES.items():
        answer = client.get(f"/api/certificates/{number}", params={"format": form}).raise_for_status()
        assert answer.headers["content-type"].startswith(kind)
        found[form] = answer.content
    return found


def text_of(pdf: bytes) -> str:
    return "".join(page.extract_text() for page in pypdf.PdfReader(io.BytesIO(pdf)).pages)


def test_a_certificate_stays_as_it_was_issued_whatever_the_laboratory_is_called_later(lab) -> None:
    client, service = lab
    one = issued(client)
    before = served(client, one["number"])
    for form, content in before.items():
        assert one["sha256"][form] == hashlib.sha256(content).hexdigest()
    assert one["number"] in text_of(before["pdf"]) and "PREVIEW" not in text_of(before["pdf"])
    assert one["number"].encode() in before["dcc"]
    inside = pypdf.PdfReader(io.BytesIO(before["pdf"])).attachments
    assert inside["certificate.xml"] == [before["dcc"]] and inside["calibration.json"] == [before["json"]]

    assert (one["settings"]["name"], one["settings"]["authorised_by"]) == ("First laboratory", "Ada")
    client.put(f"/api/units/{UNIT}/item", json={"customer": "Another customer"}).raise_for_status()
    with serving(service, laboratory=LaboratorySettings(name="Second laboratory")) as renamed:
        assert served(renamed, one["number"]) == before
        preview = renamed.get(f"/api/units/{UNIT}/calibration", params={"format": "pdf"}).content
        assert "PREVIEW" in text_of(preview) and "Second laboratory" in text_of(preview)


@pytest.mark.parametrize("kind", ["ec", "rsa"])
def test_the_laboratory_signs_the_pdf_and_the_dcc_that_is_inside(lab, tmp_path, kind) -> None:
    _, service = lab
    key, certificate = key_files(tmp_path, "lab", kind)
    laboratory = LaboratorySettings(signing_key=str(key), signing_certificate=str(certificate))
    with serving(service, laboratory=laboratory) as client:
        kept = served(client, issued(client)["number"])
        preview = client.get(f"/api/units/{UNIT}/calibration", params={"format": "pdf"}).content
    reader = pypdf.PdfReader(io.BytesIO(kept["pdf"]))
    assert reader.attachments["certificate.xml"] == [kept["dcc"]]
    stated = reader.root_object["/Metadata"].get_data()
    assert b"<pdfaid:part>3<" in stated and b"pyHanko" not in stated, "it stays PDF/A-3 as typst wrote it"
    XMLVerifier().verify(kept["dcc"], x509_cert=certificate.read_text())

    signature = pdf_signature(kept["pdf"], certificate)
    assert signature.bottom_line and signature.coverage == SignatureCoverageLevel.ENTIRE_FILE
    place = kept["pdf"].index(b"/Title")  # within what is signed
    changed = kept["pdf"][:place] + b"/Tutle" + kept["pdf"][place + 6 :]
    assert not pdf_signature(changed, certificate).intact
    other = key_files(tmp_path, "other", kind)[1]
    assert not pdf_signature(kept["pdf"], other).trusted
    assert PdfFileReader(io.BytesIO(preview)).embedded_signatures == []


def pdf_signature(pdf: bytes, trusted: Path) -> PdfSignatureStatus:
    (embedded,) = PdfFileReader(io.BytesIO(pdf)).embedded_signatures
    context = ValidationContext(trust_roots=list(load_certs_from_pemder([str(trusted)])))
    any_use = KeyUsageConstraints(key_usage=set())
    return validate_pdf_signature(embedded, context, key_usage_settings=any_use)


def test_a_correction_is_a_new_certificate_that_names_the_one_it_replaces_and_why(lab) -> None:
    client, _ = lab
    first = issued(client)
    no_reason = {"revision": 1, "replaces": first["number"]}
    assert client.post(f"/api/units/{UNIT}/certificates", json=no_reason).status_code == 422
    second = issued(client, replaces=first["number"], reason="wrong customer")
    assert (second["replaces"], second["reason"]) == (first["number"], "wrong customer")
    text = " ".join(text_of(served(client, second["number"])["pdf"]).split())
    assert first["number"] in text and "wrong customer" in text
    listed = client.get("/api/certificates", params={"unit": UNIT}).json()
    assert [(one["number"], one["replaced_by"]) for one in listed] == [
        (second["number"], None),
        (first["number"], second["number"]),
    ]
    part = client.get("/api/certificates", params={"number": first["number"][5:].lower()}).json()
    assert [one["number"] for one in part] == [first["number"]]
    again = {"revision": 1, "replaces": first["number"], "reason": "once more"}
    answer = client.post(f"/api/units/{UNIT}/certificates", json=again)
    assert answer.status_code == 409 and second["number"] in answer.json()["detail"]
    assert client.get("/api/certificates", params={"unit": "another"}).json() == []


def test_a_certificate_amends_no_other_unless_it_names_one(lab) -> None:
    client, _ = lab
    run = client.get("/api/runs").json()["items"][0]["id"]
    client.post(f"/api/runs/{run}/poses/0/exclude", json={"reason": "knocked"}).raise_for_status()
    why = {"reason": "without the knock"}
    newest = client.get(f"/api/units/{UNIT}/calibrations").json()[0]
    if newest["status"] == "draft":
        client.post(f"/api/units/{UNIT}/calibrations/2/release", json=why).raise_for_status()
    first = issued(client, revision=2)
    kept = served(client, first["number"])
    text = " ".join(text_of(kept["pdf"]).split())
    assert "amends" not in text and "This revision evaluates the measurement of revision 1" in text
    assert b"reportAmendedSubstituted" not in kept["dcc"] and b"previousReport" in kept["dcc"]
    assert f"newest entry of the audit trail before the issue was {first['trail_seq']}," in text
    second = issued(client, revision=2, replaces=first["number"], reason="wrong customer")
    kept = served(client, second["number"])
    assert f"This certificate amends and replaces certificate {first['number']}" in " ".join(
        text_of(kept["pdf"]).split()
    )
    replaced = f"<dcc:replacedUniqueIdentifier>{first['number']}</dcc:replacedUniqueIdentifier>"
    assert replaced.encode() in kept["dcc"]


def test_what_cannot_be_issued_or_found_is_said(lab) -> None:
    client, _ = lab
    path = f"/api/units/{UNIT}/certificates"
    assert client.post(path, json={"revision": 9}).status_code == 404
    unknown = {"revision": 1, "replaces": "0001-NONE", "reason": "x"}
    assert client.post(path, json=unknown).status_code == 404
    assert client.get("/api/certificates/0001-NONE").status_code == 404
    client.post(f"/api/units/{UNIT}/calibrations/1/withdraw", json={"reason": "dropped"}).raise_for_status()
    assert client.post(path, json={"revision": 1}).status_code == 409
    run = client.get("/api/runs").json()["items"][0]["id"]
    drafted = client.post(f"/api/units/{UNIT}/calibrations", json={"run_id": run}).raise_for_status().json()
    if drafted["status"] == "draft":
        assert client.post(path, json={"revision": drafted["revision"]}).status_code == 409


def test_a_revision_that_is_withdrawn_while_its_certificate_is_made_gets_none(lab) -> None:
    _, service = lab
    revision = service.store.revisions.get(UNIT, 1)

    def withdrawn_meanwhile(typeset: Callable[[], bytes]) -> bytes:
        service.issuer.withdraw(UNIT, 1, by="ada", reason="the clamp was loose")
        return typeset()

    with pytest.raises(Refused, match="is withdrawn now"):
        issue_certificate(service.store, revision, LaboratorySettings(), carried_out=withdrawn_meanwhile)
    assert service.store.certificates.of(UNIT) == []


def test_it_is_in_the_trail_whose_newest_entries_cannot_be_cut_off_unseen(lab) -> None:
    client, service = lab
    one = issued(client)
    (entry,) = service.store.trail.entries(what=["certificate_issued"])
    assert (entry.unit, entry.revision, entry.detail["number"]) == (UNIT, 1, one["number"])
    assert entry.seq == one["trail_seq"] + 1
    assert service.store.trail.broken_link() is None
    database = service.store._database
    with database.writing() as session:
        session.connection().exec_driver_sql(f"DELETE FROM trail WHERE seq >= {one['trail_seq']}")
    assert service.store.trail.broken_link() == one["trail_seq"]


def test_the_entry_of_the_issue_itself_cannot_be_cut_off_unseen(lab) -> None:
    client, service = lab
    one = issued(client)
    with service.store._database.writing() as session:
        session.connection().exec_driver_sql(f"DELETE FROM trail WHERE seq > {one['trail_seq']}")
    assert service.store.trail.broken_link() == one["trail_seq"] + 1


def test_its_documents_are_made_by_another_process(lab, monkeypatch: pytest.MonkeyPatch) -> None:
    client, _ = lab
    for name in ("dcc_of", "svg_of", "pdf_of"):
        monkeypatch.setattr(certificate_forms, name, None)  # of the service's own process
    assert issued(client)["sha256"]["pdf"] is not None
    preview = f"/api/units/{UNIT}/calibration?revision=1&format="
    assert client.get(f"{preview}dcc").is_success
    assert client.get(f"{preview}pdf").is_success


def test_the_archive_has_it_byte_for_byte(lab) -> None:
    client, _ = lab
    one = issued(client)
    content = client.get(f"/api/units/{UNIT}/archive").raise_for_status().content
    kept = served(client, one["number"])
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.read(f"certificates/{one['number']}.pdf") == kept["pdf"]
        assert archive.read(f"certificates/{one['number']}.xml") == kept["dcc"]
        entries = [json.loads(line) for line in archive.read("trail.jsonl").splitlines()]
    (entry,) = [one for one in entries if one["what"] == "certificate_issued"]
    assert entry["detail"]["settings"] == one["settings"]
    assert "signing_key" not in one["settings"]


def test_bytes_that_were_changed_are_not_served(lab) -> None:
    client, service = lab
    one = issued(client)
    with service.store._database.writing() as session:
        session.connection().exec_driver_sql("UPDATE certificate SET dcc = X'00'")
    answer = client.get(f"/api/certificates/{one['number']}", params={"format": "dcc"})
    assert answer.status_code == 500 and one["number"] in answer.json()["detail"]
