"""What differs from run to run: an effect of the later runs alone, its parameters the later less the earlier.

The level of a run (how it was clamped, where the stage was homed) is free while the shapes within the runs are
searched: what a drift or a warm-up has left behind by the next run is not known. The levels are compared after
that, in a base that has one bias for all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.effect import TIME, Covariate, Effect, Shape
from calrig.calibration.responses import ANGLE, READING, Change, Responses
from calrig.estimation.angles import FloatArray

RUN = Covariate("run", "run", "", lambda r: r.run.astype(np.float64))
"""Of effects that are nothing but a difference between runs: within one they are its bias or scale."""
FEW_CHANGES = 2
"""Where runs are more, a change between two of them is looked for among effects with a name and no place."""


def changes_of(r: Responses) -> list[Change]:
    """Between which runs something may have changed."""
    names = r.run_ids
    return [Change(k, names[k - 1], names[k]) for k in range(1, len(names))]


def shapes_of(r: Responses, effect: Effect, *, named: bool) -> Iterator[Shape]:
    """The shapes that an effect takes in some poses: in all of them, and in those after a change alone."""
    shapes = list(effect.shapes(r))
    if effect.covariate is not RUN:
        yield from shapes
    changes = changes_of(r)
    for change in changes:
        for shape in shapes:
            at_one_time = shape.scanned and effect.covariate is TIME  # in one run as it is
            if not at_one_time and (len(changes) <= FEW_CHANGES or (named and not shape.scanned)):
                yield changed(r, shape, change)


def changed(r: Responses, shape: Shape, change: Change) -> Shape:
    """A shape in the runs after a change alone."""
    later = (r.run >= change.run).astype(np.float64)
    shares = {channel: (share.T * later).T for channel, share in shape.shares.items()}
    return replace(shape, shares=shares, replaces=None, changed=change)


def is_level(r: Responses, columns: FloatArray) -> bool:
    """Whether columns (n, J, p) say no more of the reading than that runs have different biases."""
    if len(r.run_ids) < 2:
        return False
    return all(np.ptp(columns[r.run == run, 0], axis=0).max(initial=0.0) == 0.0 for run in np.unique(r.run))


def with_free_levels(r: Responses) -> Responses:
    """The responses with a bias for each run: whatever was done between them may have moved it."""
    runs = range(1, len(r.run_ids))
    names = [(name, run) for name in (READING, ANGLE) if name in r.channels for run in runs]
    if not names:
        return r
    freed = np.zeros((len(r), len(r.channels), len(names)))
    for place, (name, run) in enumerate(names):
        freed[:, r.channels.index(name), place] = r.run >= run
    base_names = (*r.base_names, *(f"{name}.level" for name, _ in names))
    return replace(r, base=np.concatenate([r.base, freed], axis=2), base_names=base_names)


def in_words(change: Change | None) -> str:
    """Such as ` from run 17 to run 18`; empty where nothing changed."""
    return "" if change is None else f" from run {change.before} to run {change.after}"


def only_in_later_runs(r: Responses, change: Change | None, shapes: Sequence[Shape]) -> list[Shape]:
    """Shapes as they are where nothing changed, else in the runs after the change alone."""
    return list(shapes) if change is None else [changed(r, shape, change) for shape in shapes]
