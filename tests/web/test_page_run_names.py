"""What a run is called on the page: the beginning of its id, or its number where runs were counted."""

from __future__ import annotations

import pytest
from dated_runs import gave, lay
from support import running_service, serving

from .page_help import imported

pytestmark = pytest.mark.browser

OLD = "17"


@pytest.fixture(scope="module")
def client(rig, tmp_path_factory):
    """A service over a store with one run of the time when they were counted."""
    path = tmp_path_factory.mktemp("names") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        lay(service.store, ("OLD", 1.0, gave(), {"uid": OLD}))
        yield client


def test_a_run_is_shown_by_the_beginning_of_its_id_and_found_by_the_whole(page, client, go, expect):
    run_id = imported(client, "NEW")["id"]
    go("#/")
    links = page.locator("#runs-table tbody th a")
    expect(links).to_have_text([run_id[:8], OLD])
    expect(links.first).to_have_attribute("title", run_id)
    links.first.click()
    page.wait_for_url(f"**/#/runs/{run_id}")
    expect(page.locator("h1")).to_have_text(f"Run {run_id[:8]} · NEW")
    expect(page.locator("h1")).to_have_attribute("title", run_id)
    go(f"#/runs/{OLD}")
    expect(page.locator("h1")).to_have_text(f"Run {OLD} · OLD")
