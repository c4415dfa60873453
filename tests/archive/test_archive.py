"""A unit's archive: complete, the same bytes for the same data, and every damage is found and named."""

from __future__ import annotations

import csv
import io
import json
import random
import warnings
import zipfile

import numpy as np
import pytest
from empty_store import lay_empty_store
from filled_unit import MAPPED, UNIT, archive, block, fill, poses_csv
from forged import container, members, resealed, resigned
from hypothesis import given, settings
from hypothesis import strategies as st

from calrig.analysis.amendments import Records
from calrig.analysis.certificates import issue_certificate
from calrig.analysis.revisions import Issuer
from calrig.canonical_json import sha256_of
from calrig.export.archive import layout
from calrig.export.poses_csv import read_poses
from calrig.laboratory import LaboratorySettings
from calrig.store import Store

DOCUMENTS = (layout.REVISIONS, layout.EFFECTS, layout.RUNS, layout.MANIFEST)


def where(found) -> set[str]:
    return {place for place, _ in found.problems}


def said(found) -> str:
    return "\n".join(f"{place}: {what}" for place, what in found.problems)


def test_an_archive_holds_all_of_a_unit_and_proves_it(filled, whole, check):
    found = check(whole)
    assert found.problems == []
    assert (found.unit, found.revisions, found.runs) == (UNIT, 4, 3)
    assert found.refitted == [1, 2, 3, 4], "poses, exclusions and effects give each document's numbers"
    assert found.not_refitted == {}
    kept = members(whole)
    with Store.open(filled, writer=None) as store:
        for one in store.revisions.of(UNIT):
            assert kept[layout.document_name(one.revision)] == one.text.encode(), "byte for byte as issued"
        states = [(one["revision"], one["status"]) for one in json.loads(kept[layout.REVISIONS])]
        assert states == [(4, "withdrawn"), (3, "superseded"), (2, "superseded"), (1, "superseded")]
        entries = [json.loads(line) for line in kept[layout.TRAIL].splitlines()]
        assert [one["seq"] for one in entries] == [entry.seq for entry in store.trail.entries(unit=UNIT)]
        for run in json.loads(kept[layout.RUNS]):
            poses = [stored.pose for stored in store.poses.of(run["run_id"])]
            assert read_poses(kept[layout.run_names(run["run_id"])[1]]).poses == poses
        head = store.trail.entries(newest_first=True, limit=1)[0]
    manifest = json.loads(kept[layout.MANIFEST])
    assert manifest["trail"]["head"] == {"seq": head.seq, "sha256": head.sha256}
    (left_out,) = manifest["left_out"]
    assert left_out["why"] == "is running"
    run = json.loads(kept[layout.run_names(json.loads(kept[layout.REVISIONS])[-1]["run_id"])[0]])
    assert run["poses"] == {
        "indices": [[0, 23]],
        "excluded": {"5": "somebody leant \u2028 on the 'bench' \\ 温度"},
    }


def test_raw_samples_read_back_exactly_with_their_pose_and_phase(whole):
    kept = members(whole)
    texts = (content.decode() for name, content in kept.items() if name.endswith("samples.csv"))
    (rows,) = (rows for text in texts if (rows := list(csv.DictReader(io.StringIO(text)))))
    assert len(rows) == 3 * 2 * 40
    own = [row for row in rows if (row["pose"], row["phase"]) == ("1", "dwell")]
    of_block = block(1, "dwell")
    for place, axis in enumerate("xyz"):
        read = [float(row[f"accel_{axis}_g"]) for row in own]
        np.testing.assert_array_equal(read, of_block.accel_g[:, place])
    assert {row["gyro_x_dps"] for row in own} == {""}, "what is not known"
    assert {row["angle_deg"] for row in own} == {"1.5"}


def test_the_same_store_gives_the_same_bytes_and_one_more_entry_other_ones(filled, whole, tmp_path):
    with Store.open(filled, writer=None) as store:
        assert archive(store) == whole
        other = archive(store, "somebody else's")
    assert members(other)[layout.README] == members(whole)[layout.README]
    assert UNIT.encode() not in b"".join(members(other).values()), "nothing of another unit is in it"


