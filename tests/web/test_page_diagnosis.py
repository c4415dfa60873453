"""The residual traced on the page: from the button to the effect in force, or to the run that separates."""

from __future__ import annotations

import re

import numpy as np
import pytest
from support import ended, running_service, serving, wait_for

from calrig.api import jobs
from calrig.calibration.effects import CATALOGUE
from calrig.run_ids import short_name
from calrig.runs import follow_up

from .page_help import (
    BACKLASH_DEG,
    NOISE_DEG,
    ambiguous_poses,
    cancelled_by_who_comes_back,
    figures_of,
    unfold,
    unfold_effect,
)
from .page_help import imported_lines as imported
from .slow_work import LET_GO, slow_design

pytestmark = pytest.mark.browser

REFUSED = r"status of (409|422)"


@pytest.fixture(scope="module")
def rig(launch_rig):
    """A fast rig whose table follows its motor with play, which nobody has told the calibration."""
    return launch_rig(mechanics={"backlash_deg": BACKLASH_DEG})


@pytest.fixture(scope="module")
def service(rig, tmp_path_factory):
    """One service, whose process for diagnoses is started once: each test has units of its own."""
    rigs = [rig, *(rig.model_copy(update={"name": name}) for name in ("bench-2", "bench-3"))]
    with running_service(tmp_path_factory.mktemp("diagnosis") / "calrig.db", *rigs) as service:
        yield service


@pytest.fixture(scope="module")
def client(service):
    with serving(service) as client:
        yield client


def poses_with_backlash():
    """Unequal steps, each as often from above as from below: nothing else looks like backlash here."""
    rng = np.random.default_rng(2)
    theta = rng.uniform(-60, 60, 40).round(1)
    approach = np.sign(np.diff(theta, prepend=-60.0))
    reading = 0.8 + theta - BACKLASH_DEG / 2 * approach + rng.normal(0, NOISE_DEG, 40)
    poses = [f"{x},{y:.4f},{NOISE_DEG},{a:.0f}" for x, y, a in zip(theta, reading, approach, strict=True)]
    return ["target_deg,reading_deg,reading_stderr_deg,approach", *poses]


def unsettled_poses():
    """Unequal moves, of each of which two percent are still missing from the reading."""
    rng = np.random.default_rng(1)
    theta = rng.uniform(-60, 60, 24).round(2)
    reading = 0.8 + theta - 0.02 * np.diff(theta, prepend=theta[0]) + rng.normal(0, NOISE_DEG, 24)
    rows = (f"{x},{y:.4f},{4 * k}" for k, (x, y) in enumerate(zip(theta, reading, strict=True)))
    return ["target_deg,reading_deg,time_s", *rows]


def noise_alone(seed=0, more=""):
    """Bias, scale and noise over one set of elevations; `more` columns with the same value in every pose."""
    rng = np.random.default_rng(seed)
    targets = [x for _ in range(4) for x in range(-60, 61, 15)]
    name, value = more.split("=") if more else ("", "")
    rows = (f"{x},{0.8 + x + rng.normal(0, NOISE_DEG):.4f},{value}" for x in targets)
    return [line.rstrip(",") for line in (f"target_deg,reading_deg,{name}", *rows)]


def is_drawn(page, chart):
    """Whether a chart shows poses and the effect through them."""
    drawn = "c => document.querySelector(`[data-testid=${c}]`)?.data?.[1].x.length > 3"
    wait_for(lambda: page.evaluate(drawn, chart), "chart with the effect")


