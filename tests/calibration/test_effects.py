"""Every effect of the catalogue: found, rebuilt, applied, compiled, shown.

What is wrong, and the poses that come of it, are those of `effect_causes.py`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from compiled_header import COMPILER, compiled, document
from compiled_header import applied as applied_in_c
from effect_causes import CAUSES, measured
from fastapi.testclient import TestClient
from posed import posed

from calrig.api.app import api
from calrig.calibration.diagnosis.candidates import candidates_of, documented_forms, model_columns, rebuilt
from calrig.calibration.diagnosis.report import effect_documents
from calrig.calibration.diagnosis.selection import search
from calrig.calibration.diagnosis.tracing import diagnose
from calrig.calibration.effects import CATALOGUE, EFFECTS
from calrig.calibration.regression.effect import Circumstances, EffectError, NotInFlight
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.regression.run_changes import RUN
from calrig.calibration.results.correction import calibrated_elevation_deg, effects_on_reading_deg, numbers_of
from calrig.calibration.results.pose_errors import circumstances
from calrig.export.formats.c_header import c_header


def beside_a_line(theta_deg, values):
    """What bias and scale do not take up of some values."""
    return values - np.polyval(np.polyfit(theta_deg, values, 1), theta_deg)


def fitted_part_deg(candidate, r):
    """(n,) what a candidate adds to the readings of some poses, beside bias and scale."""
    beta = fit(r, model_columns(r, [candidate])).beta[-candidate.columns.shape[2] :]
    return candidate.columns[:, 0, :] @ beta


@pytest.fixture(scope="module")
def shown():
    """The catalogue as the service shows it, by name."""
    with TestClient(api()) as client:
        return {effect["name"]: effect for effect in client.get("/api/effects").json()}


SOLVED_FOR = {
    "axis_nonlinearity": {"y_mg_per_g2": 5.0, "y_mg_per_g3": -4.0, "z_mg_per_g2": 3.0, "skew_deg": 0.6}
}
"""What no diagnosis looks for, the joint solution alone (tests/studies/joint), and values to apply."""
WITHIN_A_RUN = [
    effect for effect in CATALOGUE if effect.covariate is not RUN and effect.name not in SOLVED_FOR
]
"""What differs between runs alone has its causes in test_run_changes.py."""


def test_every_effect_has_a_cause_here():
    assert set(CAUSES) == {effect.name for effect in WITHIN_A_RUN}


@pytest.mark.parametrize("effect", WITHIN_A_RUN, ids=lambda effect: effect.name)
def test_an_effect_is_found_rebuilt_applied_compiled_and_shown(effect, shown, tmp_path):
    poses, others = measured(effect.name, 1), measured(effect.name, 2)
    findings, effects = traced(effect, poses)
    place = [one["name"] for one in effects].index(effect.name)
    stated = effects[place]
    assert set(stated["confusable_with"]) <= set(CAUSES[effect.name].looks_like)
    for name, true in CAUSES[effect.name].truth.items():
        value = stated["parameters"][name]
        tolerance = 5.0 * value["std"] if value["std"] else 0.15 * abs(true)  # a scanned place has none
        assert value["value"] == pytest.approx(true, abs=max(tolerance, 0.03 * abs(true)))

    found = findings.found[place].candidate
    values = numbers_of(stated["parameters"])
    for these in (poses, others):
        r = responses_of([these])
        again = rebuilt(found, r)
        assert again is not None
        assert again.shape.form == found.shape.form
        forms = documented_forms(r, effect.name, stated["covariate"], values)
        assert effect.name in {form.name for form in forms}
        assert set().union(*(form.shape.stated for form in forms)) == set(values)
        added = effects_on_reading_deg([(effect.name, values)], r.theta_deg, circumstances(these))[1:]
        whole = fitted_part_deg(min(forms, key=lambda f: fit(r, model_columns(r, [f])).criterion), r)[1:]
        size = np.ptp(beside_a_line(r.theta_deg[1:], whole))
        left = beside_a_line(r.theta_deg[1:], added - whole)
        tolerance = 0.05 if len(effects) == 1 and these is poses else 0.35
        assert np.abs(left).max() < tolerance * size

    applied_in_flight(effect, values, tmp_path)
    entry = shown[effect.name]
    assert entry["formula"] == effect.formula
    assert set(stated["parameters"]) <= {parameter["name"] for parameter in entry["parameters"]}
    assert (entry["origin"], entry["covariate"]) == (stated["origin"], stated["covariate"])


def test_an_offset_in_mg_of_a_sensor_without_accelerometer_says_what_it_is_a_thousandth_of():
    turn_deg = np.arange(0.0, 360.0, 10.0)
    felt = np.radians(turn_deg + np.random.default_rng(2).normal(0.0, 0.1, len(turn_deg)))
    accel = {"accel_y_g": np.sin(felt), "accel_z_g": np.cos(felt)}
    for known, said in (({}, "a thousandth of their amplitude"), (accel, "calibration against gravity")):
        r = responses_of([posed(target_deg=turn_deg, reading_deg=turn_deg, **known)])
        offset = next(c for c in candidates_of(r) if c.name == "accelerometer_offset")
        assert said in " ".join(offset.effect.evidence(r, offset.shape))


@pytest.mark.parametrize("name", SOLVED_FOR)
def test_an_effect_that_is_solved_for_is_never_searched_for_and_is_applied_and_compiled(name, tmp_path):
    assert name not in {c.name for c in candidates_of(responses_of([measured("accelerometer_offset", 1)]))}
    applied_in_flight(EFFECTS[name], SOLVED_FOR[name], tmp_path)


def traced(effect, poses):
    """Findings and their documents; of a second-order term among the named effects alone.

    A strong one beside shapes without a name is taken for a smooth curve, since it is offered only once the
    first order is in the model.
    """
    r = responses_of([poses])
    offered = [c for c in candidates_of(r) if c.named or effect.follows is None]
    findings = search(r, offered, np.random.default_rng(0), bootstraps=199)
    return findings, effect_documents(findings.responses, findings)


def applied_in_flight(effect, values, folder):
    """The compiled header takes the effect out as Python does, or says that it does not."""
    calibration = document([(effect.name, values)])
    header = c_header(calibration)
    if isinstance(effect.in_c, NotInFlight):
        assert f"not of this unit at rest: {effect.name}" in header
        return
    if COMPILER is None:
        pytest.skip("no C compiler (gcc or clang) is installed")
    theta, celsius = (axis.ravel() for axis in np.meshgrid(np.linspace(-60, 60, 25), [20.0, 25.0, 30.0]))
    there = Circumstances(temperature_c=celsius)
    felt = calibration["bias_deg"] + calibration["scale"] * theta
    reading = felt + effects_on_reading_deg([(effect.name, values)], theta, there, felt)
    in_c = applied_in_c(compiled(header, folder), reading, celsius)
    bias_deg, scale = calibration["bias_deg"], calibration["scale"]
    in_python = calibrated_elevation_deg(reading, bias_deg, scale, [(effect.name, values)], there)
    np.testing.assert_allclose(in_c, in_python, atol=1e-4)


@pytest.mark.parametrize(
    "part", [f.name for f in dataclasses.fields(EFFECTS["backlash"]) if f.default is dataclasses.MISSING]
)
def test_an_effect_that_lacks_a_part_is_not_registered_and_the_part_is_named(part):
    with pytest.raises(EffectError, match=f"lacks its {part}"):
        dataclasses.replace(EFFECTS["backlash"], **{part: None})


def test_an_effect_of_one_run_with_a_term_for_flight_is_not_registered():
    with pytest.raises(EffectError, match="does not stay with the unit"):
        dataclasses.replace(EFFECTS["temperature_bias"], scope="run")


def test_a_refined_period_is_rebuilt_in_its_own_poses_and_in_others():
    poses = measured("stage_periodic", 3)
    (found,) = diagnose([poses], bootstraps=199, cross_fit=False).findings.found
    for these in (poses, measured("stage_periodic", 4)):
        again = rebuilt(found.candidate, responses_of([these]))
        assert again is not None
        assert again.shape.at == found.candidate.shape.at