def test_what_rests_on_a_map_of_the_stage_is_fitted_again_by_it(filled, check):
    with Store.open(filled, writer=None) as store:
        (revision,) = store.revisions.of(MAPPED)
        assert revision.basis["effects"], "of the stage, which the map holds already"
        whole = archive(store, MAPPED)
    assert (check(whole).problems, check(whole).refitted) == ([], [1])
    name = layout.run_names(revision.run_id)[0]
    run = json.loads(members(whole)[name])
    run["provenance"]["stage_map"] = None
    assert "its poses give" in said(check(resigned(whole, contents={name: json.dumps(run).encode()})))


@pytest.mark.parametrize("engine", ["postgresql"])
def test_a_centre_gives_an_archive_of_the_same_kind(engine, new_database, check):
    with Store.open(new_database(), writer="test") as store:
        fill(store)
        found = check(archive(store))
    assert (found.problems, found.refitted, found.runs) == ([], [1, 2, 3, 4], 3)


def test_any_changed_byte_of_the_file_is_found(whole, check):
    @settings(max_examples=25)
    @given(st.integers(0, len(whole) - 1), st.integers(1, 255))
    def changed(place, difference):
        content = bytearray(whole)
        content[place] ^= difference
        assert check(bytes(content)).problems

    changed()


def test_any_changed_byte_of_a_member_is_found_there_though_the_zip_was_made_anew(whole, check):
    kept = members(whole)

    @settings(max_examples=25)
    @given(st.sampled_from(sorted(kept)), st.randoms(use_true_random=False))
    def changed(name, rng):
        content = bytearray(kept[name])
        place = rng.randrange(len(content))
        content[place] ^= rng.randrange(1, 256)
        found = check(container({**kept, name: bytes(content)}))
        # a changed manifest may be about another file, or be no JSON any more
        assert found.problems if name == layout.MANIFEST else name in where(found)

    changed()


def test_what_is_missing_extra_or_cut_off_is_named(whole, check):
    kept = members(whole)
    name = layout.document_name(2)
    less = {key: content for key, content in kept.items() if key != name}
    assert check(container(less)).problems == [(name, "is missing")]
    name = layout.certificate_name("0001-0123456789AB", "pdf")
    assert check(container({name: b"%PDF", **kept})).problems == [(name, "is not in the manifest")]
    for cut in range(0, len(whole), 997):
        assert check(whole[:cut]).problems
    assert "byte" in said(check(b"PK\x03\x04" + whole)), "something was put before it"


@pytest.mark.parametrize("n_damages", [30, pytest.param(200, marks=pytest.mark.statistical)])
def test_random_damages_are_each_found(whole, check, n_damages):
    rng = random.Random(16)
    for _ in range(n_damages):
        content = bytearray(whole)
        first, n = rng.randrange(len(content)), rng.choice((1, 2, 16, 300))
        match rng.randrange(4):
            case 0:
                content[first : first + n] = rng.randbytes(n)
            case 1:
                del content[first : first + n]
            case 2:
                content[first:first] = rng.randbytes(n)
            case _:
                content[first : first + n] = bytes(min(n, len(content) - first))
        assert bytes(content) == whole or check(bytes(content)).problems


def test_a_forger_who_sets_every_hash_right_is_found_by_the_trail_and_by_the_poses(whole, check):
    kept = members(whole)
    name = layout.document_name(3)
    document = json.loads(kept[name])

    def forged(**figures):
        changed = {**document, **figures}
        changed["sha256"] = sha256_of(changed)
        listed = json.loads(kept[layout.REVISIONS])
        listed[1]["sha256"] = changed["sha256"]
        contents = {name: json.dumps(changed).encode(), layout.REVISIONS: json.dumps(listed).encode()}
        return check(resigned(whole, contents=contents))

    found = forged(scale=document["scale"] + 1e-4)
    assert where(found) == {name}
    assert "the trail says otherwise" in said(found)
    assert "scale is" in said(found)
    assert "rms_with_effects_deg is" in said(forged(rms_with_effects_deg=1e-3))
    assert "its effects are none" in said(forged(effects=[]))
    poses = layout.run_names(document["run_id"])[1]
    other = kept[poses].replace(b"0.0,0.7", b"0.0,0.6", 1)
    assert other != kept[poses]
    assert "and its poses give" in said(check(resigned(whole, contents={poses: other})))


