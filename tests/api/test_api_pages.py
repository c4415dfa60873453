"""The page's files: of the right type, asked about each time, and nothing beside them."""

from __future__ import annotations

from importlib.metadata import version

import pytest


def test_the_page_is_html_that_a_browser_asks_about_each_time(shared_client):
    page = shared_client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert page.headers["cache-control"] == "no-cache"
    unchanged = shared_client.get("/", headers={"If-None-Match": page.headers["etag"]})
    assert unchanged.status_code == 304


@pytest.mark.parametrize(
    ("file", "kind"), [("main.js", "text/javascript"), ("app.css", "text/css"), ("icon.svg", "image/svg+xml")]
)
def test_its_files_have_their_types_and_answer_304_while_they_are_the_same(shared_client, file, kind):
    answer = shared_client.get(f"/web/{file}")
    assert answer.headers["content-type"].startswith(kind)
    assert answer.headers["cache-control"] == "no-cache"
    again = shared_client.get(f"/web/{file}", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304


@pytest.mark.parametrize(
    ("query", "keeps"),
    [("", False), ("?v=0.0.0", False), (f"?v={version('plotly')}", True)],
    ids=["no version", "another version", "the version installed"],
)
def test_plotlys_script_is_kept_for_ever_only_under_its_own_version(shared_client, query, keeps):
    answer = shared_client.get(f"/vendor/plotly.min.js{query}")
    assert answer.headers["content-type"].startswith("text/javascript")
    assert ("immutable" in answer.headers["cache-control"]) == keeps
    assert b"plotly.js" in answer.content[:300]


@pytest.mark.parametrize("path", ["/web/%2e%2e/pyproject.toml", "/web/..%2fpyproject.toml", "/web/", "/nope"])
def test_nothing_beside_them_is_served(shared_client, path):
    answer = shared_client.get(path)
    assert (answer.status_code, answer.json()) == (404, {"detail": "Not Found"})
