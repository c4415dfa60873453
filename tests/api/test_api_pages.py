"""The page's files, kept under their digest; what the API answers is kept by no browser and no proxy."""

from __future__ import annotations

import gzip
import re

import httpx
import pytest
from support import imported, run_async, running_service

from calrig.api.access import Access
from calrig.api.app import create_app
from calrig.settings import packed

PLOTLY = "vendor/plotly-partial.min.js"


@pytest.fixture
def folder(shared_client):
    """Where the page says that its files are: `/web/<digest>/`."""
    (href,) = re.findall(r'src="(/web/[0-9a-f]{16}/)main.js"', shared_client.get("/").text)
    return href


def test_the_page_is_html_that_a_browser_asks_about_each_time(shared_client):
    page = shared_client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert page.headers["cache-control"] == "no-cache"
    unchanged = shared_client.get("/", headers={"If-None-Match": page.headers["etag"]})
    assert unchanged.status_code == 304


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("main.js", "text/javascript"),
        ("app.css", "text/css"),
        ("icon.svg", "image/svg+xml"),
        (PLOTLY, "text/javascript"),
    ],
)
def test_a_file_has_its_type_and_is_kept_for_ever_only_under_the_digest(shared_client, folder, file, kind):
    kept = shared_client.get(folder + file)
    assert kept.headers["content-type"].startswith(kind)
    assert kept.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert kept.content == (packed("web") / file).read_bytes()
    for elsewhere in ("/web/", f"/web/{'0' * 16}/"):
        answer = shared_client.get(elsewhere + file)
        assert answer.content == kept.content
        assert answer.headers["cache-control"] == "no-cache"
        again = shared_client.get(elsewhere + file, headers={"If-None-Match": answer.headers["etag"]})
        assert again.status_code == 304


LATER = re.findall(
    r"\w+",
    """
    amend benches benchfilters benchtable calibrations certificate charts compare diagnosis effect
    effects fold followup import interrupted limits live longwork next noise paper plandesign poses provenance
    queue queuebell queueclock queueform queuekeys queuerig result rig run runhead solution solutions solve
    stream timeline together trail unitlist units upload users waiting
    """,
)
"""Modules of pages that are fetched when somebody goes there."""


def test_every_address_in_the_page_names_the_digest_and_every_module_is_named(shared_client, folder):
    html = shared_client.get("/").text
    assert set(re.findall(r'"(/web/[^"]*/)[^"/]*"', html)) == {folder}
    named = re.findall(r'rel="modulepreload" href="[^"]*/([^"]*)"', html)
    assert named == sorted(file.name for file in packed("web").glob("*.js") if file.stem not in LATER)


def test_a_changed_file_is_seen_at_once_under_another_digest(serve_folder):
    folder, client = serve_folder
    before = client.get("/").text
    (folder / "main.js").write_text("2;", encoding="utf-8")
    after = client.get("/")
    assert after.text != before
    (source,) = re.findall(r'src="([^"]*main.js)"', after.text)
    assert client.get(source).text == "2;"


@pytest.fixture
def serve_folder(service, tmp_path):
    """A folder with a small page of its own, and a client of the service that serves it."""
    from support import serving

    folder = tmp_path / "web"
    folder.mkdir()
    html = '<head><script type="module" src="/web/main.js"></script>\n</head>'
    (folder / "index.html").write_text(html, encoding="utf-8")
    (folder / "main.js").write_text("1;", encoding="utf-8")
    with serving(service, web=folder) as client:
        yield folder, client


@pytest.mark.parametrize(
    ("path", "shrinks"), [(f"/web/{PLOTLY}", 2.5), ("/web/run.js", 2.0), ("/api/openapi.json", 4.0)]
)
def test_what_is_large_is_sent_compressed_to_whoever_takes_it(shared_client, path, shrinks):
    with shared_client.stream("GET", path, headers={"Accept-Encoding": "gzip"}) as answer:
        assert answer.headers["content-encoding"] == "gzip"
        assert "Accept-Encoding" in answer.headers["vary"]
        sent = b"".join(answer.iter_raw())
    plain = shared_client.get(path, headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert gzip.decompress(sent) == plain.content
    assert len(plain.content) > shrinks * len(sent)


def test_the_charts_script_is_the_makers_core_and_says_whose_it_is(shared_client, folder):
    script = shared_client.get(folder + PLOTLY).text
    assert "plotly.js v" in script[:200]
    assert "MIT license" in script[:400]
    assert 'name:"scatter"' in script
    assert 'name:"bar"' in script
    assert 'name:"scattermap"' not in script  # maps are half of the whole script, and none is drawn here


@pytest.mark.parametrize(
    "path",
    [
        "/web/%2e%2e/pyproject.toml",
        "/web/..%2fpyproject.toml",
        f"/web/{'0' * 16}/%2e%2e/pyproject.toml",
        f"/web/{'0' * 16}/%2fetc/passwd",
        f"/web/{'0' * 16}/",
        "/web/",
        "/nope",
    ],
)
def test_nothing_beside_them_is_served(shared_client, path):
    answer = shared_client.get(path)
    assert (answer.status_code, answer.json()) == (404, {"detail": "Not Found"})


@pytest.fixture(scope="module")
def run_id(shared_client):
    return imported(shared_client, "AS-1")["id"]


@pytest.mark.parametrize(
    "path",
    [
        "/api/health",
        "/api/rigs",
        "/api/runs",
        "/api/runs/{id}",
        "/api/runs/{id}/events",
        "/api/runs/{id}/poses",
        "/api/runs/{id}/poses?format=csv",
        "/api/runs/{id}/samples",
        "/api/runs/{id}/transcript",
        "/api/runs/{id}/figures/residual",
        "/api/units",
        "/api/compare",
        "/api/effects",
        "/api/metrics",
        "/api/openapi.json",
        "/api/runs/99",
        "/api/no-such-path",
    ],
)
def test_no_answer_of_the_api_is_kept(shared_client, run_id, path):
    answer = shared_client.get(path.format(id=run_id))
    assert answer.headers.get_list("cache-control") == ["no-store"]


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE"])
def test_nor_one_to_another_method(shared_client, method):
    assert shared_client.request(method, "/api/runs").headers["cache-control"] == "no-store"


def test_nor_refusals_and_failures_inside(rig, store_path):
    with running_service(store_path, rig) as service:
        app = create_app(service, access=Access(token="a-token-of-sixteen"))
        app.add_api_route("/api/defect", lambda: 1 / 0)

        async def asked(path: str, **headers: str) -> httpx.Response:
            transport = httpx.ASGITransport(app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
                return await client.get(path, headers=headers)

        answers = [
            run_async(asked("/api/runs", Host="evil.example")),
            run_async(asked("/api/runs")),
            run_async(asked("/api/defect", Authorization="Bearer a-token-of-sixteen")),
        ]
    assert [answer.status_code for answer in answers] == [403, 401, 500]
    assert [answer.headers["cache-control"] for answer in answers] == ["no-store"] * 3


def test_the_pages_files_are_kept_all_the_same(shared_client):
    page = shared_client.get("/")
    assert page.headers["cache-control"] == "no-cache"
    main = page.text.split('src="')[1].split('"')[0]
    assert "immutable" in shared_client.get(main).headers["cache-control"]
