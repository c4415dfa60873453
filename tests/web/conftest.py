"""A headless Chromium, and pages that fail their test when anything is wrong on their console."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support import PATIENCE_S, running_service, serving, wait_for

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--in-process-gpu",  # what draws without one needs no process of its own
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--renderer-process-limit=1",  # else each navigation starts two processes
    "--disable-site-isolation-trials",
]
DESK = {"width": 1280, "height": 900}


@pytest.fixture(scope="package")
def browser() -> Iterator[Any]:
    """The system's Chromium with a fresh profile; without one the tests of the page skip.

    It ends with this package: as long as Playwright runs, its thread has a loop that no other may be beside.
    """
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: page not driven")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}: page not driven")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def forgiven() -> list[str]:
    """Patterns of console errors that a test provokes: what a browser itself logs of a refused request."""
    return []


@pytest.fixture(scope="package")
def client(rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A client of one service for all files but those that say otherwise: each test has a unit of its own.

    To a browser another port is another site, of which it has kept nothing.
    """
    path = tmp_path_factory.mktemp("page") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        yield client


@pytest.fixture(scope="package")
def tab(browser: Any) -> Iterator[Any]:
    """A profile with one tab for all tests: what the browser keeps of the page's files, it asks for once.

    A new window costs a headless Chromium half a second of processor time.
    """
    context = browser.new_context(accept_downloads=True, viewport=DESK)
    context.set_default_timeout(1000 * PATIENCE_S)
    yield context.new_page()
    context.close()


@pytest.fixture
def fresh_page(tab: Any, forgiven: list[str]) -> Iterator[Any]:
    """The tab with nothing left of other tests; fails on any console error, warning or uncaught exception."""
    problems: list[str] = []

    def heard(message: Any) -> None:
        if message.type in {"error", "warning"}:
            problems.append(message.text)

    def thrown(error: Any) -> None:
        problems.append(f"{error}\n{error.stack}")

    tab.set_viewport_size(DESK)
    tab.on("console", heard)
    tab.on("pageerror", thrown)
    yield tab
    tab.goto("about:blank")
    tab.unroute_all()
    tab.remove_listener("console", heard)
    tab.remove_listener("pageerror", thrown)
    tab.context.clear_cookies()
    assert [p for p in problems if not any(re.search(pattern, p) for pattern in forgiven)] == []


@pytest.fixture
def page(client: Any, fresh_page: Any) -> Iterator[Any]:
    """A page that is left before the service goes, which it watches; no rig is busy when the test is over."""
    yield fresh_page
    fresh_page.goto("about:blank")
    session = fresh_page.context.new_cdp_session(fresh_page)
    kept = {"origin": str(client.base_url), "storageTypes": "local_storage"}
    session.send("Storage.clearDataForOrigin", kept)
    session.detach()
    for rig in client.get("/api/rigs").json():
        if rig["state"] == "busy":
            client.post(f"/api/rigs/{rig['name']}/stop").raise_for_status()
    wait_for(lambda: all(rig["state"] != "busy" for rig in client.get("/api/rigs").json()), "rigs at rest")


@pytest.fixture
def go(page: Any, client: Any) -> Callable[[str], None]:
    """Opens a view of the page by its hash route; the view before, shown until then, meets no expectation."""
    leave = "route => location.hash !== route && document.getElementById('view')?.replaceChildren()"

    def go(route: str) -> None:
        page.evaluate(leave, route)
        page.goto(str(client.base_url.join("/")) + route)

    return go


@pytest.fixture
def expect(browser: Any) -> Any:
    """Playwright's assertions, which wait for what they expect."""
    from playwright.sync_api import expect

    expect.set_options(timeout=1000 * PATIENCE_S)
    return expect


@pytest.fixture
def no_limits(client):
    """None before a test and none left of it: the service is that of all tests of the page."""
    client.put("/api/limits", json=[])
    yield
    client.put("/api/limits", json=[])
