"""A diagnosis over HTTP: what was accepted of it stays visible, and several runs are taken together."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from support import imported, running_service, serving

BACKLASH_DEG = 0.3
NOISE_DEG = 0.02


def worn(client, unit, seed=0):
    """An imported run of a unit on a stage with backlash: random moves, so that backlash stands alone."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-60, 60, 48).round(2)
    approach = np.sign(np.diff(theta, prepend=-90.0))
    reading = 0.8 + theta + BACKLASH_DEG / 2 * approach + rng.normal(0, NOISE_DEG, 48)
    rows = (f"{x},{y:.4f},{a:.0f}" for x, y, a in zip(theta, reading, approach, strict=True))
    run = imported(client, unit, "\n".join(["target_deg,reading_deg,approach", *rows]), rig="bench-1")
    return f"/api/runs/{run['id']}"


def diagnose(client, url, **body):
    return client.post(f"{url}/diagnosis", json=body).raise_for_status().json()


@pytest.fixture(scope="module")
def bench(rig, tmp_path_factory):
    """A service and a client of it."""
    path = tmp_path_factory.mktemp("bench") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        yield service, client


@pytest.fixture(scope="module")
def found(bench):
    """What tracing the worn unit's poses gives, done once: the same poses always give the same."""
    _, client = bench
    document = diagnose(client, worn(client, "AS-1"))
    (effect,) = document["effects"]
    assert (effect["name"], effect["accepted_at"]) == ("backlash", None)
    return document


@pytest.fixture
def traced(bench, found, request):
    """The address of a run of a unit of its own with that diagnosis."""
    service, client = bench
    url = worn(client, request.node.name[:90])
    run_id = url.rsplit("/", 1)[1]
    service.store.runs.update(run_id, diagnosis={**found, "runs": [run_id]})
    return url


def accept(client, url, *names):
    return client.post(f"{url}/diagnosis/accept", json={"effects": names})


def test_since_when_an_effect_is_in_force_stands_in_the_diagnosis_and_in_the_run(bench, traced):
    _, client = bench
    in_answer = accept(client, traced, "backlash").raise_for_status().json()["diagnosis"]
    last = client.get(f"{traced}/diagnosis").json()
    assert in_answer == client.get(traced).json()["diagnosis"] == last
    (effect,) = last["effects"]
    assert effect["accepted_at"].endswith("Z")
    accepted_at = datetime.fromisoformat(effect["accepted_at"])
    assert datetime.fromisoformat(client.get(traced).json()["created_at"]) < accepted_at <= datetime.now(UTC)


def test_a_refused_acceptance_marks_nothing(bench, traced):
    _, client = bench
    assert accept(client, traced, "backlash", "time_drift").status_code == 409
    (effect,) = client.get(f"{traced}/diagnosis").json()["effects"]
    assert effect["accepted_at"] is None


def test_traced_again_the_same_effect_is_still_accepted_and_one_with_new_values_is_not(bench, traced):
    _, client = bench
    accept(client, traced, "backlash").raise_for_status()
    (before,) = client.get(f"{traced}/diagnosis").json()["effects"]
    (again,) = diagnose(client, traced)["effects"]
    assert again["accepted_at"] == before["accepted_at"]

    unit = client.get(traced).json()["unit"]
    other = worn(client, unit, seed=1).rsplit("/", 1)[1]
    both = diagnose(client, traced, runs=[other])
    (together,) = both["effects"]
    assert both["runs"] == [traced.rsplit("/", 1)[1], other][::-1], "the run that was asked comes last"
    assert together["parameters"] != before["parameters"]
    assert together["accepted_at"] is None


def test_runs_stored_before_this_was_kept_say_null(bench, traced):
    """As calrig stored them before: a result without the stage's part, a diagnosis that nobody judged."""
    service, client = bench
    run_id = traced.rsplit("/", 1)[1]
    document = client.get(f"{traced}/diagnosis").json()
    (effect,) = document["effects"]
    del document["grade"], document["says"], effect["accepted_at"], effect["least_p_value"]
    for candidate in effect["considered"]:
        del candidate["why"]
    result = service.store.runs.get(run_id).result.to_dict()
    del result["reference"]
    service.store.runs.update(run_id, diagnosis=document, result=result)

    assert client.get(traced).json()["result"]["reference"] is None
    shown = client.get(f"{traced}/diagnosis").json()
    (effect,) = shown["effects"]
    assert (shown["grade"], shown["says"]) == ("unknown", [])
    assert (effect["accepted_at"], effect["least_p_value"]) == (None, None)
    assert {candidate["why"] for candidate in effect["considered"]} == {None}
