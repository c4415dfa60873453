"""The stage's error of angle: a harmonic series of the dial angle, and the backlash.

    map(ψ, approach) = Σ (a_k·cos kψ + b_k·sin kψ) + backlash/2·approach

There is no k = 0: a constant is the mounts'. An order need be no whole number: a worm of period P has 360/P.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.estimation.angles import FloatArray

TURN_DEG = 360.0
HIGHEST_ORDER = 24
LARGEST_RAD = np.radians(8.0)
"""Amplitudes of 0.1° to 8° are on record of real axes."""
LARGEST_BACKLASH_RAD = np.radians(5.0)
ROUND_DEG = 330.0
"""Dial angles over such an arc go round: the orders of the turn come apart."""
SAME_DIAL_DEG = 0.01
GRID_DEG = 2.0


def basis(dial_deg: FloatArray, approach: FloatArray, orders: Sequence[float]) -> FloatArray:
    """(n, 2m + 1) columns of the map: cosine and sine of each order, then half the approach."""
    turn = np.radians(dial_deg)[:, None] * np.asarray(orders, dtype=np.float64)
    waves = np.stack([np.cos(turn), np.sin(turn)], axis=2).reshape(len(dial_deg), -1)
    return np.concatenate([waves, 0.5 * approach[:, None]], axis=1)


def goes_round(dial_deg: FloatArray) -> bool:
    """Whether the angles leave no wide gap on the dial."""
    return widest_gap_deg(dial_deg) <= TURN_DEG - ROUND_DEG


def widest_gap_deg(dial_deg: FloatArray) -> float:
    """Of the dial, what no pose stands in."""
    at = np.sort(np.mod(dial_deg, TURN_DEG))
    return float(np.diff(at, append=at[0] + TURN_DEG).max())


def resolved_orders(dial_deg: FloatArray) -> list[float]:
    """Whole orders of a map that such poses can tell, all together."""
    highest = min(HIGHEST_ORDER, highest_identifiable_order(dial_deg), (len(_apart(dial_deg)) - 1) / 2.0)
    return [float(order) for order in range(1, int(highest) + 1)]


def highest_identifiable_order(dial_deg: FloatArray) -> float:
    """The highest order that such poses can tell by itself: half the density of the angles."""
    arc_deg = TURN_DEG - widest_gap_deg(dial_deg)
    spacing_deg = max(arc_deg, SAME_DIAL_DEG) / max(len(_apart(dial_deg)) - 1, 1)
    return (TURN_DEG / spacing_deg - 1.0) / 2.0


def _apart(dial_deg: FloatArray) -> FloatArray:
    """The angles that are not the same, in steps of what is."""
    return np.unique(np.round(np.mod(dial_deg, TURN_DEG) / SAME_DIAL_DEG))


def dial_grid_deg(dial_deg: FloatArray) -> FloatArray:
    """(m,) angles over the part of the dial where poses stood: a turn once, an arc with both its ends."""
    if goes_round(dial_deg):
        return np.arange(-TURN_DEG / 2.0, TURN_DEG / 2.0, GRID_DEG)
    low, high = dial_deg.min(), dial_deg.max()
    if high - low >= TURN_DEG:  # an arc across the turn's end, counted from where no pose stood
        at = np.sort(np.mod(dial_deg, TURN_DEG))
        first = int(np.diff(at, append=at[0] + TURN_DEG).argmax()) + 1
        low = at[first % len(at)]
        high = low + TURN_DEG - widest_gap_deg(dial_deg)
    return np.linspace(low, high, max(round((high - low) / GRID_DEG), 1) + 1)
