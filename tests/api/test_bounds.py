"""A quick look at what `test_bounds_memory.py` measures in full: small bodies that would grow large."""

from __future__ import annotations

import tracemalloc

import pytest

MB = 1_000_000
BOUNDARY = "x-calrig-x"

BODIES = {
    "a million columns": ("/api/imports", "file", b"target_deg,reading_deg" + b",c" * MB + b"\n"),
    "lists in lists": ("/api/runs", "json", b"[" * 900_000),
    "a form of two hundred thousand parts": (
        "/api/imports",
        "form",
        f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="f"\r\n\r\n\r\n'.encode() * 200_000,
    ),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_body_that_would_grow_is_refused_before_it_has(shared_client, name):
    path, how, body = BODIES[name]
    kinds = {"json": "application/json", "form": f"multipart/form-data; boundary={BOUNDARY}"}
    tracemalloc.start()
    try:
        if how == "file":
            answer = shared_client.post(path, files={"file": ("f.csv", body)}, data={"unit": "A"})
        else:
            answer = shared_client.post(path, content=body, headers={"Content-Type": kinds[how]})
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert answer.status_code == 422, answer.text
    assert peak_bytes < 6 * len(body)