def test_a_run_is_traced_to_backlash_and_the_effect_put_in_force(page, client, service, go, expect):
    run = imported(client, poses_with_backlash(), "TRACED", rig="bench-3")
    go(f"#/runs/{run['id']}")
    verdict = page.get_by_test_id("verdict")
    expect(verdict).to_have_class("verdict poor")
    page.click("#diagnose")
    effect = page.locator("[data-effect=backlash]")
    expect(effect).to_contain_text("Backlash of the stage")
    expect(page.get_by_test_id("diagnosis-verdict")).to_contain_text("backlash of the stage")
    expect(verdict).to_contain_text(re.compile("backlash.*not been accepted"))

    found = client.get(f"/api/runs/{run['id']}/diagnosis").json()
    before, after = found["base"]["held_out_rms_deg"], found["final"]["held_out_rms_deg"]
    assert before > 2 * after
    expect(page.locator("#before-after")).to_contain_text("Held-out RMS")
    assert figures_of(page, "#before-after") == {
        "Held-out RMS, bias and scale only": f"{before:#.3g}°",
        "Held-out RMS, with effects": f"{after:#.3g}°",
        "In held-out blocks, bias and scale only": f"{found['base']['blocked_rms_deg']:#.3g}°",
        "In held-out blocks, with effects": f"{found['final']['blocked_rms_deg']:#.3g}°",
        "Noise floor": f"{found['noise']['floor_deg']:#.3g}°",
    }
    (size,) = (e["parameters"]["backlash_deg"] for e in found["effects"] if e["name"] == "backlash")
    decimals = 1 - int(f"{size['std']:e}".split("e")[1])
    stated = f"{size['value']:.{decimals}f} ± {size['std']:.{decimals}f}°"
    expect(effect).to_contain_text(stated.replace("-", "−"))
    unfold_effect(page, "backlash")
    is_drawn(page, "effect-0")
    unfold(page, "diagnosis")
    expect(page.get_by_test_id("before-after").locator(".plot-container")).to_be_visible()

    page.click("#accept-backlash")
    page.get_by_test_id("confirm").click()
    expect(effect).to_contain_text("Stored as an error of rig bench-3; not exported with the unit.")
    expect(verdict).to_have_class("verdict good")
    assert [e.name for e in service.store.effects.in_force("TRACED", "bench-3")] == ["backlash"]
    shown = effect.locator(".accepted")
    (kept,) = client.get(f"/api/runs/{run['id']}").json()["diagnosis"]["effects"]
    expect(shown.locator("time")).to_have_attribute("datetime", kept["accepted_at"])
    page.reload()
    expect(shown).to_contain_text("Stored as an error of rig bench-3")  # kept with the run
    expect(shown.locator("time")).to_have_attribute("datetime", kept["accepted_at"])
    expect(page.locator("#accept-backlash")).to_have_count(0)

    plan = {"kind": "verification", "elevations_deg": [-40, 0, 40], "sweeps": 2}
    body = {"unit": "TRACED", "rig": "bench-3", "plan": plan}
    verified = ended(client, client.post("/api/runs", json=body).raise_for_status().json()["id"])
    go(f"#/runs/{verified['id']}")
    expect(verdict.locator(".headline")).to_have_text(verified["verdict"]["says"][0])
    expect(verdict).to_contain_text("RMS error")
    # By the raw reading it would be 67, without the effect 9; noise alone is beyond 2 once in 2,000 runs.
    assert verified["verdict"]["ratio"] < 4.0

    go(f"#/runs/{run['id']}")
    unfold_effect(page, "backlash")
    page.click("#take-back-backlash")
    page.fill("#reason", "the cable was loose")
    page.get_by_test_id("confirm").click()
    expect(verdict).to_contain_text(re.compile("backlash.*not been accepted"))
    expect(page.locator("#accept-backlash")).to_be_visible()
    assert service.store.effects.in_force("TRACED", "bench-3") == []
    considered = page.get_by_test_id("considered-backlash")
    considered.locator("summary").click()
    expect(considered.get_by_role("row", name="settling")).to_contain_text("worse")


