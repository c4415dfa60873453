"""A run was killed while its stage, which has no homing, moved: who resumes it says where that stands."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support import QUICK, running_service, serving, wait_for

from calrig.plan import Plan
from calrig.settings import RigSettings

pytestmark = pytest.mark.browser


@pytest.fixture
def stepper(launch_rig: Any) -> RigSettings:
    """A rig whose stage has no homing, switched on at its zero."""
    stage = {"driver": "grbl", "homing": False}
    settings: RigSettings = launch_rig("stepper-killed", stage=stage, mechanics={"power_up_deg": 0.0})
    return settings


@pytest.fixture
def killed(stepper: RigSettings, store_path: Path) -> tuple[str, float]:
    """A run that was killed in a move, and the elevation at which its stage stands since."""
    with running_service(store_path, stepper) as service:
        run = service.start(unit="AS-1", plan=Plan.model_validate({**QUICK, "sweeps": 4}))
        wait_for(lambda: len(service.store.poses.of(run.id)) >= 2, "two poses")
        service.close()
        stands_deg = service.store.positions.of(stepper.name).stage_deg
        service.store.positions.save(stepper.name, None)  # which no program does that is killed
    return run.id, stands_deg


@pytest.fixture
def client(killed: tuple[str, float], stepper: RigSettings, store_path: Path) -> Iterator[Any]:
    with running_service(store_path, stepper) as service, serving(service) as client:
        yield client


def test_who_resumes_a_run_says_where_a_stage_without_homing_stands(
    page: Any, client: Any, killed: tuple[str, float], expect: Any, forgiven: list[str]
) -> None:
    forgiven.append("422")
    run_id, stands_deg = killed
    field, resume = page.get_by_label("The stage stands at, °"), page.locator("#resume-interrupted")
    page.goto(f"{client.base_url}/#/runs/{run_id}")
    expect(page.locator("#stage-at-why")).to_contain_text("no homing")
    with page.expect_response(f"**/api/runs/{run_id}/poses"):  # the page reads the run again, and draws it
        resume.click()
    expect(page.locator("#view")).to_contain_text('"The stage stands at" where the page resumes the run')
    for wrong, why in (("4000", "at most 360"), (f"{stands_deg + 50:.1f}", "gravity says")):
        field.fill(wrong)
        resume.click()
        expect(page.locator("#view")).to_contain_text(why)
        expect(page.locator("#status")).to_have_text("interrupted")
    field.fill(f"{stands_deg:.2f}")
    with page.expect_response(f"**/api/runs/{run_id}/poses"):
        page.evaluate("dispatchEvent(new Event('calrig:done'))")  # the page reads the run again, and draws it
    resume.click()
    expect(page.locator("#status")).to_have_text("completed")
    expect(field).to_have_count(0)


def test_what_is_refused_stays_said_while_the_page_reads_the_run_after_an_attempt_before(
    page: Any, client: Any, killed: tuple[str, float], expect: Any, forgiven: list[str]
) -> None:
    forgiven.append("422")
    run_id, _ = killed
    page.goto(f"{client.base_url}/#/runs/{run_id}")
    expect(page.locator("#stage-at-why")).to_contain_text("no homing")
    readings: list[Any] = []
    page.route(f"**/api/runs/{run_id}", lambda reading: readings.append(reading))  # noqa: PLW0108 (Playwright marks it)
    page.locator("#resume-interrupted").click()
    wait_for(lambda: page.evaluate("1") and readings, "reading of the run")
    page.get_by_label("The stage stands at, °").fill("4000")
    page.locator("#resume-interrupted").click()
    expect(page.locator("#view")).to_contain_text("at most 360")
    with page.expect_response(f"**/api/runs/{run_id}/poses"):
        for reading in readings:
            reading.continue_()
    expect(page.locator("#view")).to_contain_text("at most 360")
