"""A worm's or a scale's error, one period each."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from calrig.calibration.effect import (
    ELEVATION,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.effect_terms import amplitude_and_phase, wave_deg
from calrig.calibration.responses import ANGLE, MOVE, READING, Responses
from calrig.estimation.angles import FloatArray

SHORTEST_PERIOD_DEG = 2.0
LONGEST_PERIOD_DEG = 60.0
SHORTEST_ALIAS_DEG = 1.0
REFINEMENTS = 12


def _scan(r: Responses) -> Iterator[Parameters]:
    arc = float(np.ptp(r.theta_deg))
    if arc < 3 * SHORTEST_PERIOD_DEG:
        return
    shortest = SHORTEST_PERIOD_DEG
    step = grid_step_deg(r.theta_deg)
    if step is not None:
        shortest = max(shortest, 2.0 * step)  # shorter ones look like longer ones on an exact grid
    longest = min(LONGEST_PERIOD_DEG, arc / 1.5)
    if longest > shortest:
        for frequency in np.arange(1.0 / longest, 1.0 / shortest + 1e-9, 1.0 / (3.0 * arc)):
            yield {"period_deg": float(1.0 / frequency)}


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    period_deg = at.get("period_deg", 0.0)
    if period_deg == 0.0:
        return
    here = _waves(r.theta_deg, period_deg)
    felt = here - _waves(r.theta_deg - r.move_deg, period_deg)
    shares = {READING: here, ANGLE: here, MOVE: felt}
    yield Shape(shares, ("amplitude_deg", "phase_deg"), at={"period_deg": period_deg}, scanned=True)


def _waves(theta_deg: FloatArray, period_deg: float) -> FloatArray:
    phase = 2.0 * np.pi * theta_deg / period_deg
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


def _refine(r: Responses, shape: Shape, criterion: Callable[[Shape], float]) -> Shape:
    """The best period between the neighbours of the one scanned."""
    step = 1.0 / (3.0 * float(np.ptp(r.theta_deg)))
    offsets = np.linspace(-1.0, 1.0, REFINEMENTS)
    scanned = shape.at["period_deg"]
    periods = [scanned, *(1.0 / (1.0 / scanned + offset * step) for offset in offsets)]
    return min((finer for period in periods for finer in _forms(r, {"period_deg": period})), key=criterion)


def _evidence(r: Responses, shape: Shape) -> list[str]:
    """Periods that an exact grid of elevations confuses with the one found."""
    step = grid_step_deg(r.theta_deg)
    if step is None:
        return []
    periods = {
        1.0 / frequency
        for k in range(1, 6)
        for sign in (1.0, -1.0)
        if 1.0 / (frequency := abs(sign / shape.at["period_deg"] + k / step)) >= SHORTEST_ALIAS_DEG
    }
    if not periods:
        return []
    listed = ", ".join(f"{p:.2f}°" for p in sorted(periods, reverse=True))
    return [f"on this exact grid of {step:g}° periods of {listed} look the same: jitter the elevations"]


def grid_step_deg(theta_deg: FloatArray) -> float | None:
    """The step of an exact grid of elevations, None where they lie on no grid."""
    places = np.unique(np.round(theta_deg, 2))
    if len(places) < 3 or len(places) > 0.6 * len(theta_deg):
        return None
    steps = np.diff(places)
    step = float(steps.min())
    return step if np.abs(steps / step - np.round(steps / step)).max() < 0.05 else None


EFFECT = Effect(
    name="stage_periodic",
    title="Periodic error of the stage",
    origin="stage",
    scope="rig",
    covariate=ELEVATION,
    parameters=(
        Parameter("amplitude_deg", "Amplitude", "°"),
        Parameter("phase_deg", "Phase", "°"),
        Parameter("period_deg", "Period", "°"),
    ),
    formula="amplitude_deg·sin(360°·θ/period_deg + phase_deg)",
    forms=_forms,
    scan=_scan,
    refine=_refine,
    on_reading_deg=lambda p: wave_deg(p, p.theta_deg / p.value("period_deg", None)),
    in_c=NotInFlight("it belongs to the rig's stage"),
    apart="its period: jittered elevations tell the periods apart that an exact grid confuses",
    remedy="correct by the rig error map; look at the worm and its preload",
    reported=amplitude_and_phase,
    evidence=_evidence,
)
