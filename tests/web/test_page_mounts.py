"""A run of two mounts on the page: the form, the instruction, what gravity says, Go."""

from __future__ import annotations

import pytest
from support import running_service, serving

from .page_help import unfold_plan

pytestmark = pytest.mark.browser


@pytest.fixture
def client(launch_rig, store_path):
    """A client of a service whose rig has a clamp of its own."""
    with running_service(store_path, launch_rig("headed", clamp={})) as service, serving(service) as client:
        yield client


def test_a_run_asks_for_the_unit_to_be_turned_and_goes_on_once_it_is(page, client, go, expect, forgiven):
    forgiven += ["status of 409", "status of 422"]
    go("#/?unit=AS-M&mounts=0,120")
    expect(page.locator("#unit")).to_have_value("AS-M")
    expect(page.locator("#mounts_deg")).to_have_value("0, 120")
    unfold_plan(page)
    page.fill("#mounts_deg", "0, 360")
    expect(page.locator("#plan-summary")).to_contain_text("0° and 360° are one mount")
    page.fill("#mounts_deg", "0, 120")
    page.get_by_label("List", exact=True).check()
    page.fill("#elevations_deg", "-20, 20")
    page.fill("#sweeps", "1")
    page.fill("#dwell_s", "0.5")
    expect(page.locator("#plan-summary")).to_contain_text("2 poses per mounting")
    page.click("#start")
    expect(page.locator("#waiting-for")).to_contain_text("120°")
    expect(page.locator("#mount-now")).to_contain_text("Now at 0°. Turn by a further 1")
    page.click("#go")
    expect(page.locator("#waiting-error")).to_contain_text("not 120°")
    run_id = page.url.rpartition("/")[2]
    waiting = client.get(f"/api/runs/{run_id}").json()
    assert (waiting["status"], waiting["progress"]["waiting_for"]) == (
        "paused",
        {"mount_deg": 120.0, "mount_axis": "x"},
    )
    assert (
        client.post("/api/rigs/headed/clamp", json={"mount_deg": 120, "mount_axis": "w"}).status_code == 422
    )
    page.click("#turn")
    expect(page.locator("#mount-now.right")).to_be_visible()
    page.click("#go")
    expect(page.locator("#status")).to_have_text("completed")
    expect(page.locator("#waiting-for")).to_be_hidden()
    expect(page.locator("#result")).to_contain_text("2, of the first mounting (0°)")
    told = client.get(f"/api/runs/{run_id}/poses").json()
    assert [(p["mount"], p["mount_deg"], p["mount_axis"]) for p in told[1:3]] == [
        (f"{run_id} 0°", 0.0, "x"),
        (f"{run_id} 120°", 120.0, "x"),
    ]
    lines = client.get(f"/api/runs/{run_id}/poses?format=csv").text.splitlines()
    assert lines[0].endswith(",mount,mount_axis") and "mount_deg" in lines[0]
    assert lines[-1].endswith(f",{run_id} 120°,x")
