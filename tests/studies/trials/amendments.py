"""Kill the service at random instants of acts on stored runs, and compare the store with before and after.

Each act (acceptance, withdrawal, exclusion, void, move, draft, release, certificate) is requested over HTTP.
After the kill the store must equal a copy from before the act, or one on which the same act was carried out
in full.
"""

from __future__ import annotations

import json
import random
import shutil
import sqlite3
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from calrig.analysis.amendments import Records
from calrig.analysis.certificates import issue_certificate
from calrig.analysis.diagnoses import Acceptance
from calrig.analysis.errors import RunsError
from calrig.analysis.revisions import Issuer
from calrig.laboratory import LaboratorySettings
from calrig.store import Run, Store
from calrig.store.certificates import IssuedCertificate
from calrig.store.errors import NotFound, Refused
from tests.studies.accepting import EFFECTS, FIRST_C, SECOND_C, UNIT, diagnosed_run, measured

from .counting import Count, Extent, none_of
from .served import Served, configured, until

KILLS = 200
KILLS_A_STORE = 20
AFTER_WRITE = 0.7
"""Share of the kills that wait until the act begins to write."""
WINDOW_S = 0.7
DEADLINE_S = 30.0
OTHER = "AS-2"
TABLES = ("run", "calibration", "pose", "accepted_effect", "issued_calibration", "certificate", "trail")
HASHES = {"sha256", "crc32"}
"""What differs between two executions of one act, as its times do."""
OF_CERTIFICATES = {"number", "pdf", "dcc", "trail_seq", "trail_sha256"}
"""What follows from times and hashes; whether it is known has a meaning."""

Act = tuple[str, dict[str, Any]]


def prepared(path: Path, seed: int) -> None:
    """Make a store with three runs of a unit, each with a diagnosis that names two effects."""
    rng = np.random.default_rng(seed)
    with Store.open(f"sqlite:///{path}", writer="trial") as store:
        for ends_c in (FIRST_C, SECOND_C, FIRST_C):
            diagnosed_run(store, measured(rng, ends_c), *(name for name, _ in EFFECTS))


def act_on(store: Store, rng: random.Random) -> Act:
    """Carry out one act at random among those that the state of the runs allows; return its request."""
    while True:
        carry_out, act = _act(store, rng.choice(store.runs.page(limit=9)[0]), rng)
        with suppress(RunsError, Refused, NotFound):  # not allowed in this state: another one
            carry_out()
            return act


def _act(store: Store, run: Run, rng: random.Random) -> tuple[Callable[[], object], Act]:
    issuer = Issuer(store)
    records, acceptance = Records(store, issuer), Acceptance(store, issuer)
    at, of_unit = f"/api/runs/{run.id}", f"/api/units/{run.unit}/calibrations"
    number, pose, why = rng.randint(1, 6), rng.randint(0, 51), f"trial {rng.random():.6f}"
    names = rng.choice([[name] for name, _ in EFFECTS] + [[name for name, _ in EFFECTS]])
    reason, other = {"reason": why}, OTHER if run.unit == UNIT else UNIT
    before = next(iter(store.certificates.of(run.unit)), None)
    certificate = {"revision": number, **({} if before is None else {"replaces": before.number, **reason})}
    with_names = {"effects": names, **reason}

    def issue() -> IssuedCertificate:
        revision = store.revisions.get(run.unit, number)
        if revision is None:
            raise NotFound(f"no revision {number}")
        replaced = None if before is None else before.number
        return issue_certificate(
            store, revision, LaboratorySettings(), replaces=replaced, reason=replaced and why
        )

    acts: list[tuple[int, Callable[[], object], str, dict[str, Any]]] = [
        (2, issue, f"/api/units/{run.unit}/certificates", certificate),
        (4, lambda: acceptance.accept(run.id, names), f"{at}/diagnosis/accept", {"effects": names}),
        (2, lambda: acceptance.take_back(run.id, names, why), f"{at}/diagnosis/withdraw", with_names),
        (1, lambda: records.void(run.id, why), f"{at}/void", reason),
        (1, lambda: records.unvoid(run.id, why), f"{at}/unvoid", reason),
        (2, lambda: records.exclude_pose(run.id, pose, why), f"{at}/poses/{pose}/exclude", reason),
        (2, lambda: records.include_pose(run.id, pose, why), f"{at}/poses/{pose}/include", reason),
        (2, lambda: records.move(run.id, other, why), f"{at}/unit", {"unit": other, **reason}),
        (1, lambda: issuer.draft(run.unit, run.id, reason=why), of_unit, {"run_id": run.id, **reason}),
        (
            1,
            lambda: issuer.release(run.unit, number, by=None, reason=why),
            f"{of_unit}/{number}/release",
            reason,
        ),
        (
            1,
            lambda: issuer.withdraw(run.unit, number, by=None, reason=why),
            f"{of_unit}/{number}/withdraw",
            reason,
        ),
    ]
    _, carry_out, path, body = rng.choices(acts, [weight for weight, *_ in acts])[0]
    return carry_out, (path, body)


