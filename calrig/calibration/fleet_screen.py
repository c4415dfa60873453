"""The screen of a fleet: of a million runs, those in which a diagnosis could find something.

Each run's residual about its own line is held against a fixed set of contrasts: directions in which an effect
of the catalogue, or one without a name, would show. All contrasts have the same bar, so that together they
pass at most a share `LEVEL` of runs whose noise is normal and independent from pose to pose, whatever their
layout (Bonferroni's bound: no distribution is assumed of contrasts that are alike). Under that null the share
R² of the residual's squares along a contrast of d columns has the exact distribution B(d/2, (ν − d)/2), ν the
residual's degrees of freedom (Draper & Smith, Applied Regression Analysis, 1998, section 6.1). Noise that is
correlated from pose to pose stands out: only a diagnosis, which models it, can tell it from an effect.

What the diagnosis does not judge, the screen does not either: the first pose of a run, and a pose gone wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
from scipy.special import betainc, ndtr

from calrig.calibration.fleet_contrasts import Block, Share, channel_shares
from calrig.calibration.fleet_lines import Lines, lines_of
from calrig.calibration.packed_poses import Intp, PackedPoses
from calrig.calibration.responses import FEWEST_POSES
from calrig.estimation.angles import FloatArray

LEVEL = 0.05
"""Of runs of white noise that stand out, at most: five times what the diagnosis' gate lets pass, so that
little is lost here that would pass there."""
POSES_AT_ONCE = 2**14
"""What belongs to them stays in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """What R runs show at a glance; NaN where it is not known, or a run has too few poses.

    Attributes:
        bias_deg, scale: (R,) of the line through all poses; no scale where all are at one angle.
        rms_deg: (R,) of the residual about it.
        lag1_correlation: (R,) of the residual from pose to pose.
        direction_deg: (R,) mean residual after upward moves less that after downward moves.
        direction, temperature, time, elevation, motion, gravity, covariate: (R,) largest share of the squares
            along a contrast of that kind: of the residual, of the acceleration's magnitude (`gravity`), of
            the reading less the accelerometer's own angle (`motion`).
        p_value: (R,) bound on the chance that white noise shows as much in any contrast.
        residual_deg: (N,) (reading − bias)/scale − θ of each pose, as packed.
    """

    bias_deg: FloatArray
    scale: FloatArray
    rms_deg: FloatArray
    lag1_correlation: FloatArray
    direction_deg: FloatArray
    direction: FloatArray
    temperature: FloatArray
    time: FloatArray
    elevation: FloatArray
    motion: FloatArray
    gravity: FloatArray
    covariate: FloatArray
    p_value: FloatArray
    residual_deg: FloatArray

    @property
    def stands_out(self) -> npt.NDArray[np.bool_]:
        """(R,) whether a diagnosis could find something."""
        return self.p_value <= LEVEL


OF_LINES = ("bias_deg", "scale", "rms_deg")
OF_RUNS = tuple(field.name for field in fields(Screened) if field.name != "residual_deg")


def screen(poses: PackedPoses) -> Screened:
    """Screens runs, all that have as many poses together.

    Args:
        poses: of the runs; the order of a run's poses is that in which they were measured.
    """
    found = {name: np.full(len(poses), np.nan) for name in OF_RUNS}
    residual_deg = np.full(int(poses.first[-1]), np.nan)
    theta_deg = poses.theta_deg
    for runs in _alike(poses.counts):
        rows = poses.first[runs][:, None] + np.arange(poses.counts[runs[0]])
        lines = lines_of(poses, theta_deg, rows)
        residual_deg[rows] = lines.residual_deg
        judged = _of_block(lines) if rows.shape[1] >= FEWEST_POSES else {}
        found_here = {name: getattr(lines, name) for name in OF_LINES} | judged
        for name, values in found_here.items():
            found[name][runs] = values
    return Screened(**found, residual_deg=residual_deg)


def _alike(counts: Intp) -> Iterator[Intp]:
    """Runs of one number of poses each, as many at a time as are worked on together."""
    ordered = np.argsort(counts, kind="stable")
    for same in np.split(ordered, np.flatnonzero(np.diff(counts[ordered])) + 1):
        n = int(counts[same[0]]) if len(same) else 0
        if n > 0:
            at_once = max(1, POSES_AT_ONCE // n)
            yield from (same[k : k + at_once] for k in range(0, len(same), at_once))


def _of_block(lines: Lines) -> dict[str, FloatArray]:
    """(R,) each of `OF_RUNS` but the line's own."""
    block = Block.of(lines)
    shares = channel_shares(block)
    tested = 1 + sum(share.contrasts for share in shares)  # the correlation is one
    p_value = np.minimum(_p_of_correlation(block), np.min([_p_value(share) for share in shares], axis=0))
    by_kind: dict[str, FloatArray] = {}
    for share in shares:
        by_kind[share.kind] = np.maximum(by_kind.get(share.kind, share.largest), share.largest)
    return {
        "lag1_correlation": block.lag1_correlation,
        "direction_deg": block.direction_deg,
        **by_kind,
        "p_value": np.where(lines.is_rounding, 1.0, np.minimum(tested * p_value, 1.0)),
    }


def _p_value(share: Share) -> FloatArray:
    """(R,) chance that white noise has so large a share along one given contrast."""
    left = 1.0 - np.clip(share.largest, 0.0, 1.0)
    if share.columns == 2:
        return np.asarray(left ** ((share.freedom - 2) / 2.0))
    return np.asarray(betainc((share.freedom - 1) / 2.0, 0.5, left))


def _p_of_correlation(block: Block) -> FloatArray:
    """(R,) of a lag-1 correlation as far from what the line leaves of none, either way."""
    off = block.lag1_correlation - block.lag1_expected
    return np.asarray(2.0 * ndtr(-np.abs(off) / block.lag1_std))
