"""A stage without homing has lost its place: the page asks where it stands, and a run begins from there."""

from __future__ import annotations

import pytest
from support import QUICK, ended, running_service, serving

from .page_help import unfold_plan

pytestmark = pytest.mark.browser

PLAN = {**QUICK, "sweeps": 1}
ENDS_AT_DEG = PLAN["elevations_deg"][-1]


@pytest.fixture
def service(launch_rig, store_path):
    """With a stepper without a switch, switched on at its zero."""
    stage = {"driver": "grbl", "homing": False}
    rig = launch_rig("stepper", stage=stage, mechanics={"power_up_deg": 0.0})
    with running_service(store_path, rig) as service:
        yield service


@pytest.fixture
def client(service):
    """A client of the service with that rig."""
    with serving(service) as client:
        yield client


def start(page, expect, stage_at=None):
    """Starts a run on the page, and returns where its status is shown."""
    page.fill("#unit", "A")
    unfold_plan(page)
    page.get_by_label("List", exact=True).check()
    page.fill("#elevations_deg", "−40, 0; 40")
    page.fill("#sweeps", "1")
    page.fill("#settle_s", "0.5")
    if stage_at is not None:
        page.fill("#stage_at_deg", str(stage_at))
    page.click("#start")
    page.wait_for_url("**/#/runs/*")
    return page.locator("#status")


def test_the_place_is_asked_for_where_a_run_has_failed_for_want_of_it(
    page, client, service, go, expect, forgiven
):
    forgiven.append("status of 422")
    first = client.post("/api/runs", json={"unit": "A", "plan": PLAN}).raise_for_status().json()
    assert ended(client, first["id"])["status"] == "completed"
    go("#/")
    expect(page.locator("#run-more summary")).to_have_text("Operator, note, stage position")
    expect(page.locator("#stage_at_deg")).to_be_hidden()  # nobody needs it

    service.store.positions.save("stepper", None)  # as a power cut in mid-move leaves it
    expect(start(page, expect)).to_have_text("failed")
    expect(page.locator("#view")).to_contain_text("where it stands is not known")
    expect(page.locator("#view")).to_contain_text('"The stage stands at" where the page starts a run')
    go("#/")
    expect(page.locator("#stage_at_deg")).to_be_visible()
    expect(page.locator("#stage-at-why")).to_contain_text("needs the position")

    page.fill("#unit", "A")
    page.evaluate("document.querySelector('form.start').noValidate = true")
    page.fill("#stage_at_deg", "4000")
    page.click("#start")
    expect(page.locator("#start-error")).to_have_text("Where the stage stands must be at most 360")
    expect(page.locator("#stage_at_deg")).to_have_attribute("aria-invalid", "true")
    expect(start(page, expect, stage_at=ENDS_AT_DEG)).to_have_text("completed")
    go("#/")
    expect(page.locator("#stage_at_deg")).to_be_hidden()
