"""Certificates as PDF: what they say, that they are the same again, and what they rest on."""

from __future__ import annotations

import io
import math
import re
import sys
from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta
from typing import Any

import httpx
import pypdf
import pytest
from support import POSES, QUICK, ended, running_service, serving

from calrig.analysis.amendments import Records
from calrig.analysis.certificates import certificate
from calrig.export.certificate.content import Certificate
from calrig.laboratory import LaboratorySettings
from calrig.settings import RigSettings

SERIAL = "ÄS-2026-" + "X9" * 25 + "-Z"
LABORATORY = LaboratorySettings(
    name="Kalibrierlabor Süd", address="Lindenweg 5, München", authorised_by="A. Λόγος"
)
STAGE = {
    "std_deg": 0.29,
    "certificate": "DKD-K-12345",
    "issued_by": "PTB",
    "issued_at": date(2025, 3, 1),
    "due": date(2026, 3, 1),
    "sha256": "ab" * 32,
}
ITEM = {
    "customer": "Общество «Гироскоп»",
    "address": "ул. Ленина 1\nМосква",
    "condition": "one scratch",
    "received_at": "2020-02-29",
    "interval_agreed_months": 12,
    "supplied": ["customer", "address"],
}
LIMIT = {"name": "flight", "max_error_deg": 1.5, "rule": "guarded"}


@pytest.fixture(scope="module")
def lab(rig: RigSettings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[httpx.Client, Any]]:
    """A service whose stage's certificate is overdue, with a unit that was calibrated and amended once."""
    assert rig.reference is not None
    overdue = rig.model_copy(update={"reference": rig.reference.model_copy(update=STAGE)})
    path = tmp_path_factory.mktemp("certificates") / "calrig.db"
    with (
        running_service(path, overdue) as service,
        serving(service, laboratory=LABORATORY) as client,
    ):
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        run = client.post("/api/runs", json={"unit": SERIAL, "plan": QUICK}).raise_for_status().json()
        assert ended(client, run["id"])["status"] == "completed"
        client.put(f"/api/units/{SERIAL}/item", json=ITEM).raise_for_status()
        knocked = {"reason": "somebody leant on the bench"}
        client.post(f"/api/runs/{run['id']}/poses/1/exclude", json=knocked).raise_for_status()
        yield client, service


@pytest.fixture(scope="module")
def pages(lab: tuple[httpx.Client, Any]) -> list[str]:
    """The certificate of that unit, read back once: pypdf takes a second of processor time."""
    return pages_of(pdf_of(lab[0]))


def pdf_of(client: httpx.Client, serial: str = SERIAL, **asked: Any) -> bytes:
    answer = client.get(f"/api/units/{serial}/calibration", params={"format": "pdf", **asked})
    assert answer.headers["content-type"] == "application/pdf", answer.text
    return answer.raise_for_status().content


def pages_of(pdf: bytes, most: int | None = None) -> list[str]:
    """The text of each page, as a reader copies it out."""
    return [page.extract_text() for page in pypdf.PdfReader(io.BytesIO(pdf)).pages[:most]]


def flat(text: str) -> str:
    """Without line breaks, and with one kind of minus."""
    return "".join(text.split()).replace("−", "-")


def from_a_file(service: Any, unit: str) -> None:
    """A calibrated unit without the process that an import over HTTP is read in."""
    records = Records(service.store, service.issuer)
    records.import_poses(unit=unit, rig=None, file_name="poses.csv", content=POSES.encode())


def content(service: Any, revision: int | None = None) -> Certificate:
    found = (
        service.store.revisions.in_force(SERIAL)
        if revision is None
        else service.store.revisions.get(SERIAL, revision)
    )
    return certificate(service.store, found, LABORATORY)


def test_every_number_of_the_document_and_of_the_content_is_in_it(
    lab: tuple[httpx.Client, Any], pages: list[str]
) -> None:
    said, text = content(lab[1]), flat("".join(pages))
    results, budget = said.results, said.budget
    assert len(said.document) > 40
    for key, value in said.document:
        assert flat(key) in text and flat(value) in text, key
    for figure in (*results.line, *results.figures):
        assert flat(figure.text) in text
    assert results.elevation is not None
    assert f"U={results.elevation.expanded_text}°(k={results.elevation.coverage_factor:.2f},95%)" in text
    assert str(math.floor(budget.effective_freedom or 0.0)) in text
    assert len(results.points) == 3 and all(f"{point.elevation_deg:g}°" in text for point in results.points)


