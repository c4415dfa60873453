"""Effects accepted from several runs are one model, fitted over the poses of all runs that count."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from postgresql_server import store_at
from studies.accepting import (
    EFFECTS,
    FIRST_C,
    SECOND_C,
    TRUE_BIAS_DEG,
    UNIT,
    diagnosed_run,
    measured,
    outcome,
)

from calrig.analysis import joint_model
from calrig.analysis.amendments import Records
from calrig.analysis.calibration_in_force import active_calibration
from calrig.analysis.diagnoses import Acceptance, Diagnoses, traced
from calrig.analysis.errors import Conflict
from calrig.analysis.revisions import Issuer
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.store import AcceptedEffect, Run, Store

OFFSET, WARMTH = (name for name, _ in EFFECTS)
OFFSET_Y_MG, DEG_PER_C = 14.0, 0.012


class Lab:
    """A store, and short words for what people do there."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.issuer = Issuer(store)
        self.records = Records(store, self.issuer)
        self.acceptance = Acceptance(store, self.issuer)

    def run(self, poses: list[Pose], *names: str) -> Run:
        return diagnosed_run(self.store, poses, *names)

    def in_force(self) -> dict[str, AcceptedEffect]:
        return {one.name: one for one in self.store.effects.in_force(UNIT, "bench-1")}

    def latest(self) -> dict[str, Any]:
        return self.store.revisions.of(UNIT)[0].document


@pytest.fixture
def lab(store: Store) -> Lab:
    return Lab(store)


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs at two temperatures: the offset is accepted from the first, the temperature term from both."""
    path = tmp_path_factory.mktemp("two") / "calrig.db"
    rng = np.random.default_rng(3)
    with Store.open(store_at(path), writer="tests") as store:
        lab = Lab(store)
        first = lab.run(measured(rng, FIRST_C), OFFSET, WARMTH)
        lab.acceptance.accept(first.id, [OFFSET, WARMTH])
        second = lab.run(measured(rng, SECOND_C), OFFSET, WARMTH)
        lab.acceptance.accept(second.id, [WARMTH])
    return path


@pytest.fixture
def two(filled: Path, lab: Lab) -> tuple[Run, Run]:
    """Both runs, in a store that is the test's own."""
    second, first = lab.store.runs.page(limit=2)[0]
    return first, second


def test_the_second_runs_effects_are_fitted_with_those_in_force_and_replace_them(lab, two):
    found = lab.in_force()
    assert {tuple(one.runs) for one in found.values()} == {tuple(run.id for run in two)}
    assert found[OFFSET].parameters["y_mg"] == pytest.approx(OFFSET_Y_MG, abs=0.2)
    warmth = found[WARMTH]
    assert warmth.parameters["deg_per_c"] == pytest.approx(DEG_PER_C, abs=3 * warmth.std["deg_per_c"])
    assert warmth.parameters["reference_c"] == 26.0, "as it was accepted first"
    document = lab.latest()
    assert document["run_id"] == two[1].id
    std_deg = document["covariance"][0][0] ** 0.5
    assert document["bias_deg"] == pytest.approx(TRUE_BIAS_DEG, abs=2.5 * std_deg)
    (told,) = (e for e in lab.store.trail.entries(what=["accepted"]) if e.run_id == two[1].id)
    assert told.detail["fitted_over"] == [run.id for run in two]


def test_a_voided_runs_effects_leave_the_next_draft(lab, two):
    first, second = two
    joint = lab.in_force()
    lab.records.void(second.id, "the wrong unit")
    alone = lab.in_force()
    assert {one.run_id for one in alone.values()} == {first.id}
    assert not any(one.is_joint for one in alone.values())
    document = lab.latest()
    assert document["run_id"] == first.id
    assert [one["parameters"] for one in document["effects"]] == [one.parameters for one in alone.values()]

    lab.records.void(first.id, "another as well")
    assert lab.in_force() == lab.store.effects.names_by_unit() == {}
    for run in two:
        lab.records.unvoid(run.id, "they were right")
    again = lab.in_force()
    assert [one.parameters for one in again.values()] == [one.parameters for one in joint.values()]


def test_a_run_voided_without_effects_of_its_own_changes_no_model(lab, two):
    before = {name: one.id for name, one in lab.in_force().items()}
    third = lab.run(measured(np.random.default_rng(4), FIRST_C), OFFSET)
    lab.records.void(third.id, "a trial")
    assert {name: one.id for name, one in lab.in_force().items()} == before


def test_what_was_accepted_from_the_second_run_is_revoked_with_its_part_of_the_fit(lab, two):
    first, second = two
    lab.acceptance.take_back(second.id, [WARMTH], "not sure")
    assert {(name, one.run_id) for name, one in lab.in_force().items()} == {
        (OFFSET, first.id),
        (WARMTH, first.id),
    }


