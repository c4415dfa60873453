"""The pictures of README and docs/reference/certificate.md: `python -m tests.pictures`; a minute and a half.

A run of the demo rig by `calrig serve`, *Diagnose* and *Accept all named* on its page in Chromium; then the
first page of the unit's certificate, drawn by pypdfium2 (the extra `bench`). The picture of
docs/explanation/error-separation.md has its own command.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import httpx

sys.path.insert(0, str(Path(__file__).parent))

from support import PATIENCE_S, ended, wait_for

DOCS = Path(__file__).parents[1] / "calrig" / "docs"
CHROMIUM = "/usr/bin/chromium"
VIEW = {"width": 1280, "height": 1160}
UNIT = "AS-0042"
COLOURS = 32
"""Of a picture of text: a fifth of the bytes."""
SETTINGS = """
[laboratory]
name = "Example calibration laboratory"
address = "1 Bench Road, Exampleton"
place = "Hall 3, bench 1"

[[rig]]
name = "demo"
simulated = { preset = "demo" }
reference = { std_deg = 0.03, distribution = "normal" }

[[limit]]
name = "flight grade"
max_error_deg = 0.5
expanded_uncertainty_deg = 0.1
rule = "guarded"
"""
ITEM = {
    "customer": "Example Aerospace",
    "address": "2 Hangar Lane, Exampleton",
    "order": "4711",
    "received_at": "2026-11-20",
    "condition": "as new",
    "interval_agreed_months": 12,
    "supplied": ["customer", "address", "order"],
}


def main() -> None:
    """Writes both."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as free:
        Path(folder, "calrig.toml").write_text(SETTINGS, encoding="utf-8")
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        command = [
            sys.executable,
            "-m",
            "calrig",
            "serve",
            "--port",
            str(port),
            "--db",
            f"{folder}/calrig.db",
        ]
        paths = os.pathsep.join([str(DOCS.parents[1]), os.environ.get("PYTHONPATH", "")])
        service = subprocess.Popen(command, cwd=folder, env={**os.environ, "PYTHONPATH": paths})
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S) as client:
                _draw(client)
        finally:
            service.terminate()
            service.wait()


def _draw(client: httpx.Client) -> None:
    wait_for(lambda: _is_up(client), "the service")
    run = client.post("/api/runs", json={"unit": UNIT}).raise_for_status().json()
    run = ended(client, run["id"])
    assert run["status"] == "completed", run["error"]
    _diagnosis(f"{client.base_url}/#/runs/{run['id']}")
    client.put(f"/api/units/{UNIT}/item", json=ITEM).raise_for_status()
    answer = client.get(f"/api/units/{UNIT}/calibration", params={"format": "pdf"}).raise_for_status()
    _first_page(answer.content)


def _is_up(client: httpx.Client) -> bool:
    try:
        return client.get("/api/health").is_success
    except httpx.TransportError:
        return False


def _diagnosis(address: str) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport=VIEW)
        page.goto(address)
        page.locator("#diagnose").click()
        page.locator("#accept-all").click(timeout=1000 * PATIENCE_S)
        page.locator("#download").wait_for(timeout=1000 * PATIENCE_S)
        _page_of_a_run(page)
        browser.close()


def _page_of_a_run(page: Any) -> None:
    """The answer, the next step, the effects and how well they explain the residual; no folds below."""
    page.locator("#diagnosis-fold > summary").click()
    page.locator("[data-testid=before-after] .main-svg").first.wait_for(timeout=1000 * PATIENCE_S)
    first, last = (page.locator(place).bounding_box() for place in ("h1", "#diagnosis"))
    height = last["y"] + last["height"] - first["y"] + 24
    clip = {"x": last["x"] - 20, "y": first["y"] - 12, "width": last["width"] + 40, "height": height}
    page.screenshot(path=DOCS / "diagnosis.png", full_page=True, clip=clip)


def _first_page(pdf: bytes) -> None:
    import pypdfium2  # type: ignore[import-untyped]

    page = pypdfium2.PdfDocument(pdf)[0].render(scale=1.6).to_pil()
    page.quantize(COLOURS).save(DOCS / "certificate.png", optimize=True)


if __name__ == "__main__":
    main()