def test_it_says_whose_it_is_what_is_known_and_what_is_not(pages: list[str]) -> None:
    text = flat("".join(pages))
    for words in (
        SERIAL,
        "Laboratory: Kalibrierlabor Süd",
        "Customer † Общество «Гироскоп»",
        "Customer's address † ул. Ленина 1 Москва",
        "Condition at receipt one scratch",
        "Order number not stated",
        "Date of receipt 2020-02-29",
        "12 months, as agreed with the customer",
        "Authorised by: A. Λόγος",
        "Angles are traceable to the certificate DKD-K-12345 of PTB",
        "2026-03-01 (overdue)",
        "Pose 1 at 0° does not count: somebody leant on the bench",
        "Statement Pass",
        "guarded rule, w = 1·U",
        "relative to its mean over this range: the level is not known",
    ):
        assert flat(words) in text, words
    assert "ccredit" not in text


def test_each_page_has_the_number_and_the_last_one_the_end(
    lab: tuple[httpx.Client, Any], pages: list[str]
) -> None:
    number = content(lab[1]).number
    assert re.fullmatch(r"PREVIEW-0002-[0-9A-F]{12}", number)
    for k, page in enumerate(pages, 1):
        assert flat(f"Certificate {number} {k} of {len(pages)}") in flat(page)
    assert flat(pages[-1]).endswith(flat(f"– End of certificate {number} –"))


def test_it_is_pdf_a_3_the_same_bytes_again_with_the_document_inside(lab: tuple[httpx.Client, Any]) -> None:
    client, service = lab
    first = pdf_of(client)
    assert first == pdf_of(client)
    reader = pypdf.PdfReader(io.BytesIO(first))
    metadata = reader.trailer["/Root"]["/Metadata"].get_data().decode()
    assert "<pdfaid:part>3</pdfaid:part>" in metadata and "<pdfaid:conformance>B<" in metadata
    assert reader.attachments["calibration.json"] == [service.store.revisions.in_force(SERIAL).text.encode()]


def test_an_amendment_names_what_it_replaces_and_other_words_have_another_number(
    lab: tuple[httpx.Client, Any],
) -> None:
    client, service = lab
    first, second = content(service, 1), content(service, 2)
    assert second.replaces is not None and second.replaces.is_same_run
    assert (second.replaces.revision, second.replaces.sha256) == (1, first.document_sha256)
    assert (first.replaces, first.status) == (None, "superseded")
    text = flat("".join(pages_of(pdf_of(client, revision=1), 1)))
    assert flat("SUPERSEDED by a later revision") in text
    client.put(f"/api/units/{SERIAL}/item", json={**ITEM, "order": "42"}).raise_for_status()
    assert content(service, 2).number != second.number
    client.put(f"/api/units/{SERIAL}/item", json=ITEM).raise_for_status()
    assert content(service, 2).number == second.number


def test_the_trail_says_where_the_head_of_its_chain_was(lab: tuple[httpx.Client, Any]) -> None:
    _, service = lab
    mark = content(service).trail
    assert mark is not None
    entry = next(one for one in service.store.trail.entries() if one.seq == mark.seq)
    assert (entry.sha256, entry.what, entry.revision) == (mark.sha256, "released", 2)


def test_what_a_unit_came_with_on_a_later_day_is_not_of_an_earlier_calibration(
    lab: tuple[httpx.Client, Any],
) -> None:
    client, service = lab
    tomorrow = (datetime.now(UTC) + timedelta(days=1)).date().isoformat()
    again = {**ITEM, "customer": "Somebody else", "received_at": tomorrow}
    said = client.put(f"/api/units/{SERIAL}/item", json=again).raise_for_status().json()
    assert said == {**again, "order": None, "description": None}
    assert client.get(f"/api/units/{SERIAL}/item").json() == said
    assert content(service).item.customer == ITEM["customer"]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"customer": "a\u202eb"}, "cannot be printed"),
        ({"interval_agreed_months": 0}, "Months until the next calibration"),
        ({"supplied": ["colour"]}, "supplied"),
        ({"price": "1"}, "price"),
    ],
)
def test_what_cannot_be_said_of_a_unit_is_refused(
    lab: tuple[httpx.Client, Any], wrong: dict[str, Any], says: str
) -> None:
    answer = lab[0].put(f"/api/units/{SERIAL}/item", json=wrong)
    assert (answer.status_code, says in answer.json()["detail"]) == (422, True)
    assert lab[0].put("/api/units/nobody/item", json={}).status_code == 404