def test_what_is_unfolded_stays_so_when_the_diagnosis_is_drawn_again(page, client, service, go, expect):
    run = imported(client, poses_with_backlash(), "FOLDS", rig="bench-2")
    found = client.post(f"/api/runs/{run['id']}/diagnosis", json={}).raise_for_status().json()
    (backlash,) = found["effects"]
    go(f"#/runs/{run['id']}")
    folds = page.locator("#diagnosis-found details")
    unfold_effect(page, "backlash")
    unfold(page, "diagnosis")
    for name in ("considered-backlash", "error-map-details"):
        page.get_by_test_id(name).locator("summary").click()
    page.click("#accept-backlash")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#take-back-backlash")).to_be_visible()
    assert folds.evaluate_all("folds => folds.map(({ open }) => open)") == [True] * 4
    expect(page.locator("main")).to_be_focused()  # the button that had the focus is gone
    expect(page.locator("#error-map")).to_contain_text("unit FOLDS")

    settling = as_found(next(effect for effect in CATALOGUE if effect.name == "settling"))
    service.store.runs.update(run["id"], diagnosis={**found, "effects": [settling, backlash]})
    page.evaluate("dispatchEvent(new Event('calrig:done'))")
    expect(page.locator("[data-effect=settling]")).to_be_visible()
    assert folds.evaluate_all("folds => folds.map(({ open }) => open)") == [False, False] + [True] * 4
    is_drawn(page, "effect-1")


def test_run_and_diagnosis_do_not_contradict_each_other(page, client, go, expect):
    """Dwells with a seventh of what the rig repeats to: more than noise is left, of no effect."""
    run = imported(client, noise_alone(more=f"reading_stderr_deg={NOISE_DEG / 7:.5f}"), "RESTLESS")
    go(f"#/runs/{run['id']}")
    verdict, diagnosed = page.get_by_test_id("verdict"), page.get_by_test_id("diagnosis-verdict")
    expect(verdict).to_have_class("verdict poor")
    page.click("#diagnose")
    expect(diagnosed).to_contain_text("No effect found")
    expect(diagnosed).to_contain_text("within a dwell")
    expect(diagnosed).not_to_contain_text("consistent with noise")
    expect(verdict).to_contain_text("Revisited poses")


def test_every_effect_of_the_catalogue_is_shown_in_its_own_words(page, client, service, go, expect, forgiven):
    forgiven.append(REFUSED)  # these poses show none of them, so there is no figure of any
    run = imported(client, noise_alone(), "CATALOGUE")
    client.post(f"/api/runs/{run['id']}/diagnosis", json={}).raise_for_status()
    found = client.get(f"/api/runs/{run['id']}/diagnosis").json()
    del found["grade"], found["says"]  # as an earlier version stored it
    stored = {**found, "verdict": "named", "effects": [as_found(effect) for effect in CATALOGUE]}
    service.store.runs.update(run["id"], diagnosis=stored)
    go(f"#/runs/{run['id']}")
    expect(page.get_by_test_id("diagnosis-verdict")).to_contain_text("Diagnosed by an earlier version")
    expect(page.locator(".effect")).to_have_count(len(CATALOGUE))
    for effect in CATALOGUE:
        card = page.locator(f"[data-effect={effect.name}]")
        expect(card.get_by_role("heading")).to_contain_text(effect.title)
        expect(card.locator(".formula dd")).to_have_text(effect.formula)
        expect(card.locator(".share")).to_have_text("")  # earlier versions did not compute it
        for k, parameter in enumerate(p for p in effect.parameters if not p.flag):
            unit = effect.covariate.unit if parameter.unit is None else parameter.unit
            expect(card.locator("dl > div").nth(k)).to_have_text(re.compile(shown_as(parameter.title, unit)))


def as_found(effect):
    """An effect as a diagnosis has it, each parameter 2 ± 0.1."""
    return {
        "name": effect.name,
        "verdict": "named",
        "origin": effect.origin,
        "covariate": effect.covariate.name,
        "parameters": {parameter.name: {"value": 2.0, "std": 0.1} for parameter in effect.parameters},
        "p_value": 0.001,
        "confusable_with": [],
        "evidence": [],
        "remedy": effect.remedy,
        "considered": [],
    }


def shown_as(title, unit):
    return rf"^{re.escape(title)}2.00 ± 0.10\s?{re.escape(unit)}$"


