"""The page of a service that asks for a token: logging in and out, and users whom an admin adds."""

from __future__ import annotations

import httpx
import pytest
from support import LONG, serving

from calrig.api.access import Access
from calrig.run_ids import short_name

from .page_help import imported, unfold

pytestmark = pytest.mark.browser

TOKEN = "the-benches-of-building-4"


@pytest.fixture
def client(service):
    """A program that has the one token of its service."""
    with serving(service, access=Access(TOKEN, patience_s=0.1)) as client:
        client.headers["Authorization"] = f"Bearer {TOKEN}"
        yield client


def log_in(page, token=TOKEN):
    page.fill("#token", token)
    page.keyboard.press("Enter")


def test_an_admin_adds_a_user_whose_page_offers_what_they_may(page, client, go, expect):
    run = imported(client, "A")
    go("#/users")
    log_in(page, TOKEN)
    page.fill("#user-name", "ada")
    page.select_option("#user-role", "viewer")
    page.click("#add-user")
    token = page.locator("#new-token").inner_text()
    row = page.locator("#users-table tbody tr").filter(has_text="ada")
    expect(row).to_contain_text("by token")
    assert token not in row.inner_text()

    go("#/units")
    expect(page.locator("h1")).to_have_text("Units")  # nothing is asked any more that would be refused
    page.click("#log-out")
    log_in(page, token)
    expect(page.locator("#who")).to_have_text("ada (viewer)")
    expect(page.locator("#users-link")).to_be_hidden()
    go(f"#/runs/{run['id']}")
    unfold(page, "poses")
    expect(page.locator("#poses-table tbody tr").first).to_be_visible()
    for button in ("#void", "#move", "#note", "[aria-label^=Exclude]"):
        expect(page.locator(button)).to_have_count(0)
    expect(page.locator("button.stop")).to_be_visible()
    page.click("button.stop")
    expect(page.locator("#stop-line")).to_contain_text("stage stopped")

    client.post("/api/users/ada/role", json={"role": "releaser"}).raise_for_status()
    page.reload()
    unfold(page, "amend")
    page.click("#void")
    page.fill("#reason", "slipped")
    page.get_by_test_id("confirm").click()
    expect(page.locator("#void-reason")).to_contain_text("slipped")
    go("#/trail")
    expect(page.locator("#trail-table tbody tr").first).to_contain_text("ada")


def test_a_role_is_changed_and_a_user_disabled(page, client, go, expect, forgiven):
    forgiven.append("status of 409")
    client.post("/api/users", json={"name": "root", "role": "admin"}).raise_for_status()
    client.post("/api/users", json={"name": "ben", "role": "viewer", "token": False}).raise_for_status()
    go("#/users")
    log_in(page, TOKEN)
    row = page.locator("#users-table tbody tr").filter(has_text="ben")
    expect(row).to_contain_text("by a trusted proxy")
    page.get_by_label("Role of ben").focus()
    with page.expect_response("**/api/users"):  # the list is drawn anew after each change
        page.get_by_label("Role of ben").select_option("operator")
    expect(page.get_by_label("Role of ben")).to_have_value("operator")
    expect(page.get_by_label("Role of ben")).to_be_focused()
    page.get_by_role("button", name="Disable ben").click()
    page.get_by_test_id("confirm").click()
    expect(row).to_contain_text("disabled")
    users = {user["name"]: user for user in client.get("/api/users").json()}
    assert (users["ben"]["role"], users["ben"]["disabled_at"] is not None) == ("operator", True)
    page.get_by_label("Role of root").select_option("viewer")
    expect(page.locator("#error-root")).to_contain_text("root is the last admin")
    expect(page.get_by_label("Role of root")).to_have_value("admin")


def test_a_person_logs_in_works_and_logs_out(page, go, expect, forgiven):
    forgiven.append("status of 401")
    go("#/units")
    expect(page.locator("h1")).to_have_text("Log in")
    expect(page.locator("button.stop")).to_have_count(0)
    log_in(page, "not the right one")
    expect(page.locator("#login-error")).to_contain_text("this token")
    log_in(page)
    expect(page.locator("h1")).to_have_text("Units")
    expect(page.locator("button.stop")).to_be_visible()
    assert page.evaluate("document.cookie") == ""
    assert TOKEN not in page.evaluate("JSON.stringify([{...localStorage}, {...sessionStorage}])")

    page.reload()
    expect(page.locator("h1")).to_have_text("Units")
    page.click("#log-out")
    expect(page.locator("h1")).to_have_text("Log in")
    page.reload()
    expect(page.locator("h1")).to_have_text("Log in")


def test_a_session_that_ends_while_a_run_is_watched_asks_again_and_the_run_is_there(
    page, client, go, expect, forgiven
):
    forgiven.append("status of 401")
    run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    go(f"#/runs/{run['id']}")
    log_in(page)
    expect(page.locator("#poses-table tbody tr").nth(1)).to_be_visible()
    cookies = {cookie["name"]: cookie["value"] for cookie in page.context.cookies()}
    httpx.post(client.base_url.join("/api/logout"), cookies=cookies).raise_for_status()

    expect(page.locator("h1")).to_have_text("Log in")
    log_in(page)
    expect(page.locator("h1")).to_contain_text(f"Run {short_name(run['id'])}")
    expect(page.locator("#status")).to_have_text("running")
    page.click("button.stop")
    expect(page.locator("#status")).to_have_text("aborted")


def test_what_is_taken_home_comes_with_the_session(page, client, go):
    run = imported(client, "A")
    go(f"#/runs/{run['id']}")
    log_in(page)
    unfold(page, "files")
    with page.expect_download() as download:
        page.get_by_role("link", name="Poses (CSV)").click()
    assert download.value.path().read_text().startswith("target_deg,reading_deg")
