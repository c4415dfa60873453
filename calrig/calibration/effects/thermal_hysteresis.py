"""What turns with a temperature that lags behind the thermometer's: warming and cooling differ.

A part of thermal resistance R and heat capacity C follows the die by C·R·dD/dt = T − D (Newton's law of
cooling), so that D is T through a first-order lag of lag_s = R·C; it is taken to have settled when a run
begins. One leg of warming cannot tell this from a curve of temperature or a drift: claimed only where the
temperature came back.
"""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.effect import (
    TEMPERATURE,
    Applied,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import one_leg, said_of_one_leg, tilted, warmer_c
from calrig.estimation.angles import BoolArray, FloatArray

LAGS = 10
LARGEST_DEG_PER_C = 1.0
"""Two orders of magnitude above what packages do: more is a lag too short to be seen."""


def _scan(r: Responses) -> Iterator[Parameters]:
    if r.time_s is not None and warmer_c(r, {}) is not None:
        for lag_s in _lags_s(r.time_s, r.starts):
            yield {"lag_s": float(lag_s)}


def _lags_s(time_s: FloatArray, starts: BoolArray) -> FloatArray:
    """From the spacing of the poses to the span of the runs."""
    steps = np.diff(time_s)[~starts[1:]]
    steps = steps[steps > 0.0]
    if not len(steps):
        return np.empty(0)
    return np.geomspace(float(np.median(steps)), float(np.ptp(time_s)), LAGS)


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    lag_s = at.get("lag_s", 0.0)
    if r.time_s is None or warmer_c(r, {}) is None or r.temperature_c is None or lag_s <= 0.0:
        return
    ahead = r.temperature_c - _delayed_c(r.temperature_c, r.time_s, r.starts, lag_s)
    one_way = one_leg(r)
    yield Shape(
        tilted(ahead),
        ("deg_per_c",),
        at={"lag_s": lag_s},
        scanned=True,
        place_cost=1,
        alike=("temperature_curvature", "time_drift") if one_way else (),
        follows="temperature_bias" if one_way else None,  # by itself it is the temperature again
    )


def _delayed_c(temperature_c: FloatArray, time_s: FloatArray, starts: BoolArray, lag_s: float) -> FloatArray:
    """Return (n,) the temperature through the lag, exact where it goes straight from pose to pose."""
    delayed = temperature_c.copy()
    for k in range(1, len(delayed)):
        step_s = time_s[k] - time_s[k - 1]
        if starts[k] or step_s <= 0.0:
            continue
        behind_c = lag_s * (temperature_c[k] - temperature_c[k - 1]) / step_s
        left = delayed[k - 1] - (temperature_c[k - 1] - behind_c)
        delayed[k] = temperature_c[k] - behind_c + left * np.exp(-step_s / lag_s)
    return delayed


def _on_reading_deg(p: Applied) -> FloatArray:
    temperature_c, time_s = p.column("temperature_c"), p.column("time_s")
    starts = np.zeros(len(time_s), dtype=bool)
    ahead = temperature_c - _delayed_c(temperature_c, time_s, starts, p.value("lag_s", None))
    return np.asarray(p.value("deg_per_c") * ahead, dtype=np.float64)


EFFECT = Effect(
    name="thermal_hysteresis",
    title="Delay behind the thermometer",
    origin="sensor",
    scope="run",
    covariate=TEMPERATURE,
    parameters=(
        Parameter("deg_per_c", "Per degree that the thermometer is ahead", "°/°C"),
        Parameter("lag_s", "Time constant of the delay", "s"),
    ),
    formula="deg_per_c·(T − D), D the temperature T through a first-order lag of lag_s: lag_s·dD/dt = T − D",
    forms=_forms,
    scan=_scan,
    place="lag_s",
    on_reading_deg=_on_reading_deg,
    in_c=NotInFlight(
        "it depends on the temperatures before, and on how heat reaches the unit where it flies"
    ),
    apart="warming and cooling differ at one temperature: let it cool back as well",
    remedy="wait until the temperature stands still, or change it slowly against the delay",
    evidence=said_of_one_leg,
    possible=lambda _shape, beta: bool(abs(beta[0]) <= LARGEST_DEG_PER_C),
    together_with=("temperature_bias",),
)