def test_a_changed_or_lost_entry_of_the_trail_is_found(whole, check):
    lines = members(whole)[layout.TRAIL].splitlines(keepends=True)

    def trail(*lines):
        return said(check(resigned(whole, contents={layout.TRAIL: b"".join(lines)})))

    changed = [*lines[:4], lines[4].replace(b"ada", b"eve"), *lines[5:]]
    assert "its hash is another" in trail(*changed)
    assert "entries, and had" in trail(*lines[:-1])
    assert "does not go on" in trail(lines[1], lines[0], *lines[2:])
    manifest = json.loads(members(whole)[layout.MANIFEST])
    early = {**manifest["trail"], "head": {"seq": 3, "sha256": "0" * 64}}
    assert "does not lead to its head" in said(check(resigned(whole, manifest={"trail": early})))


def test_certificates_are_those_that_the_trail_tells_of(tmp_path, check):
    url = f"sqlite:///{tmp_path / 'calrig.db'}"
    lay_empty_store(tmp_path / "calrig.db")
    with Store.open(url, writer="test") as store:
        issuer = Issuer(store)
        Records(store, issuer).import_poses(unit="A", rig="r", file_name="p.csv", content=poses_csv(1))
        (revision,) = store.revisions.of("A")
        issued = issue_certificate(store, revision, LaboratorySettings())
        whole = archive(store, "A")
    pdf, xml = (layout.certificate_name(issued.number, form) for form in ("pdf", "dcc"))
    assert check(whole).problems == []

    def wrong(name, content):
        return check(resigned(whole, contents={name: content})).problems

    ((where, what),) = wrong(pdf, b"%PDF")
    assert where == pdf and "SHA-256" in what
    ((where, what),) = wrong(xml, None)
    assert where == layout.TRAIL and xml in what
    forged = layout.certificate_name("0001-0123456789AB", "pdf")
    ((where, what),) = wrong(forged, b"%PDF")
    assert where == forged and "never issued" in what


def hostile(*names: str, **options) -> bytes:
    """A zip by other means, with the hash of its bytes at its end."""
    made = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as opened:
        for name in names:
            info = zipfile.ZipInfo(name)
            info.compress_type = options.get("method", zipfile.ZIP_DEFLATED)
            info.external_attr = options.get("mode", 0o100644) << 16
            info.extra = options.get("extra", b"")
            opened.writestr(info, options.get("content", b"{}"))
    return resealed(made.getvalue())


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (hostile("../../etc/passwd"), "is no name"),
        (hostile("/etc/passwd"), "is no name"),
        (hostile("C:\\windows"), "is no name"),
        (hostile("runs\\..\\x"), "is no name"),
        (hostile("runs/1/../../x"), "is no name"),
        (hostile("revisions/"), "is no name"),
        (resealed(hostile("manifest.json+exe").replace(b"+", b"\0")), "is no name"),
        (hostile("manifest.json", mode=0o120777), "a link"),
        (hostile("manifest.json", "manifest.json"), "is there twice"),
        (hostile("manifest.json", method=zipfile.ZIP_LZMA), "another way"),
        (hostile("manifest.json", extra=b"\x75\x70\x05\x00\x01abcd"), "a second name"),
        (hostile("manifest.json", content=bytes(50_000_000)), "nothing of it is unpacked"),
        (hostile("manifest.json"), "is not what calrig writes"),
        (hostile("trail.jsonl"), "is missing"),
        (b"no zip at all", "is no zip file"),
        (b"", "is no zip file"),
    ],
)
def test_no_path_leaves_an_archive_and_no_bomb_is_unpacked(content, what, check):
    assert what in said(check(content))


def replaced(value, rng: random.Random):
    """The same JSON with one value of it another one."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = rng.choice(sorted(value))
        return {**value, key: replaced(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        place = rng.randrange(len(value))
        return [*value[:place], replaced(value[place], rng), *value[place + 1 :]]
    return rng.choice([None, -1, 1e308, 2**70, "", "x", [], {}, [[]], True])


def test_documents_of_any_other_form_are_refused_in_words(whole, check):
    kept = members(whole)
    rng = random.Random(2)
    names = [name for name in kept if name.endswith(".json")]
    for _ in range(12):
        name = rng.choice(names)
        changed = json.dumps(replaced(json.loads(kept[name]), rng)).encode()
        if name == layout.MANIFEST:
            document = json.loads(changed)
            found = check(resigned(whole, manifest=document if isinstance(document, dict) else {}))
        else:
            found = check(resigned(whole, contents={name: changed}))
        assert isinstance(found.problems, list)  # and nothing was raised