def test_further_runs_of_the_unit_are_chosen_and_diagnosed_together(page, client, go, expect):
    first, voided, shown = (imported(client, noise_alone(k), "TOGETHER") for k in range(3))
    imported(client, noise_alone(3), "ANOTHER")
    client.post(f"/api/runs/{voided['id']}/void", json={"reason": "bumped"}).raise_for_status()
    go(f"#/runs/{shown['id']}")
    picker = page.locator("#together")
    expect(picker.get_by_role("checkbox")).to_have_count(0)  # folded until somebody wants it
    picker.locator("summary").click()
    box = picker.get_by_role("checkbox")
    expect(box).to_have_count(1)
    picker.get_by_label(f"Run {short_name(first['id'])}, ").check()
    expect(picker.locator("summary")).to_have_text("Diagnose together with 1 more run")

    page.click("#diagnose")
    expect(page.locator("#diagnosis-found")).to_contain_text(
        f"runs {short_name(first['id'])}, {short_name(shown['id'])}"
    )
    assert client.get(f"/api/runs/{shown['id']}/diagnosis").json()["runs"] == [first["id"], shown["id"]]

    page.reload()
    expect(picker.locator("summary")).to_have_text("Diagnose together with 1 more run")
    picker.locator("summary").click()
    expect(box).to_be_checked()
    box.uncheck()
    page.click("#diagnose")
    expect(page.locator("#diagnosis-found")).to_contain_text(f"poses of run {short_name(shown['id'])}:")
    assert client.get(f"/api/runs/{shown['id']}/diagnosis").json()["runs"] == [shown["id"]]


def test_a_period_that_even_steps_do_not_tell_from_another_is_no_name_twice(page, client, go, expect):
    noise = np.random.default_rng(3).normal(0, NOISE_DEG, 72)
    wave_deg = [0.2 * np.sin(2.0 * np.pi * x / 21.0) for x in range(-180, 180, 5)]
    poses = [
        f"{x},{x + wave + e:.4f}" for x, wave, e in zip(range(-180, 180, 5), wave_deg, noise, strict=True)
    ]
    run = imported(client, ["target_deg,reading_deg", *poses], "ALIAS")
    client.post(f"/api/runs/{run['id']}/diagnosis", json={}).raise_for_status()
    go(f"#/runs/{run['id']}")
    suspects = page.locator("[data-effect=stage_periodic] .suspects")
    expect(suspects).to_have_text("May be periodic error of the stage or the same at another period.")


def test_what_is_ambiguous_leads_to_the_run_that_separates_it(page, client, go, expect, monkeypatch):
    run = imported(client, ambiguous_poses(), "AMBIGUOUS", rig="bench-1")
    go(f"#/runs/{run['id']}")
    page.click("#diagnose")
    expect(page.get_by_test_id("diagnosis-verdict")).to_contain_text("Indistinguishable")
    found = client.get(f"/api/runs/{run['id']}/diagnosis").json()
    planned = found["follow_up"]
    line = page.locator("[data-effect=backlash]")
    expect(line.locator(".suspects")).to_have_text("May be backlash of the stage or incomplete settling.")
    expect(line.locator("summary").first).to_contain_text("not decided")
    box = line.locator(".follow-up")
    least, most = (f"{end(planned['plan']['elevations_deg']):.1f}°".replace("-", "−") for end in (min, max))
    expect(box).to_contain_text(f"It moves the stage from {least} to {most}")
    for name in planned["separates"]:
        expect(box).to_contain_text(name)
    expect(box).to_contain_text(f"{len(planned['plan']['elevations_deg'])} poses")
    expect(box).to_contain_text(f"{planned['separation_sigma']:.0f} standard deviations")
    expect(page.get_by_role("button", name="Accept")).to_have_count(0)

    LET_GO.unlink(missing_ok=True)
    with monkeypatch.context() as slow:
        slow.setattr(jobs, "AT_ONCE_S", 0.0)
        slow.setattr(follow_up, "designed", slow_design)
        page.click("#follow-up")
        cancelled_by_who_comes_back(page, expect, "follow-up")
    assert len(client.get("/api/runs?unit=AMBIGUOUS").json()["items"]) == 1

    page.click("#follow-up")
    page.wait_for_url(lambda url: not url.endswith(f"/runs/{run['id']}"))
    expect(page.locator("#follows")).to_have_text(
        f"follow-up of run {short_name(run['id'])}: backlash of the stage or incomplete settling?"
    )
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("[data-effect=backlash]")).to_contain_text("named")
    page.locator("#together summary").click()
    expect(page.get_by_label(f"Run {short_name(run['id'])}, ")).to_be_checked()
    expect(page.get_by_label(f"Run {short_name(run['id'])}, ")).to_be_disabled()  # it follows on that one
    (second, _) = client.get("/api/runs?unit=AMBIGUOUS").json()["items"]
    confirmed = second["diagnosis"]["confirmed_by"]
    assert confirmed["before_rms_deg"] > 2 * confirmed["after_rms_deg"]
    for key in ("before_rms_deg", "after_rms_deg"):
        expect(page.get_by_test_id("diagnosis-verdict")).to_contain_text(f"{confirmed[key]:#.3g}°")
    figures = figures_of(page, "#before-after")
    for when in ("before", "after"):
        assert figures[f"Confirmation, {when}"] == f"{confirmed[f'{when}_rms_deg']:#.3g}°"
    unfold_effect(page, "backlash")
    is_drawn(page, "effect-0")

    page.locator("#follows a").click()
    answered = page.locator("#followed-by")
    told = re.compile(rf"Run {short_name(second['id'])}: .*backlash of the stage \(named\)")
    expect(answered).to_contain_text(told)
    expect(page.locator("#follow-up")).to_have_count(0)


