"""Attacks by way of a browser: texts that would be markup, and pages elsewhere that would drive the rig."""

from __future__ import annotations

import functools
import http.server
import json
from pathlib import Path

import numpy as np
import pytest
from support import LONG, QUICK, at_work, ended, running_service, serving, wait_for

from calrig.api.access import Access

from .page_help import imported, until_pose

pytestmark = pytest.mark.browser

MARKUP = """"><img src=x onerror=alert(1)><script>alert(1)</script><a href="javascript:alert(1)">go</a>"""
LINK = '<a href="javascript:alert(1)">volts</a>'
BACKWARDS = "Ada\u202ecod.exe"
STRANGE = "[src='x'], main script, main iframe, svg a, a[href^='javascript']"
"""What must not come to be of those texts on any view."""


@pytest.fixture
def untouched(page, expect):
    """Fails when a text has become markup or has run; every look also waits for the text itself."""
    alerts = []

    def asked(dialog):
        alerts.append(dialog.message)
        dialog.dismiss()

    def untouched(*texts):
        for text in texts:
            expect(page.get_by_text(text).first).to_be_attached()
        assert page.locator(STRANGE).count() == 0
        assert alerts == []

    page.on("dialog", asked)
    yield untouched
    page.remove_listener("dialog", asked)


def poses_with(column):
    """Poses whose residual follows one column that is in nobody's catalogue."""
    rng = np.random.default_rng(4)
    volts = rng.normal(0.0, 1.0, 24)
    target = np.tile(np.linspace(-50, 50, 6), 4)
    reading = 0.2 + 1.002 * target + 0.3 * np.sin(3.0 * volts) + rng.normal(0.0, 0.02, 24)
    quoted = '"' + column.replace('"', '""') + '"'
    rows = [
        f"{t},{r:.4f},0.02,{v:.4f},{k * 5}"
        for k, (t, r, v) in enumerate(zip(target, reading, volts, strict=True))
    ]
    return "\n".join([f"target_deg,reading_deg,reading_stderr_deg,{quoted},time_s", *rows]).encode()


def test_what_a_file_says_of_itself_is_text_on_every_view(page, client, go, expect, untouched):
    files = {"file": (MARKUP, poses_with(LINK))}
    run = client.post("/api/imports", data={"unit": MARKUP, "operator": MARKUP}, files=files).json()
    imported(client, "B")
    assert client.post(f"/api/runs/{run['id']}/diagnosis", json={}).json()["verdict"] == "unnamed"

    go("#/")
    untouched(MARKUP)
    go(f"#/runs/{run['id']}")
    expect(page.locator(".effect")).to_be_visible()
    page.locator("details > summary").evaluate_all("all => all.forEach(one => one.click())")
    expect(page.get_by_test_id("effect-0").locator(".xtitle")).to_have_text(LINK)
    expect(page.get_by_test_id("residual").locator(".plot-container")).to_be_visible()
    untouched(MARKUP, LINK)
    go("#/units")
    untouched(MARKUP)
    page.get_by_role("link", name=MARKUP, exact=True).click()
    expect(page.get_by_test_id("history").locator(".plot-container")).to_be_visible()
    untouched(MARKUP)
    page.get_by_role("link", name="Compare with other units").click()
    for name in ("residuals", "bias", "scale", "rms"):
        expect(page.get_by_test_id(f"compare-{name}").locator(".legendtext")).to_have_text(MARKUP)
    chart = page.get_by_test_id("compare-bias")

    def pointed_at():
        chart.locator(".nsewdrag").hover(position={"x": 1, "y": 1})
        chart.locator(".nsewdrag").hover()
        return "><img" in "".join(chart.locator(".hoverlayer .name").all_text_contents())

    wait_for(pointed_at, "name of what is pointed at")
    untouched(MARKUP)


def test_files_that_are_refused_are_named_as_text(page, client, go, expect, forgiven, untouched):
    forgiven.append("status of 422")
    broken = {"name": f"{MARKUP.replace('/', '')}.csv", "mimeType": "text/csv"}
    go("#/import")
    page.fill("#unit", "A")
    content = b"target_deg,reading_deg\n0,<a href=javascript:alert(1)>\n"
    page.set_input_files("#file", {**broken, "buffer": content})
    page.click("#import")
    expect(page.locator("#import-error")).to_contain_text("<a href=javascript:alert(1)>")
    untouched("<img src=x")
    go("#/noise")
    page.set_input_files("#log", {**broken, "buffer": b"time_s\n0\n"})
    page.click("#analyse")
    expect(page.locator("#noise-error")).to_contain_text("<img src=x")
    untouched("<img src=x")