def contents(path: Path) -> dict[str, list[str]]:
    """Return what the store holds of runs and calibrations, without the times of acts and their hashes."""
    with closing(sqlite3.connect(path)) as file:
        file.row_factory = sqlite3.Row
        found = {
            table: [dict(row) for row in file.execute(f"SELECT * FROM {table} ORDER BY 1")]
            for table in TABLES
        }
    found["trail"] = _without_check(found["trail"])
    return {table: sorted(map(_row_text, rows)) for table, rows in found.items()}


def _without_check(trail: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the entries without the one that says that a start has checked the store, numbered anew.

    One of the two stores may have been started once more: the number of an act is one more there.
    """
    acts = [row for row in trail if not (row["what"] == "mended" and row["unit"] is None)]
    return [row | {"seq": place} for place, row in enumerate(acts, 1)]


def _row_text(row: dict[str, Any]) -> str:
    return json.dumps(_without_times({name: _parsed(value) for name, value in row.items()}), sort_keys=True)


def _parsed(value: Any) -> Any:
    if isinstance(value, str) and value[:1] in "{[":
        with suppress(ValueError):
            return json.loads(value)
    return value


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):  # whether a time is known has a meaning
        left = {k: one for k, one in value.items() if k.strip() not in HASHES}
        return {
            k: one is None if k == "at" or k.endswith("_at") or k in OF_CERTIFICATES else _without_times(one)
            for k, one in left.items()
        }
    return [_without_times(one) for one in value] if isinstance(value, list) else value


def kill_some(seed: int, kills: int) -> tuple[list[str], int, int]:
    """Return lines for half-done acts, how many kills came before the act's commit, and how many after."""
    rng = random.Random(seed)
    half, before_n, after_n = [], 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config, path, copy = configured(folder, []), folder / "calrig.db", folder / "copy.db"
        prepared(path, seed)
        Served(config, path).terminate()  # the first start issues revisions
        for n in range(kills):
            before = contents(path)
            shutil.copy(path, copy)
            with Store.open(f"sqlite:///{copy}", writer="trial") as store:
                request, body = act_on(store, rng)
            after = contents(copy)
            _kill_during(Served(config, path), (request, body), path, rng)
            with Store.open(f"sqlite:///{path}", writer="trial"):
                found = contents(path)
            before_n, after_n = before_n + (found == before), after_n + (found == after)
            if found not in (before, after):
                differ = [table for table in TABLES if found[table] != after[table]]
                half.append(
                    f"seed {seed}, kill {n}: {request}: differs from before, and from after in {differ}"
                )
    return half, before_n, after_n


def _kill_during(served: Served, act: Act, store: Path, rng: random.Random) -> None:
    """Request an act, and kill the service soon after it first writes to the store, or at any time before."""
    path, body = act
    log = store.with_name(f"{store.name}-wal")
    size = log.stat().st_size
    after_write, wait_s = rng.random() < AFTER_WRITE, rng.uniform(0.0, WINDOW_S)

    def send() -> None:
        with suppress(httpx.HTTPError):
            served.client.post(path, json=body)

    sending = threading.Thread(target=send, daemon=True)
    sending.start()
    if after_write:
        until(lambda: log.stat().st_size != size or None, DEADLINE_S)
        wait_s *= rng.random()
    threading.Event().wait(wait_s)
    served.kill()
    sending.join()


def trial(extent: Extent) -> list[Count]:
    """200 kills at random instants of acts."""
    number = extent.of(KILLS)
    lots = [min(KILLS_A_STORE, number - k) for k in range(0, number, KILLS_A_STORE)]
    seeds = [1000 * extent.seed + k for k in range(len(lots))]
    with ProcessPoolExecutor(extent.workers, mp_context=get_context("spawn")) as workers:
        outcomes = list(workers.map(kill_some, seeds, lots))
    before, after = sum(o[1] for o in outcomes), sum(o[2] for o in outcomes)
    tried = f"{number} kills, {before} before the act was stored, {after} after it"
    return [none_of("acts on stored runs left half done", tried, [line for o in outcomes for line in o[0]])]