def test_a_unit_of_a_file_has_a_certificate_that_says_so_and_states_no_uncertainty(
    lab: tuple[httpx.Client, Any],
) -> None:
    from_a_file(lab[1], "FILE-1")
    text = flat("".join(pages_of(pdf_of(lab[0], "FILE-1"), 1)))
    assert flat("Expanded uncertainty of a calibrated elevation: not stated") in text
    assert flat("Customer not stated") in text
    found = certificate(lab[1].store, lab[1].store.revisions.in_force("FILE-1"), LABORATORY)
    assert "they were imported from a file" in found.deviations[0]


def test_a_character_that_no_font_has_is_named(lab: tuple[httpx.Client, Any]) -> None:
    from_a_file(lab[1], "ROCKET-🚀")
    answer = lab[0].get("/api/units/ROCKET-🚀/calibration?format=pdf")
    assert answer.status_code == 409
    assert "🚀" in answer.json()["detail"] and "[laboratory]" in answer.json()["detail"]


def test_without_typst_it_is_said_what_to_install(
    lab: tuple[httpx.Client, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)  # as where it is not installed
    answer = lab[0].get(f"/api/units/{SERIAL}/calibration?format=pdf")
    assert answer.status_code == 501
    assert "pip install 'typst" in answer.json()["detail"]


def test_a_run_on_an_overdue_reference_is_flagged_or_not_begun(
    lab: tuple[httpx.Client, Any], rig: RigSettings, tmp_path: Any
) -> None:
    client, _ = lab
    (run,) = client.get("/api/runs", params={"unit": SERIAL}).json()["items"]
    (warning,) = run["provenance"]["warnings"]
    assert all(word in warning for word in ("DKD-K-12345", "bench-1", "2026-03-01"))
    assert run["provenance"]["rig"]["reference"]["sha256"] == "ab" * 32
    assert warning in client.post("/api/plans/estimate", json={"plan": QUICK}).json()["warnings"]

    assert rig.reference is not None
    reference = rig.reference.model_copy(update=STAGE)
    strict = rig.model_copy(update={"reference": reference, "overdue": "refuse"})
    with running_service(tmp_path / "strict.db", strict) as service, serving(service) as refusing:
        answer = refusing.post("/api/runs", json={"unit": "A", "plan": QUICK})
        assert answer.status_code == 409
        assert "Nothing was moved: have it calibrated" in answer.json()["detail"]
        assert refusing.get("/api/runs").json()["items"] == []


def test_of_a_run_with_several_mounts_the_poses_of_the_first_one_count(lab: tuple[httpx.Client, Any]) -> None:
    rows = [
        f"{x},{0.5 + x + mount + 0.01 * (-1) ** x},{mount}" for mount in (0, 90) for x in range(-40, 41, 10)
    ]
    file = "\n".join(["target_deg,reading_deg,mount_deg", *rows]).encode()
    service = lab[1]
    Records(service.store, service.issuer).import_poses(unit="M-1", rig=None, file_name="m", content=file)
    said = certificate(service.store, service.store.revisions.in_force("M-1"), LABORATORY)
    assert [point.elevation_deg for point in said.results.points] == list(range(-40, 41, 10))
    assert any(words.startswith("9 poses at further mounts do not count here") for words in said.deviations)


def test_a_unit_is_found_by_what_was_in_force_when_its_run_began_and_never_by_a_later_revision(
    lab: tuple[httpx.Client, Any],
) -> None:
    service = lab[1]

    def found_by(revision: int) -> str:
        wanted = service.store.revisions.get("FOUND-1", revision)
        return certificate(service.store, wanted, LABORATORY).results.found_by

    for _ in range(2):
        from_a_file(service, "FOUND-1")
    second, first = service.store.revisions.of("FOUND-1")
    again = service.issuer.draft("FOUND-1", first.run_id)
    assert "without any calibration" in found_by(first.revision)
    assert found_by(second.revision).startswith(f"revision {first.revision} ")
    assert "without any calibration" in found_by(again.revision)
