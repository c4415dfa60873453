"""Stores with a run in them, and with something in every table that a service fills."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from empty_store import lay_empty_store
from sqlalchemy import create_engine
from support import imported, serving

from calrig.calibration.poses import Pose
from calrig.store import AcceptedEffect, SampleBlock, Store
from calrig.store.certificates import IssuedCertificate
from calrig.store.raw_rows import tables
from calrig.store.records import Basis, Solved
from calrig.store.units import CalibrationItem

POSES = "target_deg,reading_deg,+5V\n-30,-29.5,5.01\n0,-0.4,4.99\n30,30.6,5.00\n60,60.9,5.02\n"
LIMIT = {"name": "flight", "units": "A*", "max_error_deg": 0.5, "rule": "guarded"}
SOLVED = Solved(
    rig="r",
    basis=Basis(("0b5c4f1e", "17"), ("Ä-1",), linear=True, periods_deg=(7.2,)),
    document={
        "units": [{"unit": "Ä-1"}],
        "separable": False,
        "before": {"held_out_rms_deg": 0.21},
        "final": {"held_out_rms_deg": 0.031},
        "warnings": ["größer als erwartet"],
    },
    calibrations={"Ä-1": {"unit": "Ä-1", "bias_deg": 1 / 3, "sha256": "5e"}},
    stage_map={"map": {"stage_deg": [0.0, -0.0, 1e-300]}, "sha256": "5f" * 32},
    poses={"dial_deg": [0.1, 2.0], "before_deg": [0.5, None]},
)


def fill(path: Path) -> str:
    """Runs, revisions, limits, users, a check unit, amendments: by the calls that make them.

    Returns:
        The token of an admin.
    """
    from calrig.runs.service import RunService

    lay_empty_store(path)
    with Store.open(f"sqlite:///{path}", writer="serve") as store:
        _measure(store)
        with closing(RunService(store, [])) as service, serving(service) as client:
            _amend(client)
        store.check_standards.name("r", "A-3", 7.0, who="ada")
        batch = store.batches.create({"rigs": ["r"], "plan": {"dwell_s": 0.1}, "note": "Ä"}, ["A-1", "Ä-2"])
        store.batches.update(batch.id, batch.turns, [replace(batch.turns[0], state="done", why="größer")])
        store.deliveries.record_end(store.runs.page(status="completed")[0][0].id, datetime.now(UTC))
        store.items.add(
            "A-3", CalibrationItem(customer="山田 & Søn", condition="neu", supplied=("customer",)), who="ada"
        )
        solution = store.solutions.save(SOLVED, by="ada")
        store.stage_maps.put_in_force("r", solution.id, SOLVED.stage_map, who="ada")
        store.studies.save("noise", "Prüfling 7.csv", {"report": {}, "figures": [1e-300]}, who="ada")
        _certify(store)
        store.users.add("proxied", "viewer", with_token=False)
        _, token = store.users.add("ada", "admin")
    assert token is not None
    return token


def _measure(store: Store) -> None:
    """A run with samples, one that failed with transcripts, a static log, and where a stage was left."""
    run = store.runs.create(unit="Ä-1", rig="r", plan={"step_deg": 5}, status="running", provenance={})
    for k in range(30):
        pose = Pose(float(k), k + 0.1 * (k % 3), temperature_c=20 + k / 7, covariates={"humidity": k / 3})
        done = {"poses_done": k + 1, "poses_total": 30, "fraction": (k + 1) / 30, "remaining_s": None}
        event = ("pose", {"index": k, "reading_deg": -0.0, "large": 2**63 - 1, "text": "a\0b"})
        store.poses.add(run.id, k, pose, [block(k)], [event], progress=done)
    store.runs.update(run.id, status="completed")
    failed = store.runs.create(unit="Ä-1", rig="r", plan=None, status="running", provenance={})
    store.events.save_transcripts(failed.id, {"/dev/ttyUSB0": "1TP\r\n1TP?", "/dev/ttyACM0": ""})
    store.runs.update(failed.id, status="failed", error="the stage did not answer")
    static = store.runs.create(unit="a-1", rig="r", plan={"kind": "static"}, status="running", provenance={})
    store.samples.add(static.id, [block(0, 2000), block(0, 1)], faults={"crc": 2})
    store.runs.update(static.id, status="completed")
    tilt = AcceptedEffect(
        run.id, "Ä-1", None, "axis_tilt", "mounting", {"amplitude_deg": 0.1, "phase_deg": None}
    )
    store.effects.accept(run.id, [tilt], who="ada")
    store.positions.save("r", -0.0)
    store.positions.save("other", None)


def _certify(store: Store) -> None:
    """Issue a certificate, and the one that corrects it, whose number comes first in the table."""
    before: str | None = None
    (revision, *_) = store.revisions.of("A-3")
    for number, pdf, dcc in (("0001-B", None, b"<dcc/>"), ("0001-A", b"%PDF\0", b"<dcc>\xc3\xa4</dcc>")):
        seq, head = store.trail.head()
        forms = {"pdf": pdf, "dcc": dcc, "json": revision.text.encode()}
        issued = IssuedCertificate(
            number=number,
            unit="A-3",
            revision=revision.revision,
            issued_at=datetime.now(UTC),
            issued_by="ada",
            replaces=before,
            reason=before and "größer als erwartet",
            settings={"name": "Prüfstelle"},
            sha256={form: content and sha256(content).hexdigest() for form, content in forms.items()},
            trail_seq=seq,
            trail_sha256=head,
        )
        store.certificates.add(issued, pdf, dcc, revision.status)
        before = number


def _amend(client: httpx.Client) -> None:
    def asked(method: str, path: str, **body: Any) -> None:
        client.request(method, path, json=body).raise_for_status()

    client.put("/api/limits", json=[LIMIT]).raise_for_status()
    first, second, third = (imported(client, unit, POSES)["id"] for unit in ("A-2", "A-2", "a-2"))
    asked("POST", f"/api/runs/{second}/poses/1/exclude", reason="somebody leant on the bench")
    asked("POST", f"/api/runs/{second}/note", note="wärmer, 温度 ↑ \u2028 'quoted' \\n \t tab")
    asked("POST", f"/api/runs/{third}/void", reason="clamped askew")
    asked("POST", f"/api/runs/{first}/unit", unit="A-3", reason="a wrong label")


@contextmanager
def by_hand(file: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(file)) as connection, connection:
        yield connection


def rows_in(url: str) -> dict[str, int]:
    """How many rows each table has that has any."""
    engine = create_engine(url)
    with engine.connect() as connection:
        counted = {t.name: connection.execute(t.select()).all() for t in tables()}
    engine.dispose()
    return {name: len(rows) for name, rows in counted.items() if rows}


def block(index: int, n: int = 500) -> SampleBlock:
    noise = np.random.default_rng(index)
    return SampleBlock(
        index, "dwell", np.arange(n) / 200, noise.normal(size=(n, 3)), np.ones((n, 3)), np.full(n, 24.0)
    )


def filled(url: str, result: dict[str, Any] | None = None, poses: int = 20) -> str:
    """A run with poses, samples and events; its id."""
    lay_empty_store(Path(url.removeprefix("sqlite:///")))
    with Store.open(url, writer="test") as store:
        run = store.runs.create(unit="A", rig="r", plan={"step_deg": 5}, status="running", provenance={})
        for k in range(poses):
            pose = Pose(float(k), k + 0.1 * (k % 3), temperature_c=20 + k / 7, covariates={"humidity": k / 3})
            event = ("pose", {"index": k, "reading_deg": k / 7})
            done = {"poses_done": k + 1, "poses_total": poses, "fraction": k / poses, "remaining_s": None}
            store.poses.add(run.id, k, pose, [block(k)], [event], progress=done)
        store.runs.update(run.id, status="completed", result=result)
    return run.id