def test_what_was_found_beside_effects_in_force_is_fitted_again_once_these_are_gone(lab):
    rng = np.random.default_rng(8)
    first = lab.run(measured(rng, FIRST_C), OFFSET, WARMTH)
    lab.acceptance.accept(first.id, [OFFSET, WARMTH])
    second = lab.run(measured(rng, SECOND_C), OFFSET)
    rest = {"y_mg": {"value": 0.1, "std": 0.02}, "z_mg": {"value": -0.2, "std": 0.05}}
    effects = [{**one, "parameters": rest} for one in second.diagnosis["effects"]]
    listed = [{"name": OFFSET, "parameters": {}, "runs": [first.id]}]
    diagnosis = {**second.diagnosis, "effects": effects, "in_force": listed}
    lab.store.runs.update(second.id, diagnosis=diagnosis)
    lab.acceptance.accept(second.id, [OFFSET])
    lab.acceptance.take_back(first.id, [OFFSET, WARMTH], "not the unit's")
    (left,) = lab.in_force().values()
    assert (left.name, list(left.runs)) == (OFFSET, [second.id])
    assert left.parameters["y_mg"] == pytest.approx(OFFSET_Y_MG, abs=1.0), "not the rest that was found"


def test_a_run_that_contradicts_what_is_in_force_is_refused_and_nothing_changes(lab):
    rng = np.random.default_rng(5)
    first = lab.run(measured(rng, FIRST_C), OFFSET, WARMTH)
    lab.acceptance.accept(first.id, [OFFSET, WARMTH])
    before = lab.in_force()
    other = [
        Pose.from_row({**pose.row(), "reading_deg": pose.reading_deg + 2e-5 * pose.target_deg**2})
        for pose in measured(rng, SECOND_C)
    ]
    turned = [
        Pose.from_row({**pose.row(), "temperature_c": 77.0 - (pose.temperature_c or 0.0)}) for pose in other
    ]
    second = lab.run(turned, OFFSET, WARMTH)
    with pytest.raises(Conflict, match=r"(?s)would make run .* worse.*from .*° to .*°.*revoke"):
        lab.acceptance.accept(second.id, [OFFSET, WARMTH])
    assert lab.in_force() == before
    diagnosis = lab.store.runs.get(second.id).diagnosis
    assert all(effect.get("accepted_at") is None for effect in diagnosis["effects"])


def test_acceptances_of_older_stores_are_in_force_by_name_and_part_of_the_next_fit(lab):
    rng = np.random.default_rng(6)
    runs = [lab.run(measured(rng, ends_c), OFFSET, WARMTH) for ends_c in (FIRST_C, SECOND_C)]
    for run, (name, values) in zip(runs, [EFFECTS[1], EFFECTS[0]], strict=True):
        old = AcceptedEffect(run.id, UNIT, None, name, "sensor", {**values})
        lab.store.effects.accept(run.id, [old])
    found = lab.in_force()
    assert {name: one.run_id for name, one in found.items()} == {WARMTH: runs[0].id, OFFSET: runs[1].id}
    assert all(one.std == {} for one in found.values())
    lab.acceptance.accept(runs[1].id, [WARMTH])
    assert {tuple(one.runs) for one in lab.in_force().values()} == {tuple(run.id for run in runs)}


def test_a_later_runs_diagnosis_finds_nothing_that_is_in_force(lab):
    rng = np.random.default_rng(7)
    first = lab.run(measured(rng, FIRST_C), OFFSET, WARMTH)
    lab.acceptance.accept(first.id, [OFFSET, WARMTH])
    second = lab.run(measured(rng, SECOND_C))
    found = Diagnoses(lab.store).question(second.id)()
    assert [one["name"] for one in found["in_force"]] == [OFFSET, WARMTH]
    assert found["effects"] == []
    own = Diagnoses(lab.store).question(first.id).args[0]
    assert own == [], "what was accepted from a run is found in it again"


@pytest.mark.parametrize(
    ("seeds", "most_beyond"), [((1, 2), 0), pytest.param(range(6), 1, marks=pytest.mark.statistical)]
)
def test_accepting_from_two_runs_gives_the_bias_within_its_standard_errors(seeds, most_beyond):
    found = [outcome(seed) for seed in seeds]
    assert sum(abs(one.in_stds) > 2.0 for one in found) <= most_beyond
    assert np.mean([one.after_both_deg for one in found]) <= np.mean([one.after_one_deg for one in found])


