"""A run that was interrupted, on the page: what is told of it, and the way on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support import LONG, QUICK, running_service, serving, wait_for

from calrig.plan import Plan
from calrig.settings import RigSettings

pytestmark = pytest.mark.browser


@pytest.fixture
def interrupted(rig: RigSettings, store_path: Path) -> str:
    """A run whose service went away after two poses."""
    plan = Plan.model_validate({**QUICK, "sweeps": 4})
    with running_service(store_path, rig) as service:
        run = service.start(unit="AS-1", plan=plan)
        wait_for(lambda: len(service.store.poses.of(run.id)) >= 2, "two poses")
    return run.id


@pytest.fixture
def client(interrupted: str, rig: RigSettings, store_path: Path) -> Iterator[Any]:
    with running_service(store_path, rig) as service, serving(service) as client:
        yield client


def test_an_interrupted_run_is_resumed_on_the_page(
    page: Any, client: Any, interrupted: str, expect: Any
) -> None:
    page.goto(f"{client.base_url}/#/runs/{interrupted}")
    expect(page.locator("#status")).to_have_text("interrupted")
    page.locator("#resume-interrupted").click()
    expect(page.locator("#status")).to_have_text("completed")
    told = page.locator(".interruption")
    expect(told).to_contain_text("Interrupted after")
    expect(told).to_contain_text("resumed")
    expect(told).to_contain_text("repeated pose at")
    expect(page.locator("#result")).to_be_visible()
    expect(page.locator("#resume-interrupted")).to_have_count(0)


def test_an_interrupted_run_whose_rig_is_busy_says_so(
    page: Any, client: Any, interrupted: str, expect: Any, forgiven: list[str]
) -> None:
    forgiven.append("409")
    other = client.post("/api/runs", json={"unit": "AS-2", "plan": LONG}).raise_for_status().json()["id"]
    page.goto(f"{client.base_url}/#/runs/{interrupted}")
    page.locator("#resume-interrupted").click()
    expect(page.locator("#run-error")).to_contain_text(f"busy with run {other}")
    expect(page.locator("#status")).to_have_text("interrupted")
    page.locator("#end-interrupted").click()
    expect(page.locator("#status")).to_have_text("aborted")
