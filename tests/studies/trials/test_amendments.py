"""The trial of kills compares stores by what was done, whichever of them was started more often."""

from __future__ import annotations

import shutil
from pathlib import Path

from calrig.analysis.amendments import Records
from calrig.analysis.certificates import issue_certificate
from calrig.analysis.revisions import Issuer
from calrig.laboratory import LaboratorySettings
from calrig.store import Store
from calrig.store.trail import Act
from tests.studies.accepting import UNIT
from tests.studies.trials.amendments import contents, prepared


def test_a_store_that_a_start_has_checked_is_compared_by_its_acts(tmp_path: Path) -> None:
    path, copy = tmp_path / "calrig.db", tmp_path / "copy.db"
    prepared(path, 1)
    shutil.copy(path, copy)
    with Store.open(f"sqlite:///{path}", writer="test") as store:
        store.trail.add(Act("mended", reason="0 changes checked"))
    for one in (path, copy):
        with Store.open(f"sqlite:///{one}", writer="test") as store:
            run = store.runs.page(limit=1)[0][0]
            Records(store).void(run.id, "slipped")
    assert contents(path) == contents(copy)
    assert len(contents(path)["trail"]) > 0


def test_a_certificate_issued_twice_is_one_act_and_is_not_the_state_before(tmp_path: Path) -> None:
    path, copy = tmp_path / "calrig.db", tmp_path / "copy.db"
    prepared(path, 1)
    with Store.open(f"sqlite:///{path}", writer="test") as store:
        Issuer(store).draft(UNIT, store.runs.page(limit=1)[0][0].id)
    shutil.copy(path, copy)
    before = contents(path)
    for one in (path, copy):
        with Store.open(f"sqlite:///{one}", writer="test") as store:
            revision = store.revisions.in_force(UNIT)
            assert revision is not None
            issue_certificate(store, revision, LaboratorySettings())
    assert contents(path) == contents(copy) != before
