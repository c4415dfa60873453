"""Certificates of units with any history: what a store can hold, and what people write into it."""

from __future__ import annotations

import json
import random
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np

from calrig.calibration.effects import CATALOGUE
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.conformity import ANSWERS, Limit
from calrig.canonical_json import canonical, sha256_of
from calrig.export.calibration_document import calibration_content
from calrig.export.certificate.content import Certificate
from calrig.export.certificate.making import Sources, certificate_of
from calrig.laboratory import LaboratorySettings
from calrig.model.run import Progress
from calrig.plan import Plan
from calrig.store import Run, StoredPose
from calrig.store.issued import Revision
from calrig.store.records import AcceptedEffect
from calrig.store.trail import Entry
from calrig.store.units import CalibrationItem

WORDS = ("AS-0042", "Ä/7 \"<&>'", "\x00\x1b[2J", "温度 \ufffe", " ", "a\nb\tc", "]]>", "x" * 200, "🛰")
DAY = datetime(2026, 3, 1, 9, 30, tzinfo=UTC)


def random_certificate(rng: random.Random) -> tuple[Certificate, bytes]:
    """A certificate, and the calibration document that it is of."""
    return certificate_of(sources := random_sources(rng)), sources.revision.text.encode()


def random_sources(rng: random.Random) -> Sources:
    reference = rng.choice(
        [None, Reference(0.29), Reference(0.01, "setting", "normal"), Reference(0.1, "common")]
    )
    provenance = _provenance(rng, reference)
    poses = _poses(rng)
    effects = _effects(rng)
    document = _document(rng, poses, effects, reference, provenance)
    revision = _revision(rng, document)
    before = _revision(rng, {**document, "revision": 1}) if rng.random() < 0.5 else None
    entries = [_entry(rng, what) for what in ("drafted", "released")[: rng.randrange(3)]]
    run = _run(rng, revision, provenance)
    stored = [StoredPose(k, pose, None) for k, pose in enumerate(poses)]
    laboratory = LaboratorySettings(**_some(rng, ("name", "address", "decision_rule", "authorised_by")))
    limit = Limit(name="flight", max_error_deg=0.5, rule="guarded", scale=(0.9, 1.1))
    return Sources(
        revision=revision,
        run=run,
        poses=stored,
        laboratory=laboratory,
        before=before,
        of_stage=[effect for effect in effects if effect.unit is None],
        limit=rng.choice([None, limit]),
        entries=entries,
        item=rng.choice([None, _item(rng)]),
    )


def _some(rng: random.Random, names: tuple[str, ...]) -> dict[str, str]:
    return {name: rng.choice(WORDS) for name in names if rng.random() < 0.6}


def _poses(rng: random.Random) -> list[Pose]:
    n, warm = rng.choice([3, 12, 60]), rng.random() < 0.7
    noise = np.random.default_rng(rng.randrange(2**32)).normal(0, 0.02, n)
    return [
        Pose(
            float(theta),
            float(0.8 + 1.002 * theta + noise[k]),
            approach=rng.choice([None, 1, -1]),
            temperature_c=20.0 + k / 10 if warm else None,
            reading_stderr_deg=rng.choice([None, 0.02]),
        )
        for k, theta in enumerate(np.linspace(-60, 60, n))
    ]


def _effects(rng: random.Random) -> list[AcceptedEffect]:
    own = [effect for effect in CATALOGUE if effect.name not in ("unnamed", "backlash")]
    chosen = rng.sample(own, rng.randrange(3))
    accepted = [
        AcceptedEffect(
            "1",
            "A",
            None,
            one.name,
            one.origin,
            {p.name: rng.choice([1e-7, -3.25, 40.0]) for p in one.parameters},
        )
        for one in chosen
    ]
    if rng.random() < 0.3:
        accepted.append(AcceptedEffect("1", None, "r", "backlash", "stage", {"backlash_deg": 0.05}))
    return accepted


