"""What changed from run to run, over stored histories."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from dated_runs import gave, lay, ran
from studies.blind.physics import Cause, Noise, measure

from calrig.analysis.diagnoses import Diagnoses
from calrig.analysis.errors import Unknown
from calrig.analysis.histories import charts, histories, unit_changes
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.plan import Plan
from calrig.store import Store

RECLAMPED = 0.03


def several(store: Store, units: int = 6, runs: int = 3, seed: int = 0) -> None:
    """Units that repeat with 0.03°, each run on a day of its own."""
    noise = np.random.default_rng(seed).normal(size=(units, runs, 2)) * (RECLAMPED, 3e-4)
    places = [(k, n) for k in range(units) for n in range(runs)]
    results = [gave(0.5 + k + noise[k, n, 0], 1 + noise[k, n, 1]) for k, n in places]
    days = [30 * n + k for k, n in places]
    lay(store, *((f"U{k}", day, one, {}) for (k, _), day, one in zip(places, days, results, strict=True)))


def test_a_scale_that_moved_is_told_beside_what_clamping_anew_does(store: Store) -> None:
    several(store)
    ran(store, "MOVED", 10, 0.8, 1.000)
    ran(store, "MOVED", 40, 0.8, 1.012)
    (change,) = unit_changes(store, "MOVED")
    assert (change["verdict"], change["days"], change["effects"]) == ("changed", 30.0, None)
    assert change["scale"] == pytest.approx(0.012)
    assert change["scale_sigma"] == pytest.approx(change["scale"] / change["scale_std"])
    assert change["scale_sigma"] > 10 > 3 > abs(change["bias_sigma"])
    assert change["p_value"] < 1e-4
    assert change["says"].startswith("Scale moved by 0.0120 ± 0.000")
    assert {one["verdict"] for k in range(6) for one in unit_changes(store, f"U{k}")} == {"unchanged"}


def test_a_single_unit_with_two_runs_is_not_held_against_its_noise_alone(store: Store) -> None:
    ran(store, "ONE", 0, 0.8)
    ran(store, "ONE", 1, 0.9)
    (change,) = unit_changes(store, "ONE")
    assert (change["verdict"], change["p_value"], change["bias_sigma"]) == ("not_known", None, None)
    assert change["bias_deg"] == pytest.approx(0.1)
    assert "not known yet" in change["says"]


def test_what_does_not_count_is_in_no_difference(store: Store) -> None:
    several(store)
    before = unit_changes(store, "U0")
    voided = ran(store, "U0", 100, 9.0)
    store.amendments.void(voided.id, "wrong unit")
    ran(store, "U0", 101, 9.0, kind="verification")
    ran(store, "U0", 102, 9.0, follows=before[-1]["to"])
    assert unit_changes(store, "U0") == before


def test_the_stages_part_counts_where_the_rig_is_another_one(store: Store) -> None:
    several(store)
    ran(store, "WENT", 10, 0.8, rig="bench-1", stage_std_deg=0.2)
    ran(store, "WENT", 20, 1.2, rig="bench-2", stage_std_deg=0.2)
    ran(store, "WENT", 30, 1.2, rig="bench-2", stage_std_deg=0.2)
    moved, stayed = unit_changes(store, "WENT")
    assert moved["bias_std_deg"] > math.hypot(0.2, 0.2) > 0.2 > stayed["bias_std_deg"]
    assert moved["verdict"] == "unchanged"


def test_what_the_stored_diagnosis_of_both_runs_found_is_said(store: Store) -> None:
    several(store)
    first = ran(store, "HIT", 10, 0.8)
    second = ran(store, "HIT", 20, 1.8)
    effect = {
        "name": "accelerometer_offset",
        "verdict": "named",
        "confusable_with": [],
        "changed": {"from": first.id, "to": second.id},
        "parameters": {"y_mg": {"value": 0.1, "std": 0.1}, "z_mg": {"value": 6.02, "std": 0.1}},
    }
    constant = {**effect, "changed": None}
    store.runs.update(second.id, diagnosis={"runs": [first.id, second.id], "effects": [effect, constant]})
    (change,) = unit_changes(store, "HIT")
    assert change["effects"] == [effect]
    assert change["says"] == "z offset moved by 6.0 ± 0.1 mg."
    store.runs.update(second.id, diagnosis={"runs": [second.id], "effects": [constant]})
    assert unit_changes(store, "HIT")[0]["effects"] is None


def test_effects_that_changed_are_called_by_whose_error_they_are(store: Store) -> None:
    several(store)
    first, second = ran(store, "HIT", 10, 0.8), ran(store, "HIT", 20, 1.8)
    effect = {
        "name": "stage_periodic",
        "verdict": "ambiguous",
        "confusable_with": ["stage_eccentricity"],
        "changed": {"from": first.id, "to": second.id},
        "parameters": {},
    }
    for reference, whose in (("stage", "stage"), ("good", "sensor")):
        found = {"runs": [first.id, second.id], "reference": reference, "effects": [effect]}
        store.runs.update(second.id, diagnosis=found)
        (change,) = unit_changes(store, "HIT")
        assert change["says"] == f"Periodic error of the {whose} changed (or: eccentricity of the {whose})."


def test_an_offset_that_moved_between_two_runs_is_named_with_its_size(store: Store) -> None:
    """Two runs of the simulator's physics, before and after 6 mg came onto z, among units that repeat."""
    several(store)
    wrong = Cause("imu", "unknown", "unknown", {"imu": {"accel_bias_mg": [0.0, 0.0, 6.0]}})
    plan = Plan(start_deg=-60.0, stop_deg=60.0, step_deg=7.5, sweeps=2, jitter_deg=2.0)
    runs = []
    for seed, causes in enumerate(([], [wrong])):
        poses = measure(plan, causes, Noise(), np.random.default_rng([seed, 12])).poses
        runs.append((poses, ran(store, "HIT", 10.0 + 20 * seed, poses=poses)))
    (before, first), (after, second) = runs
    (untold,) = unit_changes(store, "HIT")
    assert (untold["verdict"], untold["effects"]) == ("changed", None)
    assert untold["says"].startswith("Scale moved by −0.005")
    ids = [first.id, second.id]
    found = document(diagnose([before, after], ids, bootstraps=199, cross_fit=False), ids)
    Diagnoses(store).keep(second.id, found)
    (told,) = unit_changes(store, "HIT")
    assert [effect["name"] for effect in told["effects"]] == ["accelerometer_offset"]
    assert re.fullmatch(r"z offset moved by [56]\.\d+ ± 0\.\d+ mg\.", told["says"]), told["says"]


def test_a_unit_that_is_not_known_is_said_to_be_so(store: Store) -> None:
    with pytest.raises(Unknown, match="no unit 'nope'"):
        unit_changes(store, "nope")
    assert histories(store).rows == []


def test_the_chart_of_a_unit_begins_anew_where_it_changed(store: Store) -> None:
    several(store)
    for day, bias in enumerate([0.5, 0.5, 0.5, 2.5, 2.5, 2.5]):
        ran(store, "STEP", 10 * day, bias)
    (bias, _) = charts(histories(store), "STEP")
    assert bias is not None
    assert not bias.signals.any()
    assert np.isinf(bias.limit).tolist() == [True, True, True, True, False, False]
    assert [one["verdict"] for one in unit_changes(store, "STEP")].count("changed") == 1
