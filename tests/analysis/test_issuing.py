"""Issued calibrations: numbered and frozen, released by whom the rig says, never replaced in silence."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from contextlib import closing
from typing import Any

import pytest
from postgresql_server import ENGINE

from calrig.analysis.amendments import Records
from calrig.analysis.diagnoses import Acceptance
from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.revisions import BROUGHT_OVER, Issuer, Releases
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.canonical_json import canonical
from calrig.model.verdict import Verdict
from calrig.run_ids import short_name
from calrig.store import Run, Store, StoreDamagedError
from calrig.store.errors import Refused

POSES = "\n".join(
    f"{x},{0.8 + 1.001 * x + 0.01 * (-1) ** k},{20 + k}" for k, x in enumerate(range(-60, 61, 10))
)
CSV = f"target_deg,reading_deg,temperature_c\n{POSES}\n".encode()
WARMTH = {
    "name": "temperature_bias",
    "verdict": "named",
    "origin": "sensor",
    "parameters": {"deg_per_c": {"value": 0.02, "std": 0.001}, "reference_c": {"value": 20.0, "std": None}},
    "confusable_with": [],
    "remedy": "subtract it",
}

OF_A_FILE = pytest.mark.skipif(ENGINE != "sqlite", reason="looks into the file")


class Lab:
    """A store with who puts drafts in force in it, and short words for what people do there."""

    def __init__(self, store: Store, policy: Any = "auto") -> None:
        self.store = store
        self.issuer = Issuer(store, Releases({"bench": policy}, policy))
        self.records = Records(store, self.issuer)

    def imports(self, unit: str = "A", content: bytes = CSV) -> Run:
        return self.records.import_poses(unit=unit, rig="bench", file_name="p.csv", content=content)

    def accepts(self, run: Run, effect: dict[str, Any] = WARMTH) -> None:
        self.store.runs.update(run.id, diagnosis={"effects": [effect]})
        Acceptance(self.store, self.issuer).accept(run.id, [effect["name"]])

    def told(self, unit: str = "A") -> list[tuple[int, str]]:
        return [(one.revision, one.status) for one in self.store.revisions.of(unit)]

    def stale(self, unit: str = "A") -> list[list[str]]:
        return [one["stale"] for one in self.issuer.listed(self.store.revisions.of(unit))]


@pytest.fixture
def lab(store: Store) -> Lab:
    return Lab(store)


@pytest.fixture
def strict(store: Store) -> Lab:
    return Lab(store, "manual")


def test_a_revision_is_numbered_hashed_and_never_changes(lab):
    run = lab.imports()
    first = lab.store.revisions.in_force("A")
    document = first.document
    assert (document["revision"], document["run_id"], document["unit"]) == (1, run.id, "A")
    without = {key: value for key, value in document.items() if key != "sha256"}
    text = json.dumps(without, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    assert document["sha256"] == first.sha256 == hashlib.sha256(text.encode()).hexdigest()
    lab.accepts(run)
    lab.records.exclude_pose(run.id, 3, "knocked")
    assert lab.store.revisions.get("A", 1).text == first.text
    assert lab.told() == [(3, "in_force"), (2, "superseded"), (1, "superseded")]


def test_effects_accepted_later_make_another_revision_with_its_own_number(lab):
    run = lab.imports()
    lab.accepts(run)
    second = lab.store.revisions.in_force("A")
    assert (second.revision, [e["name"] for e in second.document["effects"]]) == (2, ["temperature_bias"])
    assert second.reason == f"accepted from run {short_name(run.id)}: bias that follows temperature"
    assert second.document["bias_deg"] != lab.store.revisions.get("A", 1).document["bias_deg"]
    assert all("formula" in effect for effect in second.document["effects"])


def test_what_cannot_be_accepted_of_several_of_one_name_is_said(lab):
    run = lab.imports()
    doubtful = {**WARMTH, "verdict": "ambiguous", "corrects": None, "confusable_with": ["time_drift"]}
    lab.store.runs.update(run.id, diagnosis={"effects": [WARMTH, doubtful]})
    Acceptance(lab.store, lab.issuer).accept(run.id, [WARMTH["name"]])
    revision = lab.store.revisions.in_force("A")
    assert len(revision.document["effects"]) == 1
    assert "; left out: temperature_bias is ambiguous, not named" in revision.reason


def test_what_is_not_a_calibration_of_its_own_replaces_nothing(lab):
    run = lab.imports()
    for plan, follows in (({"kind": "verification"}, None), ({"kind": "static"}, None), (None, run.id)):
        other = lab.store.runs.create(
            unit="A", rig="bench", plan=plan, follows=follows, status="running", provenance={}
        )
        for k, x in enumerate((-10.0, 0.0, 10.0)):
            lab.store.poses.add(other.id, k, Pose(x, x + 0.1), [], [])
        result = build_result([Pose(x, x + 0.1) for x in (-10.0, 0.0, 10.0)]).to_dict()
        lab.store.runs.update(other.id, status="completed", result=result)
        with pytest.raises(Conflict, match=rf"run {other.id} is a .*: it gives no calibration"):
            lab.issuer.draft("A", other.id)
        assert lab.issuer.redraft(lab.store.runs.get(other.id), by=None, reason="looked at") is None
    assert lab.told() == [(1, "in_force")]


def test_a_strict_labs_draft_waits_for_a_person_and_says_so_with_name_and_reason(strict):
    run = strict.imports()
    assert strict.told() == [(1, "draft")]
    strict.issuer.release("A", 1, by="ada", reason="reviewed")
    strict.accepts(run)
    assert strict.told() == [(2, "draft"), (1, "in_force")]
    assert strict.stale() == [[], ["Accepted since: temperature_bias."]]
    strict.issuer.release("A", 2, by="ben", reason="effects confirmed")
    assert strict.told() == [(2, "in_force"), (1, "superseded")]
    acts = [(e.what, e.who, e.revision, e.reason) for e in strict.store.trail.entries(unit="A")]
    assert ("released", "ada", 1, "reviewed") in acts
    assert ("released", "ben", 2, "effects confirmed") in acts


def test_there_is_a_way_back_to_a_superseded_revision_and_none_from_a_withdrawn_one(lab):
    lab.accepts(lab.imports())
    lab.issuer.release("A", 1, by="ada", reason="flight software has no temperature")
    assert lab.told() == [(2, "superseded"), (1, "in_force")]
    lab.issuer.withdraw("A", 1, by="ada", reason="wrong after all")
    assert (lab.told(), lab.store.revisions.in_force("A")) == ([(2, "superseded"), (1, "withdrawn")], None)
    with pytest.raises(Refused, match="revision 1 of unit 'A' is withdrawn"):
        lab.issuer.release("A", 1, by="ada", reason="again")
    with pytest.raises(Invalid, match="a reason is needed"):
        lab.issuer.withdraw("A", 2, by="ada", reason=" ")


def test_by_its_limits_alone_nothing_is_released_where_there_are_none(store):
    lab = Lab(store, "pass")
    lab.imports()
    assert lab.told() == [(1, "draft")]


@pytest.mark.parametrize(
    ("policy", "answer", "reliable", "released"),
    [
        ("auto", "no_limits", True, True),
        ("auto", "no_limits", False, False),
        ("auto", "conditional_fail", True, True),
        ("auto", "undecided", True, True),
        ("auto", "undecided", False, False),
        ("auto", "fail", True, False),
        ("pass", "pass", True, True),
        ("pass", "conditional_pass", True, False),
        ("pass", "undecided", True, False),
        ("manual", "pass", True, False),
    ],
)
def test_who_puts_a_draft_in_force(policy, answer, reliable, released):
    judged = Verdict(answer, "noise", 1.0, (), None, reliable=reliable)
    assert Releases({"bench": policy}).puts_in_force("bench", judged) is released


def test_a_person_chooses_which_accepted_effects_enter(lab):
    run = lab.imports()
    lab.accepts(run)
    bare = lab.issuer.draft("A", run.id, [], by="ada", reason="for an older autopilot")
    assert bare.document["effects"] == []
    assert bare.document["bias_deg"] == lab.store.revisions.get("A", 1).document["bias_deg"]
    assert lab.stale()[0] == [], "left out on purpose"
    with pytest.raises(Conflict, match=r"'backlash' .*; accepted: temperature_bias"):
        lab.issuer.draft("A", run.id, ["backlash"])


def test_a_draft_with_fewer_effects_leaves_the_verdict_of_the_run_as_it_is(lab):
    warm = (
        f"{x},{0.8 + 1.001 * x + 0.02 * (7 * k % 13)},{20 + 7 * k % 13},0.03"
        for k, x in enumerate(range(-60, 61, 10))
    )
    columns = "target_deg,reading_deg,temperature_c,reference_std_deg"
    run = lab.imports(content="\n".join([columns, *warm]).encode())
    lab.accepts(run)
    before = lab.store.runs.get(run.id).result.doubts
    bare = lab.issuer.draft("A", run.id, [], by="ada", reason="for an older autopilot")
    assert (bare.status, bare.verdict["reliable"]) == ("draft", False)
    assert any("does not correct" in says for says in bare.verdict["says"]), bare.verdict["says"]
    assert lab.store.runs.get(run.id).result.doubts == before == []


def test_a_voided_run_gives_way_to_the_latest_that_counts_and_else_stays_in_force_stale(lab):
    first, second = lab.imports(), lab.imports(content=CSV.replace(b",20\n", b",21\n"))
    lab.records.void(second.id, "wrong clamp")
    in_force = lab.store.revisions.in_force("A")
    assert (in_force.run_id, in_force.reason) == (
        first.id,
        f"run {short_name(second.id)} was voided: wrong clamp",
    )
    lab.records.void(first.id, "wrong stage")
    assert lab.store.revisions.in_force("A").revision == in_force.revision, "there is nothing to replace it"
    assert lab.stale()[0] == [f"Run {short_name(first.id)} has been voided: wrong stage"]


def test_a_stage_effect_accepted_for_another_unit_changes_no_document_and_is_told(lab):
    worn = {**WARMTH, "name": "stage_eccentricity", "origin": "stage"}
    worn["parameters"] = {
        "amplitude_deg": {"value": 0.1, "std": 0.01},
        "phase_deg": {"value": 10.0, "std": 1.0},
    }
    lab.imports("A")
    other = lab.imports("B")
    before = lab.store.revisions.in_force("A").text
    lab.accepts(other, worn)
    assert lab.store.revisions.in_force("A").text == before
    assert lab.stale("A") == [["Accepted since: stage_eccentricity (rig bench)."]]
    assert lab.told("B") == [(2, "in_force"), (1, "superseded")]
    assert lab.store.revisions.in_force("B").document["effects"] == [], "a stage's error is never flown"


@OF_A_FILE
def test_what_an_older_store_had_in_force_becomes_revision_1_once(lab, database):
    lab.accepts(lab.imports("A"))
    lab.imports("B", b"target_deg,reading_deg\n0,0.1\n0,0.2\n")
    expected = lab.store.revisions.in_force("A").document
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("DELETE FROM issued_calibration")
    assert [one.revision for one in lab.issuer.bring_over()] == [1]
    assert lab.issuer.bring_over() == []
    brought = lab.store.revisions.in_force("A")
    assert (lab.told(), brought.reason, lab.told("B")) == ([(1, "in_force")], BROUGHT_OVER, [])
    changed = {"revision", "issued_at", "sha256"}
    assert {k: v for k, v in brought.document.items() if k not in changed} == {
        k: v for k, v in expected.items() if k not in changed
    }


@OF_A_FILE
def test_a_document_that_was_tampered_with_is_not_handed_out(lab, database):
    lab.imports()
    document = lab.store.revisions.in_force("A").document
    changed = canonical({**document, "bias_deg": 0.0})
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE issued_calibration SET document = ?", [changed])
    with pytest.raises(StoreDamagedError, match="revision 1 of unit 'A' is not what was issued"):
        lab.store.revisions.in_force("A")


@OF_A_FILE
def test_the_store_itself_refuses_two_in_force(lab, database):
    lab.accepts(lab.imports())
    with closing(sqlite3.connect(database)) as connection, pytest.raises(sqlite3.IntegrityError):
        connection.execute("UPDATE issued_calibration SET status = 'in_force'")


def test_a_unit_that_never_was_is_removed_once_its_run_is_moved_and_its_revision_withdrawn(lab):
    run = lab.imports("AS-0O42")
    lab.records.move(run.id, "AS-0042", "a letter O for a zero")
    assert lab.store.revisions.in_force("AS-0042").run_id == run.id
    assert lab.stale("AS-0O42") == [[f"Run {short_name(run.id)} belongs to unit AS-0042 now."]]
    with pytest.raises(Refused, match="revision 1 of unit 'AS-0O42' is in force"):
        lab.store.units.remove("AS-0O42")
    lab.issuer.withdraw("AS-0O42", 1, by="ada", reason="there is no such unit")
    lab.store.units.remove("AS-0O42")
    assert [unit.serial for unit in lab.store.units.all()] == ["AS-0042"]
    assert lab.store.trail.entries(unit="AS-0O42")[-1].what == "unit_removed"
