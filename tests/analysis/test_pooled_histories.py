"""Of very many runs a unit's own are all told, and how units repeat by the latest of all."""

from __future__ import annotations

import pytest
from dated_runs import gave, lay

from calrig.analysis import histories as module
from calrig.analysis.due_dates import due_dates
from calrig.analysis.histories import histories, unit_changes


def _filled(store, units: int = 6, runs: int = 4) -> None:
    lay(
        store,
        *(
            (f"AS-{unit}", 10.0 * run + unit / 10, gave(0.5 + unit / 100 + 0.004 * (-1) ** (run + unit)), {})
            for run in range(runs)
            for unit in range(units)
        ),
    )


def test_where_runs_are_few_a_unit_is_told_as_beside_all_others(store):
    _filled(store)
    whole, one = histories(store), histories(store, ["AS-3"])
    assert one.rows == whole.rows
    assert one.changes.pooled == whole.changes.pooled


def test_of_very_many_the_unit_is_whole_and_the_latest_stand_for_all(store, monkeypatch: pytest.MonkeyPatch):
    _filled(store)
    monkeypatch.setattr(module, "POOLED", 12)
    found = histories(store, ["AS-3"])
    assert [found.rows[place].run_id for place in found.of("AS-3")] == [
        row.run_id for row in store.units.comparison(["AS-3"])
    ]
    assert len(found.rows) == 12 + 2  # of the unit's four runs two are among the latest
    latest = {row.run_id for row in sorted(store.units.comparison(), key=lambda row: row.finished_at)[-12:]}
    assert latest <= {row.run_id for row in found.rows}
    assert [row.unit for row in found.rows] == sorted(row.unit for row in found.rows)
    assert len(unit_changes(store, "AS-3")) == 3
    assert due_dates(store, serials=["AS-3"]).of("AS-3").due_at is not None
