"""Generated tables end with a diagnosis or a refusal that says why; every figure that is stated is finite."""

from __future__ import annotations

import math

import pytest

from calrig.calibration.poses import DiagnosisError

from .commands import Bench, case
from .generate import diagnosed

ENDED_IN_AN_ERROR = [16, 113, 327, 10_105, 10_145, 10_148, 441_052, 510_155, 520_325]
"""Numbers of tables that once did, or never ended: negative noise, effects in turn, singular columns, angles
of 10⁸ degrees, clocks that go back, a fold without rivals, places alike of more poses than are judged,
coefficients of 10⁹⁷ of fits that diverge."""
OTHERS = (*range(7000, 7030), *range(10_000, 10_010))
BOOTSTRAPS = 40


def numbers(value):
    """All numbers of a JSON document."""
    if isinstance(value, dict):
        value = value.values()
    if isinstance(value, float):
        yield value
    elif not isinstance(value, str | int | None):
        for one in value:
            yield from numbers(one)


@pytest.mark.statistical
@pytest.mark.parametrize("number", [*ENDED_IN_AN_ERROR, *OTHERS])
def test_a_table_of_any_columns_is_diagnosed_or_refused_with_its_reason(number):
    try:
        found = diagnosed(number, BOOTSTRAPS)
    except DiagnosisError as refusal:
        assert "poses" in str(refusal) or "elevation" in str(refusal)
    else:
        assert all(math.isfinite(one) for one in numbers(found))


FILES = [1000019, 1000025, 1000158, 1000308, 1000325, 1000777, 1001199]
"""Numbers of files that ended otherwise: a constant reading, a column that outliers brought back, a negative
variance, offsets of an accelerometer not read, an exact witness, one dial position, an arc of outliers."""


@pytest.mark.statistical
@pytest.mark.parametrize("number", FILES)
def test_a_file_of_any_columns_is_answered_or_refused_by_its_command(number, tmp_path):
    assert Bench(tmp_path).outcome(case(number)) in {
        "refused",
        "done",
        "nothing",
        "ambiguous",
        "unnamed",
        "named",
    }