def test_without_a_rig_the_reason_why_nothing_can_be_separated_is_shown(page, client, go, expect, forgiven):
    forgiven.append(REFUSED)
    run = imported(client, ambiguous_poses(), "NO-RIG")
    go(f"#/runs/{run['id']}")
    page.click("#diagnose")
    page.click("#follow-up")
    expect(page.locator("#follow-up-error")).to_contain_text("no rig is known")
    assert len(client.get("/api/runs?unit=NO-RIG").json()["items"]) == 1


def test_an_error_of_a_stage_whose_rig_is_not_known_is_not_offered_for_acceptance(page, client, go, expect):
    run = imported(client, poses_with_backlash(), "STRAY")
    go(f"#/runs/{run['id']}")
    page.click("#diagnose")
    unfold_effect(page, "backlash")
    expect(page.locator("[data-effect=backlash]")).to_contain_text("import the poses on a rig")
    expect(page.locator("#accept-backlash, #accept-all")).to_have_count(0)
    expect(page.locator("main")).not_to_contain_text("rig null")


def test_an_effect_that_cannot_correct_later_runs_is_refused_saying_why(page, client, go, expect, forgiven):
    forgiven.append(REFUSED)
    run = imported(client, unsettled_poses(), "UNSETTLED")
    go(f"#/runs/{run['id']}")
    page.click("#diagnose")
    unfold_effect(page, "settling")
    page.click("#accept-settling")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#ask-error")).to_contain_text("cannot correct later runs")


def test_a_lone_run_of_too_few_poses_is_refused_with_the_reason_and_the_page_goes_on(
    page, client, go, expect, forgiven
):
    forgiven.append(REFUSED)
    run = imported(client, noise_alone()[:6], "SHORT")
    go(f"#/runs/{run['id']}")
    page.locator("#together summary").click()
    expect(page.locator("#together")).to_contain_text("No other completed run")
    page.click("#diagnose")
    expect(page.locator("#diagnosis-error")).to_contain_text("too few")
    expect(page.locator("#diagnose")).to_be_enabled()


def test_noise_alone_is_accused_of_nothing_and_an_error_map_says_what_it_needs(page, client, go, expect):
    run = imported(client, noise_alone(0), "U0", rig="bench-2")
    go(f"#/runs/{run['id']}")
    page.click("#diagnose")
    expect(page.get_by_test_id("diagnosis-verdict")).to_contain_text("No effect found")
    unfold(page, "diagnosis")
    summary = page.get_by_test_id("error-map-details").locator("summary")
    summary.click()
    expect(page.locator("#error-map")).to_contain_text("unit U0 clamped at 0°, ")
