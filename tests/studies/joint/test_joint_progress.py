"""How far a joint solution says that it is, of units clamped by one face and by several."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.analysis.solutions import SolutionInputs, answer
from calrig.store.records import Basis

from .cases import BOUNDS
from .cube import drawn_cube_bench


def one_face(rng):
    return BOUNDS["0/120/240, ±60°, cubic"].bench(2).measured(rng)


def several_faces(rng):
    return drawn_cube_bench(2).measured(rng)


@pytest.mark.parametrize("measured", [one_face, several_faces])
def test_the_share_that_is_done_only_grows_and_no_long_part_tells_nothing(measured):
    lots, told = measured(np.random.default_rng(2)), []
    answer(SolutionInputs(None, Basis((), ("U0",), False, (), None, "sensor"), lots), told.append)
    assert told == sorted(told) and told[0] > 0.0 and told[-1] < 1.0
    assert np.diff([0.0, *told, 1.0]).max() < 0.4