def test_what_a_person_and_a_board_say_is_text_and_turns_nothing_round(page, client, go, expect, untouched):
    run = client.post(
        "/api/runs", json={"unit": "A", "plan": QUICK, "operator": BACKWARDS, "note": MARKUP + "\n" + LINK}
    ).json()
    ended(client, run["id"])
    client.post(f"/api/runs/{run['id']}/void", json={"reason": MARKUP}).raise_for_status()
    go(f"#/runs/{run['id']}")
    expect(page.locator(".facts")).to_contain_text("by Ada\\u202ecod.exe")
    untouched(MARKUP, LINK)


def test_a_boards_own_words_are_text(fresh_page, launch_rig, store_path, expect):
    rig = launch_rig("bench-2", board={"serial": MARKUP[:60], "firmware": MARKUP})
    with running_service(store_path, rig) as service, serving(service) as client:
        run = client.post("/api/runs", json={"unit": "A", "plan": QUICK}).json()
        assert ended(client, run["id"])["status"] == "failed"
        fresh_page.goto(str(client.base_url.join(f"/#/runs/{run['id']}")))
        expect(fresh_page.locator("#run-reason")).to_contain_text(MARKUP[:60])
        fresh_page.locator("details > summary").evaluate_all("all => all.forEach(one => one.click())")
        assert fresh_page.locator(STRANGE).count() == 0
        fresh_page.goto("about:blank")


# Pages elsewhere

NOTHING = {"opaque", "TypeError", "nothing", "sent", ""}
"""What an attack may come back with: an answer that cannot be seen, an error, or that it was sent off."""
TOKEN = "the-benches-of-building-4"


@pytest.fixture
def elsewhere():
    """The port of somebody else's web server on this machine, which serves a hostile page."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format, *args):
            pass

    handler = functools.partial(Quiet, directory=Path(__file__).parent)
    with at_work(http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)) as server:
        yield server.server_port


@pytest.mark.parametrize(
    ("name", "token"),
    [("evil.localhost", None), ("evil.localhost", TOKEN), ("127.0.0.1", TOKEN)],
    ids=["another site", "another site, a person logged in", "another port, a person logged in"],
)
def test_a_page_elsewhere_changes_nothing_and_reads_nothing(
    fresh_page, forgiven, service, elsewhere, name, token
):
    forgiven.append(".*")  # the browser complains of every one of these attempts
    page = fresh_page
    with serving(service, access=Access(token)) as client:
        client.headers["Authorization"] = f"Bearer {token}"
        run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
        until_pose(client, run["id"], 1)
        own = str(client.base_url).rstrip("/")
        if token:
            page.goto(own)
            page.fill("#token", token)
            page.click("#log-in")
            page.wait_for_selector("button.stop")
        answers = []

        def answered(response):
            if response.url.startswith(own):
                answers.append((response.request.method, response.status))

        page.goto("about:blank")
        page.on("response", answered)
        page.goto(f"http://{name}:{elsewhere}/hostile.html#{own},{run['id']}")
        tried = wait_for(lambda: page.evaluate("window.tried"), "end of the attempts")
        assert len(tried) == 19
        assert {attack: got for attack, got in tried.items() if got not in NOTHING} == {}
        posts = [status for method, status in answers if method == "POST"]
        assert posts
        assert set(posts) == {403}
        after = client.get("/api/runs").json()["items"]
        assert [(one["id"], one["status"]) for one in after] == [(run["id"], "running")]
        page.remove_listener("response", answered)


def test_a_name_of_the_attackers_that_leads_here_reads_nothing(fresh_page, forgiven, client):
    """DNS rebinding: to the browser, the service is now part of the attacker's own site."""
    forgiven.append("status of 403")
    answer = fresh_page.goto(f"http://rebound.localhost:{client.base_url.port}/api/runs")
    assert answer.status == 403
    read = fresh_page.evaluate(
        "fetch('/api/rigs/bench-1/stop', {method: 'POST'}).then(async r => [r.status, await r.text()])"
    )
    assert read[0] == 403
    assert "rebound.localhost" in json.loads(read[1])["detail"]
