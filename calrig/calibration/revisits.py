"""Poses revisited from one side: what they differ by is no function of the elevation, whatever that may be.

An axis' error may be wavy all along and differ by direction. Half explained it looks like noise that wanders,
and hides what steps or drifts beside it; with a free curve for each side in the base that shows by itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.channels import ANGLE, READING
from calrig.calibration.column_units import TIMES
from calrig.calibration.effect import APPROACH, ELEVATION
from calrig.calibration.effects.unnamed import MORE_KNOTS, POSES_A_KNOT, natural_spline
from calrig.calibration.lack_of_fit import SEVERAL
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray


def with_free_curve(r: Responses) -> Responses | None:
    """The responses with a curve of the elevation for each side; None where too few poses carry one."""
    sides = [np.ones(len(r), dtype=bool)]
    if r.approach is not None and len(np.unique(r.approach[r.approach != 0.0])) > 1:
        sides = [r.approach > 0.0, r.approach <= 0.0]
    enough = [count for count in MORE_KNOTS if len(r) >= POSES_A_KNOT * count * len(sides)]
    if not enough or len(np.unique(r.theta_deg)) <= max(enough) + 1:
        return None
    curve = natural_spline(r.theta_deg, max(enough))
    columns = [(np.column_stack([np.ones(len(r)), curve]).T * side).T for side in sides]
    own = np.concatenate([columns[0][:, 1:], *columns[1:]], axis=1)  # one side has the bias itself
    return _freed(r, own)


def _freed(r: Responses, own: FloatArray) -> Responses:
    """The responses with columns (n, p) for the reading, and as many for the accelerometer's angle."""
    seen = [name for name in (READING, ANGLE) if name in r.channels]
    freed = np.zeros((len(r), len(r.channels), len(seen) * own.shape[1]))
    for k, name in enumerate(seen):
        freed[:, r.channels.index(name), k * own.shape[1] : (k + 1) * own.shape[1]] = own
    names = (f"{name}.curve" for name in seen for _ in range(own.shape[1]))
    base = np.concatenate([r.base, freed], axis=2)
    return replace(r, base=base, base_names=(*r.base_names, *names))


def is_of_the_curve(candidate: Candidate) -> bool:
    """Whether a candidate says no more than that the sides have curves."""
    of_curve = {ELEVATION.name, APPROACH.name}
    return all(of_curve.issuperset(member.covariate.split(TIMES)) for member in candidate.members)


def leaves_more(r: Responses, residual_deg: FloatArray) -> bool:
    """Whether a model leaves several times what poses differ by from one to the next beside free curves.

    Args:
        r: the poses.
        residual_deg: (n,) of their readings.
    """
    free = with_free_curve(r)
    if free is None or r.starts.all():
        return False
    base = free.base[:, 0, :]
    beside = r.values[:, 0] - base @ np.linalg.lstsq(base, r.values[:, 0], rcond=None)[0]
    differences = np.diff(beside)[~r.starts[1:]]
    noise_deg = np.hypot(np.sqrt(np.mean(differences**2) / 2.0), r.rounding[0])
    return bool(residual_deg.std() > SEVERAL * noise_deg)
