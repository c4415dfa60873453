"""When units are due: by their histories where these say something, else after an interval."""

from __future__ import annotations

from datetime import timedelta

from dated_runs import at, gave, lay, ran

from calrig.analysis.due_dates import DueDates, due_dates
from calrig.calibration.uncertainty.conformity import Limit
from calrig.store import Store

YEAR = 365.0


def steady(store: Store) -> None:
    """Units that tell how little re-clamping adds."""
    results = [(unit, run, gave(0.5 + 0.002 * (-1) ** (run + unit))) for unit in range(4) for run in range(3)]
    lay(store, *((f"S{unit}", 10 * run, result, {}) for unit, run, result in results))


def within(store: Store, limit: Limit, now_day: float = 400) -> DueDates:
    return due_dates(store, interval_days=YEAR, limits=[limit], now=at(now_day))


def test_without_limits_a_unit_is_due_after_the_interval(store: Store) -> None:
    ran(store, "A", 0)
    ran(store, "A", 100)
    found = due_dates(store, interval_days=30, now=at(129))
    assert (found.of("A").due_at, found.of("A").overdue) == (at(130), False)
    assert due_dates(store, interval_days=30, now=at(131)).of("A").overdue
    assert "30 days after its last calibration" in found.of("A").due_says


def test_a_unit_that_drifts_is_due_before_it_reaches_its_limit(store: Store) -> None:
    steady(store)
    for day in (0, 50, 100, 150):
        ran(store, "DRIFTS", day, 0.5 + 0.001 * day)
    due = within(store, Limit(name="AS", bias_deg=(0.0, 0.8))).of("DRIFTS")
    assert due.due_method == "drift"
    assert at(270) < due.due_at < at(300)
    assert due.overdue
    assert within(store, Limit(name="AS", bias_deg=(0.0, 9.0))).of("DRIFTS").due_at > due.due_at


def test_an_error_allowed_counts_from_the_calibration_in_force(store: Store, monkeypatch) -> None:
    steady(store)
    runs = [ran(store, "DRIFTS", day, 0.5, 1.0 + 1e-4 * day) for day in (0, 50, 100)]

    class InForce:
        unit = "DRIFTS"
        run_id = runs[-1].id

    InForce.document = {"range_deg": [-60.0, 60.0]}
    monkeypatch.setattr(store.revisions, "all_in_force", lambda _serials: [InForce])
    due = within(store, Limit(name="AS", max_error_deg=0.6)).of("DRIFTS")
    assert due.due_method == "drift"
    assert at(100) + timedelta(days=80) < due.due_at < at(200), "60°·10⁻⁴ a day is 0.6° after 100 days"


def test_what_no_history_tells_is_due_after_the_interval_and_says_so(store: Store) -> None:
    steady(store)
    for day in (0, 0.1, 0.2):
        ran(store, "YOUNG", day, 0.5, std=0.05)
    due = within(store, Limit(name="AS", bias_deg=(0.3, 0.7))).of("YOUNG")
    assert (due.due_method, due.due_at) == ("interval", at(0.2) + timedelta(days=YEAR))
    assert "does not tell yet" in due.due_says


def test_a_change_begins_a_history_anew(store: Store) -> None:
    steady(store)
    for day, bias in ((0, 0.5), (50, 0.5), (100, 0.9), (150, 0.9)):
        ran(store, "HIT", day, bias)
    due = within(store, Limit(name="AS", bias_deg=(0.0, 1.0))).of("HIT")
    assert (due.due_method, due.due_at) == ("interval", at(150) + timedelta(days=YEAR))


def test_a_unit_that_was_never_calibrated_is_never_due(store: Store) -> None:
    ran(store, "N", 0, kind="verification")
    assert due_dates(store).of("N").due_at is None
