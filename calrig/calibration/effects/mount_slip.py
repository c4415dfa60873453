"""A slip of the mount at one instant: between two moves, during one, or in a dwell, whose mean has a part."""

from collections.abc import Callable, Iterator

import numpy as np

from calrig.calibration.regression.channels import MOVE
from calrig.calibration.regression.effect import (
    TIME,
    Applied,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import tilted, turned
from calrig.estimation.angles import BoolArray, FloatArray

EDGE_POSES = 3
"""A slip needs this many poses on either side: fewer are outliers."""
PARTS = (0.3, 0.7)
"""Of a dwell that came after a slip: as they are scanned."""
MIDDLE = 0.5
COARSE, FINER = np.linspace(0.0, 1.0, 5), np.linspace(-0.2, 0.2, 9)
"""Of the parts, and about the best of those: the likelihood has one hump."""
TOGETHER = 3
"""Of the gaps every so many is tried together with what else comes with time: the others lie close by."""
MOST_INSTANTS = 150
"""Beyond so many poses not every gap is tried: a slip is then placed to within a pose or two."""


def _scan(r: Responses) -> Iterator[Parameters]:
    if r.time_s is None:
        return
    for k in range(EDGE_POSES, len(r) - EDGE_POSES + 1, 1 + len(r) // MOST_INSTANTS):
        if not r.starts[k]:
            yield {"at_s": float((r.time_s[k - 1] + r.time_s[k]) / 2.0), "pose": float(k)}


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    order = np.arange(len(r))
    if r.time_s is None:
        return
    for k in _first_after(r.time_s, r.starts, at):
        after = (order >= k).astype(float)
        forms = {"between moves": tilted(after)}
        if MOVE in r.channels:
            forms["during a move"] = turned(r, after)
        for form, shares in forms.items():
            here = {"at_s": at["at_s"], "pose": float(k)}
            yield Shape(shares, ("step_deg",), form=form, at=here, scanned=True, alone=k % TOGETHER != 0)
        parts = (at["part"],) if "part" in at else PARTS
        for part in parts if r.motion is None else ():  # a reading on the move is no mean of a dwell
            yield _in_dwell(r, {"at_s": float(r.time_s[k]), "pose": float(k), "part": part})


def _in_dwell(r: Responses, at: Parameters) -> Shape:
    """A slip of which the mean of one dwell has a part, or that of a stretch, where the gyro feels it."""
    order, k = np.arange(len(r)), at["pose"]
    share = (order > k) + at["part"] * (order == k)
    if MOVE not in r.channels or not r.stretch_deg[int(k)]:
        return Shape(tilted(share), ("step_deg",), form="in a dwell", at=at, scanned=True, alone=True)
    into = order == (k if at["part"] > MIDDLE else k + 1)  # the gyro's account goes from middle to middle
    shares = {**tilted(share), MOVE: into.astype(float)}
    return Shape(shares, ("step_deg",), form="in a stretch", at=at, scanned=True, alone=True)


def _first_after(time_s: FloatArray, starts: BoolArray, at: Parameters) -> list[int]:
    """Return the poses before which it happened: of each run that was under way, or of the one known."""
    if "at_s" not in at:
        return []
    early, late = time_s[:-1] <= at["at_s"], time_s[1:] >= at["at_s"]
    found = [int(k) + 1 for k in np.flatnonzero(early & late & ~starts[1:])]
    if "pose" in at and found:
        return [min(found, key=lambda k: abs(k - at["pose"]))]
    return found


def _refine(r: Responses, shape: Shape, criterion: Callable[[Shape], float]) -> Shape | None:
    """Of a slip in a dwell, the share of the dwell that came after it."""
    if "part" not in shape.at:
        return None
    first = int(np.searchsorted(r.time_s, shape.at["at_s"])) if r.time_s is not None else 0
    if first == len(r):
        return None  # in a dwell of a run whose clock these poses do not have
    here = {**shape.at, "pose": float(first)}

    def best(parts: FloatArray) -> Shape:
        return min((_in_dwell(r, {**here, "part": float(part)}) for part in parts), key=criterion)

    coarse = best(COARSE)
    finer = coarse.at["part"] + FINER
    return best(finer[(finer >= 0.0) & (finer <= 1.0)])


def _on_reading_deg(p: Applied) -> FloatArray:
    step = np.full(len(p.theta_deg), p.value("step_deg"))
    time_s = p.given.get("time_s")
    if time_s is None:
        return step
    return np.asarray(step * (time_s > p.value("at_s", None)), dtype=np.float64)


EFFECT = Effect(
    name="mount_slip",
    title="Slip of the mount",
    origin="mounting",
    scope="run",
    covariate=TIME,
    parameters=(Parameter("step_deg", "Step (after − before)", "°"), Parameter("at_s", "At", "s")),
    formula="step_deg where t > at_s, else 0",
    forms=_forms,
    scan=_scan,
    on_reading_deg=_on_reading_deg,
    in_c=NotInFlight("the mount is fastened anew for flight: what a slip left behind is not there"),
    refine=_refine,
    apart="a step at one instant; lost steps of the stage look the same until it is homed again",
    together_with=("temperature_bias", "time_drift"),
    remedy="tighten the mount and repeat; poses before and after do not belong together",
)
