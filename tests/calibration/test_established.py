"""What is listed: effects whose size the poses show, and with which held-out poses are predicted no worse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidate_fits import refined
from calrig.calibration.diagnosis.candidates import candidate_of, candidates_of
from calrig.calibration.diagnosis.established import established
from calrig.calibration.diagnosis.held_out import CrossValidation, blocked, fit_rms_deg, without_harm
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.report import covariance_of, effect_documents, model_words
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.effects import effect_of
from calrig.calibration.regression.channels import READING
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.request import AS_USUAL, DiagnosisRequest
from calrig.calibration.regression.responses import Responses, responses_of
from calrig.calibration.regression.spline import natural_spline

RNG = np.random.default_rng(22)
THETA_DEG = RNG.uniform(-90.0, 90.0, 60)
APPROACH = np.sign(np.diff(THETA_DEG, prepend=0.0))
NOISE_DEG = RNG.normal(0.0, 0.03, 60)


def run_of(error_deg: np.ndarray, request: DiagnosisRequest = AS_USUAL) -> Responses:
    readings_deg = 0.5 + THETA_DEG + error_deg + NOISE_DEG
    poses = posed(target_deg=THETA_DEG, reading_deg=readings_deg, approach=APPROACH)
    return responses_of([poses], request=request)


def selected(r: Responses, name: str, form: str = "", period_deg: float = 0.0) -> SelectedEffect:
    """An effect as a search would have selected it."""
    if period_deg:
        effect = effect_of(name)
        candidates = [candidate_of(r, effect, shape) for shape in effect.forms(r, {"period_deg": period_deg})]
    else:
        candidates = [c for c in candidates_of(r) if c.name == name and c.beside is None]
    return SelectedEffect(next(c for c in candidates if c.shape.form == form), (), 0.001, np.inf)


def findings_of(r: Responses, found: Sequence[SelectedEffect]) -> Findings:
    model = fitted_model(r, [f.candidate for f in found])
    return Findings(r, np.arange(len(r)), tuple(found), model.fitted, model.columns, 0.001)


def test_an_effect_below_two_standard_errors_is_not_listed_and_one_above_is() -> None:
    r = run_of(0.05 * APPROACH)
    found = [selected(r, "stage_periodic", period_deg=17.0), selected(r, "backlash")]
    assert [f.candidate.name for f in established(findings_of(r, found), draws=True).found] == ["backlash"]


def test_amplitude_and_phase_are_judged_together() -> None:
    """Of a wave that is a pure sine the cosine's coefficient is noise."""
    r = run_of(0.05 * np.sin(np.radians(360.0 / 17.0 * THETA_DEG)))
    found = [selected(r, "stage_periodic", period_deg=17.0)]
    assert len(established(findings_of(r, found), draws=True).found) == 1


@pytest.mark.parametrize("size_deg", [0.08, 0.3])
def test_of_two_effects_that_make_each_other_uncertain_one_stays_and_is_ambiguous(size_deg: float) -> None:
    r = run_of(size_deg * np.sin(np.radians(360.0 / 95.0 * THETA_DEG)))
    found = [selected(r, "stage_periodic", period_deg=period) for period in (94.0, 97.0)]
    (left,) = established(findings_of(r, found), draws=True).found
    assert left.verdict == "ambiguous"
    assert {left.candidate, *left.rivals} == {f.candidate for f in found}
    assert left.doubts[-1].startswith("these poses determine either it or periodic error of the stage")


def test_an_effect_that_is_certain_only_without_another_stays_where_the_model_needs_both() -> None:
    """A period beside an eccentricity: uncertain, yet without either the rest is far from the noise."""
    theta_deg = np.random.default_rng(1).uniform(-180.0, 180.0, 200)
    error_deg = 0.6 * np.sin(np.radians(theta_deg)) + 0.3 * np.exp(-(((theta_deg - 100.0) / 60.0) ** 2))
    noise_deg = np.random.default_rng(3).normal(0.0, 0.01, 200)
    r = responses_of([posed(target_deg=theta_deg, reading_deg=theta_deg + error_deg + noise_deg)])
    eccentricity, long, short = (
        selected(r, "stage_eccentricity"),
        *(selected(r, "stage_periodic", period_deg=period) for period in (340.0, 195.0)),
    )
    (best,) = refined(r, [eccentricity.candidate, long.candidate], [short.candidate])
    found = [eccentricity, long, replace(short, candidate=best.candidate)]
    kept = established(findings_of(r, found), draws=True).found
    assert [f.candidate for f in kept] == [f.candidate for f in found]
    assert "ambiguous" in {f.verdict for f in kept}
    assert "_" not in "".join(doubt for f in kept for doubt in f.doubts)