def _document(
    rng: random.Random,
    poses: list[Pose],
    effects: list[AcceptedEffect],
    reference: Reference | None,
    provenance: dict[str, Any],
) -> dict[str, Any]:
    result = build_result(poses, None, (), reference)
    content = calibration_content(
        unit=rng.choice(WORDS[:2]), rig="r", poses=poses, result=result, reference=reference
    )
    own = [
        {"name": effect.name, "parameters": effect.parameters, "formula": "a < b & c"}
        for effect in effects
        if effect.unit is not None
    ]
    known = rng.choice([{}, {"level_known": True, "level_std_deg": 0.01}])
    return {
        **content,
        "effects": own,
        **known,
        "revision": rng.randrange(2, 9999),
        "run_id": "17",
        "issued_at": "2026-03-02T00:00:00Z",
        "calibrated_at": None,
        "provenance": provenance,
    }


def _revision(rng: random.Random, document: dict[str, Any]) -> Revision:
    answer = rng.choice(["no_limits", *ANSWERS])
    probability = rng.choice([None, 0.0, 0.123456, 1.0])
    sha256 = sha256_of(json.loads(json.dumps(document)))
    return Revision(
        unit=document["unit"],
        revision=document["revision"],
        status=rng.choice(["draft", "in_force", "superseded", "withdrawn"]),
        run_id=rng.choice(["17", "18"]),
        text=canonical({**document, "sha256": sha256}),
        sha256=sha256,
        basis={"effects": {}, "excluded": rng.choice([[], [1]]), "chosen": None},
        verdict={
            "answer": answer,
            "says": [rng.choice(WORDS), "It is so."],
            "limit": None if answer == "no_limits" else rng.choice(WORDS),
            "probability_of_conformity": probability,
            "probability_of_false_accept": probability,
        },
        issued_at=DAY + timedelta(days=1),
        issued_by=None,
        reason=rng.choice([None, *WORDS]),
    )


def _provenance(rng: random.Random, reference: Reference | None) -> dict[str, Any]:
    """Of a measured run, or of an import."""
    if rng.random() < 0.2:
        return {"imported_from": rng.choice(WORDS), "calrig": "0.1.0"}
    of_stage: dict[str, Any] | None = None
    if reference is not None:
        of_stage = {
            "std_deg": reference.std_deg,
            "kind": reference.kind,
            "distribution": reference.distribution,
            **_some(rng, ("certificate", "issued_by", "name", "file")),
            **rng.choice([{}, {"sha256": "0" * 64, "due": "2026-01-01", "issued_at": "2025-01-01"}]),
        }
    return {
        "calrig": "0.1.0",
        "simulated": rng.random() < 0.2,
        "rig": {"name": "r", "reference": of_stage},
        "stage": {"driver": "smc100", "firmware": rng.choice(WORDS)},
        "board": {"driver": "calrig", "firmware": rng.choice([None, *WORDS]), "chip": "MPU-6050"},
        "warnings": [rng.choice(WORDS)],
    }


def _run(rng: random.Random, revision: Revision, provenance: dict[str, Any]) -> Run:
    plan = None if "imported_from" in provenance else Plan.model_validate({"sweeps": 2}).model_dump()
    return Run(
        id=revision.run_id,
        unit=revision.unit,
        rig="r",
        status="completed",
        plan=plan,
        progress=Progress(poses_done=3, poses_total=3, fraction=1.0, remaining_s=0.0),
        result=None,
        diagnosis=None,
        faults=rng.choice([{}, {"crc": 3}]),
        follows=None,
        provenance=provenance,
        operator=None,
        note=None,
        voided=None,
        created_at=DAY,
        started_at=DAY,
        finished_at=DAY + timedelta(minutes=4),
        error=None,
    )


def _entry(rng: random.Random, what: Any) -> Entry:
    return Entry(what, rng.choice([None, *WORDS]), seq=rng.randrange(1, 10**6), at=DAY, sha256="a" * 64)


def _item(rng: random.Random) -> CalibrationItem:
    return CalibrationItem(
        **_some(rng, ("customer", "address", "order", "condition", "description")),
        received_at=rng.choice([None, date(2026, 2, 27)]),
        interval_agreed_months=rng.choice([None, 12]),
        supplied=rng.choice([(), ("customer", "condition")]),
    )
