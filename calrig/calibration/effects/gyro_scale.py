"""The gyro's own scale error, as far as the filter still shows it in the dwell after a move."""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.channels import MOVE, READING
from calrig.calibration.regression.effect import LAST_MOVE, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import within

LARGEST_GAIN_PCT = 15.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.1: ±3 %, and ±2 % over temperature; three times
their sum."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if MOVE in r.channels and np.abs(r.move_deg).max() > 0.0:
        moved = r.move_deg / 100.0
        yield Shape({READING: r.kappa * moved, MOVE: moved}, ("gain_pct",), replaces=f"{MOVE}.gain")


EFFECT = Effect(
    name="gyro_scale",
    title="Scale error of the gyro",
    origin="sensor",
    scope="unit",
    covariate=LAST_MOVE,
    parameters=(Parameter("gain_pct", "Gain error", "%"),),
    formula="κ·gain_pct/100·move, κ what the filter still shows of the move's error in the dwell",
    forms=_forms,
    on_reading_deg=lambda p: p.column("kappa") * p.value("gain_pct") / 100.0 * p.moved_deg(),
    in_c=NotInFlight("it is seen only after a move: a standing unit needs no correction for it"),
    apart="the gyro's own integral over the move is wrong by the same factor",
    remedy="correct the gyro's scale in the filter, or settle longer",
    possible=within(gain_pct=LARGEST_GAIN_PCT),
)