def test_a_rigs_effect_that_is_accepted_leaves_the_model_of_the_unit_in_force(lab, two):
    _, second = two
    joint = lab.in_force()
    of_stage = {
        "name": "backlash",
        "verdict": "named",
        "origin": "stage",
        "covariate": "approach",
        "parameters": {"backlash_deg": {"value": 0.001, "std": 0.0001}},
        "changed": None,
        "confusable_with": [],
        "remedy": "",
    }
    diagnosis = lab.store.runs.get(second.id).diagnosis
    lab.store.runs.update(second.id, diagnosis={**diagnosis, "effects": [*diagnosis["effects"], of_stage]})
    lab.acceptance.accept(second.id, ["backlash"])
    found = lab.in_force()
    assert found.pop("backlash").rig == "bench-1"
    assert found == joint


def test_a_run_without_poses_is_too_short_for_a_diagnosis_beside_effects_in_force_too(lab, two):
    with pytest.raises(DiagnosisError, match="too few"):
        traced(list(lab.in_force().values()), [[]], ["none"])


def test_a_run_whose_effects_cannot_be_fitted_with_the_others_does_not_count_again(lab, two, monkeypatch):
    """Those of single diagnoses would be in force together, and an offset counted twice."""
    first, _ = two
    lab.records.void(first.id, "a trial")
    before = lab.in_force()
    monkeypatch.setattr(joint_model, "MOST_POSES", 30)
    with pytest.raises(Conflict, match=r"at most 30 poses.*revoke"):
        lab.records.unvoid(first.id, "it was right")
    assert lab.in_force() == before
    assert lab.store.runs.get(first.id).voided.reason == "a trial"


def test_effects_that_would_stay_without_a_common_fit_are_not_left_to_single_diagnoses(lab, two):
    """Of both runs three poses count any more: what stays accepted cannot be fitted over six."""
    first, second = two
    third = lab.run(measured(np.random.default_rng(9), SECOND_C), OFFSET)
    lab.acceptance.accept(third.id, [OFFSET])
    for run, index in product(two, range(3, lab.store.poses.count(second.id))):
        lab.store.amendments.exclude_pose(run.id, index, "the clamp slipped", result=run.result.to_dict())
    before = lab.in_force()
    said = rf"(?s)cannot be fitted together.*{WARMTH} of run {second.id}.*Nothing was changed.*revoke"
    with pytest.raises(Conflict, match=said):
        lab.acceptance.take_back(third.id, [OFFSET], "not sure")
    with pytest.raises(Conflict, match=said):
        lab.records.void(third.id, "another unit")
    assert lab.in_force() == before
    lab.acceptance.take_back(second.id, [WARMTH], "three poses are too few")
    lab.acceptance.take_back(third.id, [OFFSET], "not sure")
    assert {tuple(one.rests_on) for one in lab.in_force().values()} == {(first.id,)}


def test_a_first_acceptance_that_predicts_the_run_worse_is_refused_as_well(lab):
    """The temperatures are noise, and so is the term of the diagnosis, in 13 poses."""
    rng = np.random.default_rng(18)
    steady = [
        Pose.from_row({**pose.row(), "temperature_c": 25.0 + 0.5 * rng.standard_normal()})
        for pose in measured(rng, (25.0, 25.0), sweeps=1)
    ]
    run = lab.run(steady, WARMTH)
    with pytest.raises(Conflict, match=rf"would make run {run.id} worse.*from .*° to .*°.*more poses"):
        lab.acceptance.accept(run.id, [WARMTH])
    assert lab.in_force() == {}


def test_the_stored_model_has_the_covariance_of_its_parameters(lab, two):
    found = lab.in_force()
    rows = {(name, key): np.array(row) for name, one in found.items() for key, row in one.factor.items()}
    for (name, key), row in rows.items():
        assert np.linalg.norm(row) == pytest.approx(found[name].std[key], rel=0.2), "one factor for all"
    assert abs(rows[OFFSET, "y_mg"] @ rows[WARMTH, "deg_per_c"]) > 0.0


def test_a_temperature_term_of_two_runs_promises_the_temperatures_of_both(lab, two):
    """The second run's own are 36 to 41 °C; a term accepted from it alone promises no more."""
    whole = active_calibration(lab.store, UNIT, "bench-1", None).promise
    assert whole is not None and whole.temperature_c is not None
    assert whole.temperature_c[0] < FIRST_C[1] and whole.temperature_c[1] > SECOND_C[0]
    lab.acceptance.take_back(two[0].id, [OFFSET, WARMTH], "only the second")
    alone = active_calibration(lab.store, UNIT, "bench-1", None).promise
    assert alone is not None and alone.temperature_c is not None
    assert alone.temperature_c[0] > FIRST_C[1]
