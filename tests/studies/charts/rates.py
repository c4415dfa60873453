"""Histories by the thousand: runs of a unit whose mean shifts, or does not, after some earlier runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from calrig.calibration.histories.charts import UNIT_CHART, control_chart

Floats = npt.NDArray[np.float64]
Signals = Callable[[Floats, Floats], npt.NDArray[np.bool_]]

EARLIER = (3, 5, 10, 20, 50)
LATER = 12
SOON = 4
SHIFT = 2.0
FREEDOM = (6, 20)
STDS: dict[str, Callable[[int], Floats]] = {
    "equal": np.ones,
    "threefold in every other run": lambda n: np.where(np.arange(n) % 2 == 0, 1.0, 3.0),
    "threefold in the later runs": lambda n: np.where(np.arange(n) < n - LATER, 1.0, 3.0),
    "a third in the later runs": lambda n: np.where(np.arange(n) < n - LATER, 3.0, 1.0),
}
"""Standard deviations of the runs of a history, the last twelve being watched."""


def unit_chart(value: Floats, std: Floats) -> npt.NDArray[np.bool_]:
    """The chart of units, as calrig draws it."""
    return control_chart(value, np.broadcast_to(std**2, value.shape), UNIT_CHART).signals


def pooled_from(freedom: int, *, scored: bool = True) -> Signals:
    """The same with a spread pooled from so many repeats: through Student's t, or as if it were known."""
    rng = np.random.default_rng(freedom)

    def signals(value: Floats, std: Floats) -> npt.NDArray[np.bool_]:
        spread = rng.chisquare(freedom, (len(value), 1)) / freedom
        chart = control_chart(
            value, spread * std**2, UNIT_CHART, np.full(value.shape, float(freedom)) if scored else None
        )
        return chart.signals

    return signals


def individuals(value: Floats, std: Floats) -> npt.NDArray[np.bool_]:
    """I-MR: three sigma limits from mean and moving range of the earlier runs; what is to be done better."""
    earlier = value[..., : value.shape[-1] - LATER]
    mean = earlier.mean(axis=-1, keepdims=True)
    sigma = np.abs(np.diff(earlier, axis=-1)).mean(axis=-1, keepdims=True) / 1.128
    return np.abs(value - mean) > 3.0 * sigma


def false_alarms(signals: Signals, earlier: int, std: Floats, seeds: int, seed: int = 0) -> float:
    """Share of histories with an alarm in the twelve runs after some earlier ones, where nothing changed."""
    value = np.random.default_rng(seed).normal(size=(seeds, earlier + LATER)) * std
    return float(signals(value, std)[:, earlier:].any(axis=1).mean())


def detected(signals: Signals, earlier: int, seeds: int, seed: int = 0) -> float:
    """Share in which a shift by two standard deviations after the earlier runs is seen within four."""
    value = np.random.default_rng(seed).normal(size=(seeds, earlier + LATER))
    value[:, earlier:] += SHIFT
    return float(signals(value, np.ones(earlier + LATER))[:, earlier : earlier + SOON].any(axis=1).mean())
