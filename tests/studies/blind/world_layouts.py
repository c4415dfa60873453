"""How the runs of the worlds are laid out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .layout import Layout


def grid(
    step_deg: float, sweeps: int, jitter_deg: float, end_deg: float = 60.0
) -> Callable[[np.random.Generator], Layout]:
    """To and fro between two ends, jittered."""

    def of(rng: np.random.Generator) -> Layout:
        way = np.arange(-end_deg, end_deg + 1e-9, step_deg)
        return _swept([way if sweep % 2 == 0 else way[::-1] for sweep in range(sweeps)], rng, jitter_deg)

    return of


def _swept(sweeps: list[np.ndarray], rng: np.random.Generator, jitter_deg: float) -> Layout:
    targets = np.concatenate(sweeps)
    targets = np.round(targets + rng.uniform(-jitter_deg, jitter_deg, len(targets)), 6)
    return Layout(targets, np.repeat(np.arange(len(sweeps)), [len(way) for way in sweeps]))


def one_turn(rng: np.random.Generator) -> Layout:
    """Round and back."""
    way = np.arange(0.0, 360.0, 8.0)
    return _swept([way, way[::-1]], rng, 2.0)


def table_of_angles(rng: np.random.Generator) -> Layout:
    """One turn, sorted by the angle."""
    way = np.sort(rng.uniform(0.0, 360.0, 120))
    return Layout(way, np.zeros(len(way)))


def eleven_turns(rng: np.random.Generator) -> Layout:
    """Eleven turns and back, at angles that come as they come."""
    out, back = (np.sort(rng.uniform(0.0, 11.0 * 360.0, 100)) for _ in range(2))
    return Layout(np.concatenate([out, back[::-1]]), np.repeat([0, 1], 100), velocity_dps=90.0)


def nearly_even(rng: np.random.Generator) -> Layout:
    """Round and back in steps of 6° ± 0.3°."""
    way = np.arange(0.0, 360.0, 6.0)
    return _swept([way, way[::-1]], rng, 0.3)


def irregular(rng: np.random.Generator) -> Layout:
    """Any elevation in any order, with pauses between."""
    return Layout(rng.uniform(-60.0, 60.0, 100), np.zeros(100), wait_s=rng.exponential(4.0, 100))


def stroke(rng: np.random.Generator) -> Layout:
    """One turn at constant speed: angle and time are one thing."""
    return Layout(np.array([0.0, 362.0]), np.zeros(1), velocity_dps=6.0, every_s=0.45)


def to_and_fro(rng: np.random.Generator) -> Layout:
    """Strokes of a turn at constant speed."""
    return Layout(np.array([0.0, 360.0, 0.0, 360.0, 0.0]), np.zeros(1), velocity_dps=30.0, every_s=0.4)


def with_weather(rng: np.random.Generator) -> Layout:
    """The first board's, with columns that calrig has no physics for, each in a unit of its own."""
    layout = grid(5.0, 4, 2.0)(rng)
    n = len(layout.target_deg)
    slow = np.cumsum(rng.normal(0.0, 1.0, (2, n)), axis=1)
    columns = {
        "azimuth_deg": rng.uniform(0.0, 360.0, n),
        "humidity_pct": 45.0 + 1.5 * slow[0] + rng.normal(0.0, 0.5, n),
        "pressure_hpa": 1013.0 + 0.2 * slow[1],
        "wind_mps": rng.gamma(2.0, 1.5, n),
        "fan_rpm": 1200.0 + rng.normal(0.0, 15.0, n),
    }
    return replace(layout, columns=columns)
