"""What the screen of a fleet scans for in each run: a step, a cycle in the order of poses, a wave."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft

from calrig.estimation.angles import FloatArray

Float32 = npt.NDArray[np.float32]
Complex64 = npt.NDArray[np.complex64]
Intp = npt.NDArray[np.intp]
TINY = np.finfo(np.float32).tiny
BEYOND = 5
"""Times the waves that as many places spread evenly resolve: as far as the diagnosis searches periods."""
NO_ARC = 1e-6
"""Below it the poses are at one elevation."""
PLACES = 8
"""Of the grid to a half period of the shortest wave, in two arcs: on the nearest of them it loses 5 %."""
FEWEST_BESIDE = 2
"""Poses on either side of a step."""
SINGULAR = 0.05
"""Of the square of the poses: a wave whose sine and cosine are as alike as that counts as one column."""
SHORTEST = 0.05
"""Squared length of a step that bias and scale nearly explain, below which it is no contrast."""


def steps(channel: Float32, tilted: Float32, squares: FloatArray) -> tuple[FloatArray, int]:
    """The largest share of squares along a step after any pose, bias and scale fitted beside it.

    Args:
        channel: (R, m) residuals that bias and scale have no part in any more.
        tilted: (R, m) the unit column of scale.
        squares: (R,) of the channel.

    Returns:
        (R,) the share, and how many contrasts were looked along.
    """
    m = channel.shape[1]
    k = np.arange(1, m)
    left = np.cumsum(channel, axis=1)[:, :-1]
    length = (k * (m - k) / m).astype(np.float32) - np.cumsum(tilted, axis=1)[:, :-1] ** 2
    inner = slice(FEWEST_BESIDE - 1, m - FEWEST_BESIDE)
    shares = left[:, inner] ** 2 / np.maximum(length[:, inner], SHORTEST)
    return shares.max(axis=1) / np.maximum(squares, TINY), shares.shape[1]


def cycles(channel: Float32, squares: FloatArray) -> tuple[FloatArray, int]:
    """The largest share along a cycle of whole half periods in the order of the poses; as `waves`."""
    m = channel.shape[1]
    seen = fft.rfft(channel, 2 * m, axis=1)[:, 1:m]
    doubled = fft.fft(np.ones(m), 2 * m)[2::2].astype(np.complex64)
    return _along(seen, doubled, m).max(axis=1) / np.maximum(squares, TINY), m - 1


def waves(channel: Float32, theta: Float32, squares: FloatArray) -> tuple[FloatArray, Intp]:
    """The largest share along a wave over elevation, of any whole number of half periods in the arc.

    Lomb's periodogram (Astrophysics and Space Science 39, 1976) by two fast transforms, of the residuals and
    of the poses, each laid on the nearest place of a fine grid. What bias and scale take of a wave is not
    added back, so that the share is at most what it is beside them.

    Args:
        channel: (R, m) residuals.
        theta: (R, m) elevations, in any unit.
        squares: (R,) of the channel.

    Returns:
        (R,) the share, and how many contrasts were looked along in each run: poses at few elevations tell
        fewer waves apart.
    """
    runs, m = channel.shape
    n_waves = BEYOND * m
    n_grid = fft.next_fast_len(PLACES * n_waves, real=True)
    least = theta.min(axis=1)[:, None]
    arc = theta.max(axis=1)[:, None] - least
    arc = np.where(arc > NO_ARC, arc, np.float32(1.0))
    place = np.rint((theta - least) * ((n_grid // 2 - 1) / arc)).astype(np.intp)
    place += n_grid * np.arange(runs)[:, None]

    def on_grid(values: Float32 | None) -> Float32:
        weights = None if values is None else values.ravel()
        laid = np.bincount(place.ravel(), weights, runs * n_grid).reshape(runs, n_grid)
        return laid.astype(np.float32)

    poses = on_grid(None)
    resolved = BEYOND * np.count_nonzero(poses, axis=1)
    seen = fft.rfft(on_grid(channel), axis=1)[:, 1 : n_waves + 1]
    shares = _along(seen, fft.rfft(poses, axis=1)[:, 2 : 2 * n_waves + 1 : 2], m)
    shares[np.arange(n_waves) >= resolved[:, None]] = 0.0
    return shares.max(axis=1) / np.maximum(squares, TINY), resolved


def _along(seen: Complex64, doubled: Complex64, m: int) -> FloatArray:
    """(R, w) sums of squares along w waves, each by least squares of its sine and cosine.

    Args:
        seen: (R, w) Σ e·exp(−ix) over the m poses of a run, at the phases x of a wave.
        doubled: (R, w) or (w,) Σ exp(−2ix).
        m: how many poses.
    """
    a, b, c2, s2 = seen.real, seen.imag, doubled.real, doubled.imag
    both = a * a + b * b
    determinant = m * m - (c2 * c2 + s2 * s2)
    fitted = 2.0 * (m * both - c2 * (a * a - b * b) - 2.0 * s2 * a * b)
    is_pair = determinant > SINGULAR * m * m
    return np.where(is_pair, fitted / np.maximum(determinant, 1.0), both / m)