def test_effects_that_predict_held_out_poses_worse_are_not_listed() -> None:
    r = run_of(0.05 * APPROACH)
    found = [selected(r, "backlash"), selected(r, "stage_periodic", period_deg=17.0)]
    findings = findings_of(r, found)
    harmful = CrossValidation(0.03 * np.ones(len(r)), np.ones(len(r)), 4)
    kept, held_out, (warning,) = without_harm(findings, harmful)
    assert len(kept.found) < 2
    assert held_out.is_gain or not kept.found
    assert "periodic error of the stage" in warning
    assert without_harm(findings, CrossValidation(np.ones(len(r)), np.zeros(len(r)), 4))[0] is findings


def wandering(seed: int) -> Responses:
    """Noise that is white from one pose to the next: a curve and a scale may run off together."""
    time_s = np.arange(200.0)
    theta_deg = 40.0 * np.sin(time_s / 30.0) + 0.5 * time_s
    wander_deg = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.5, 200))
    return responses_of([posed(target_deg=theta_deg, reading_deg=theta_deg + wander_deg, time_s=time_s)])


@pytest.mark.parametrize("seed", range(10))
def test_a_curve_through_noise_that_wanders_is_listed_only_if_its_own_poses_and_the_next_gain(
    seed: int,
) -> None:
    r = wandering(seed)
    curve = next(c for c in candidates_of(r) if c.kind == "unnamed time_s" and c.shape.form == "smooth 5")
    findings = findings_of(r, [SelectedEffect(curve, (), 0.001, np.inf)])
    kept, _, warnings = without_harm(findings, CrossValidation(np.ones(200), np.zeros(200), 4))
    before_deg, after_deg = fit_rms_deg(r, findings.found)
    (along_time,) = (one for one in blocked(r, [curve]) if one.along == "time")
    left_deg = findings.fitted.residuals[:, 0]
    hardly_changes = float(left_deg[1:] @ left_deg[:-1]) >= 0.95 * float(left_deg @ left_deg)
    is_nearer, is_foreseen = after_deg < before_deg, along_time.ratio < 1.0 or not hardly_changes
    assert bool(kept.found) == (is_nearer and is_foreseen)
    assert [("the fitted poses" in said, "blocks of time" in said) for said in warnings] == (
        [] if kept.found else [(not is_nearer, is_nearer)]
    )


def test_effects_that_only_the_folds_searches_miss_are_fitted_again_in_each_fold() -> None:
    r = run_of(0.05 * APPROACH)
    findings = findings_of(r, [selected(r, "backlash")])
    base_deg = fitted_model(r, ()).fitted.residuals[:, 0]
    kept, held_out, warnings = without_harm(findings, CrossValidation(base_deg, 2.0 * base_deg, 4))
    assert kept is findings
    assert (held_out.is_searched, held_out.is_gain, warnings) == (False, True, [])


def test_the_coefficients_of_a_curve_are_widened_alike_so_that_their_errors_cancel_as_before() -> None:
    r = run_of(0.05 * APPROACH)
    curve = r.columns({READING: natural_spline(r.theta_deg, 5)})
    columns = np.concatenate([r.base, curve], axis=2)
    own = slice(r.base.shape[2], columns.shape[2])
    fitted = fit(r, columns)
    ratio = covariance_of(r, columns, fitted, curves=[own])[own, own] / fitted.covariance[own, own]
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)


def test_a_curve_that_a_kink_undoes_in_part_corrects_nothing_alone() -> None:
    bent_deg = 0.05 * np.maximum(THETA_DEG - 35.0, 0.0) - 1e-6 * THETA_DEG**3
    r = run_of(bent_deg, DiagnosisRequest(reference="good"))
    curve = selected(r, "unnamed", "smooth 5")
    assert [e["corrects"] for e in effect_documents(r, findings_of(r, [curve]))] == ["unit"]
    findings = findings_of(r, [curve, selected(r, "unnamed", "kink")])
    assert model_words(findings) == "reading = bias + scale·θ + 2 f(target_deg)"
    documents = effect_documents(r, findings)
    assert [e["corrects"] for e in documents] == [None, None]
    less_line_deg = bent_deg - np.polyval(np.polyfit(THETA_DEG, bent_deg, 1), THETA_DEG)
    (said,) = {line for e in documents for line in e["evidence"] if line.startswith("together with")}
    size_deg, std_deg = map(float, said.split(": ")[1].split("°")[0].split(" ± "))
    assert size_deg == pytest.approx(np.ptp(less_line_deg), abs=3.0 * std_deg)
    assert std_deg < 0.1 * size_deg
