"""What differs from run to run: an effect that began or ended, its parameters the later less the earlier.

The level of a run (how it was clamped, where the stage was homed) is free while the shapes within the runs
are searched: what a drift or a warm-up has left behind by the next run is not known. The levels are compared
after that, in a base that has one bias for all.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.regression.effect import TIME, Covariate, Effect, Shape
from calrig.calibration.regression.responses import FEWEST_POSES, Change, Responses
from calrig.estimation.angles import FloatArray

RUN = Covariate("run", "run", "", lambda r: r.run.astype(np.float64))
"""Of effects that are nothing but a difference between runs: within one they are its bias or scale."""
FEW_CHANGES = 2
"""Where runs are more, a change between two of them is looked for among effects with a name and no place."""
SOME_CHANGES = 8
"""Where runs are still more, only what they differ by in bias and scale is looked for."""
MANY_CHANGES = 20
"""Where runs are still more, one change at a time."""


def shapes_of(r: Responses, effect: Effect, *, named: bool) -> Iterator[Shape]:
    """The shapes that an effect takes in some poses: in all of them, and before or after a change alone."""
    shapes = list(effect.shapes(r))
    if effect.covariate is RUN:  # what ends is the same as what begins, but for bias and scale
        for change in _changes(r, ended=False):
            yield from changed_shapes(r, change, shapes)
        return
    yield from shapes
    changes = len(r.run_ids) - 1
    few = changes <= FEW_CHANGES
    if few or (named and changes <= SOME_CHANGES):
        moving = [shape for shape in shapes if _may_change(effect, shape, few=few)]
        for change in (*_changes(r, ended=False), *_changes(r, ended=True)):
            own = r.rows(np.flatnonzero((r.run < change.run) == change.ended))
            enough = FEWEST_POSES <= len(own) <= len(r) - FEWEST_POSES
            if enough and next(effect.shapes(own), None) is not None:  # those runs by themselves show it
                yield from changed_shapes(r, change, moving)


def _may_change(effect: Effect, shape: Shape, *, few: bool) -> bool:
    return not shape.scanned or (few and effect.covariate is not TIME)  # what has an instant is of one run


def _changes(r: Responses, *, ended: bool) -> list[Change]:
    names = r.run_ids
    return [Change(k, names[k - 1], names[k], ended) for k in range(1, len(names))]


def since(r: Responses, change: Change) -> FloatArray:
    """Return (n,) what a difference counts in each pose: 1 after the change; of what ended, −1 before it."""
    return np.asarray((r.run >= change.run).astype(np.float64) - float(change.ended), dtype=np.float64)


def changed_shapes(r: Responses, change: Change | None, shapes: Sequence[Shape]) -> list[Shape]:
    """Shapes as they are where nothing changed, else what they add to the runs after a change.

    Of what ended the coefficients are negative: nothing less what there was before.
    """
    if change is None:
        return list(shapes)
    later = since(r, change)
    return [
        replace(
            shape,
            shares={channel: (share.T * later).T for channel, share in shape.shares.items()},
            replaces=None,
            changed=change,
        )
        for shape in shapes
    ]


def in_words(change: Change | None) -> str:
    """Such as ` from run 17 to run 18`; empty where nothing changed."""
    return "" if change is None else f" from run {change.before} to run {change.after}"


def is_level(r: Responses, columns: FloatArray) -> bool:
    """Return whether columns (n, J, p) say no more of the reading than that runs have different biases."""
    if len(r.run_ids) < 2:
        return False
    return all(np.ptp(columns[r.run == run, 0], axis=0).max(initial=0.0) == 0.0 for run in np.unique(r.run))


def with_free_levels(r: Responses) -> Responses:
    """Return the responses with a bias for each run: whatever was done between them may have moved it."""
    later = r.run[:, None] >= np.arange(1, len(r.run_ids))
    return r.with_free(later.astype(np.float64), "level")
