"""What the page weighs: bytes on the wire until the first run's charts are drawn, and after that."""

from __future__ import annotations

import pytest
from support import serving

from .page_help import ambiguous_poses, imported_lines, unfold

pytestmark = pytest.mark.browser

FIRST_BYTES = 600_000
"""Half of what was promised: with 5 Mbit/s a second. Nine tenths of it are the charts' script."""
NEXT_BYTES = 30_000
CHARTLESS_BYTES = 80_000
ANSWER_BYTES = 140_000
"""Of the import's page and of a run's, up to the answer and the next step: charts come with their fold."""


@pytest.fixture
def client(service):
    """A client of a service of which the browser has kept nothing."""
    with serving(service) as client:
        yield client


@pytest.fixture
def sent(page):
    """Bytes that came over the wire, heads and all, by address; what the browser has kept counts nothing."""
    session = page.context.new_cdp_session(page)
    names, sizes = {}, {}
    session.on("Network.requestWillBeSent", lambda e: names.update({e["requestId"]: e["request"]["url"]}))
    session.on(
        "Network.loadingFinished",
        lambda e: sizes.update({names[e["requestId"]]: e["encodedDataLength"]}),
    )
    session.send("Network.enable")
    yield sizes
    session.detach()


def test_the_first_run_page_comes_in_one_second_and_the_next_in_none(page, client, go, expect, sent):
    run = imported_lines(client, ambiguous_poses(), "A")
    charts = page.locator(".plot .plot-container")
    go("#/import")
    expect(page.locator("#import")).to_be_visible()
    page.wait_for_load_state("networkidle")
    assert not [name for name in sent if "plotly" in name]
    assert 0 < sum(sent.values()) < CHARTLESS_BYTES

    go(f"#/runs/{run['id']}")
    expect(page.locator("#next .primary")).to_be_visible()
    page.wait_for_load_state("networkidle")
    assert not [name for name in sent if "plotly" in name]
    assert sum(sent.values()) < ANSWER_BYTES
    unfold(page, "charts")
    expect(charts).to_have_count(1)
    page.wait_for_load_state("networkidle")
    assert [name for name in sent if "plotly" in name]
    assert sum(sent.values()) < FIRST_BYTES

    sent.clear()
    page.reload()
    unfold(page, "charts")
    expect(charts).to_have_count(1)
    page.wait_for_load_state("networkidle")
    assert 0 < sum(sent.values()) < NEXT_BYTES
    assert sum(size for name, size in sent.items() if "/web/" in name) == 0
