"""What is undone on a run's page, and what the trail and both units say of it."""

from __future__ import annotations

import re

import pytest

from .page_help import imported, unfold

pytestmark = pytest.mark.browser


def confirm(page, **fields):
    """Fills in the question and answers it."""
    for field, text in fields.items():
        page.fill(f"dialog #{field.replace('_', '-')}", text)
    page.get_by_test_id("confirm").click()


def told(page, unit, go, expect, entries):
    """Texts of the trail of a unit, newest first, once there are so many."""
    go(f"#/trail?unit={unit}")
    rows = page.locator("#trail-table tbody tr")
    expect(rows).to_have_count(entries)
    return rows.all_inner_texts()


def test_a_voided_run_counts_again_and_the_trail_says_why(page, client, go, expect):
    run = imported(client, "AGAIN")
    go(f"#/runs/{run['id']}")
    unfold(page, "amend")
    page.click("#void")
    confirm(page, reason="the cable caught")
    expect(page.locator("#void-reason")).to_contain_text("the cable caught")
    expect(page.locator("#void")).to_have_count(0)
    page.click("#unvoid")
    expect(page.locator("dialog")).to_contain_text("the cable caught")
    confirm(page, reason="it was another run")
    expect(page.locator("#void-reason")).to_have_count(0)
    expect(page.locator("h1")).not_to_have_css("text-decoration-line", "line-through")
    assert client.get(f"/api/runs/{run['id']}").json()["voided"] is None
    newest, before, *_ = told(page, "AGAIN", go, expect, 5)  # it was imported, drafted, released
    assert "reinstated a run" in newest
    assert "it was another run" in newest
    assert "voided a run" in before
    expect(page.locator("#trail-state")).to_contain_text("intact")


def test_an_excluded_pose_is_included_again(page, client, go, expect):
    run = imported(client, "INCLUDED")
    go(f"#/runs/{run['id']}")
    unfold(page, "poses")
    page.get_by_role("button", name="Exclude pose 3").click()
    confirm(page, reason="bumped")
    row = page.locator("#poses-table tr[data-pose='3']")
    expect(row).to_contain_text("excluded: bumped")
    page.get_by_role("button", name="Include pose 3").click()
    confirm(page, reason="it was pose 4")
    expect(row).not_to_contain_text("excluded")
    assert client.get(f"/api/runs/{run['id']}").json()["result"] == run["result"]


def test_notes_are_added_one_below_the_other(page, client, go, expect):
    run = imported(client, "NOTED")
    go(f"#/runs/{run['id']}")
    unfold(page, "amend")
    for note in ("it hangs low", "<b>bent</b> pin"):
        page.click("#note")
        confirm(page, note=note)
        expect(page.locator("p.note")).to_contain_text(note)
    expect(page.locator("p.note")).to_have_text(re.compile(r"^it hangs low\n\d{4}-.* UTC: <b>bent</b> pin$"))


def test_a_run_under_a_wrong_serial_number_is_moved_and_the_ghost_removed(page, client, go, expect):
    run = imported(client, "GHOST/1")
    go(f"#/runs/{run['id']}")
    unfold(page, "amend")
    page.click("#move")
    confirm(page, right_unit="RIGHT-1", reason="misread")
    expect(page.locator("h1")).to_contain_text("RIGHT-1")
    assert "from GHOST/1 to RIGHT-1" in told(page, "GHOST%2F1", go, expect, 4)[0]
    *_, moved = told(page, "RIGHT-1", go, expect, 3)  # it has a calibration of its own since
    assert "from GHOST/1 to RIGHT-1" in moved
    go("#/units/GHOST%2F1")
    page.get_by_role("button", name="Withdraw…").click()
    confirm(page, reason="there is no such unit")
    expect(page.locator("#calibration")).to_contain_text("None")
    page.click("#remove-unit")
    confirm(page)
    expect(page.locator("h1")).to_have_text("Units")
    expect(page.locator("#units-table")).to_contain_text("RIGHT-1")
    expect(page.locator("#units-table")).not_to_contain_text("GHOST/1")


def test_a_move_that_is_refused_says_why_and_the_question_stays(page, client, go, expect, forgiven):
    forgiven.append("status of 409")
    run = imported(client, "HERE")
    go(f"#/runs/{run['id']}")
    unfold(page, "amend")
    page.click("#move")
    confirm(page, right_unit="HERE", reason="misread")
    expect(page.locator("#ask-error")).to_contain_text("of unit 'HERE' already")
    expect(page.locator("dialog")).to_be_visible()
    go("#/units")
    expect(page.locator("dialog")).to_have_count(0)
