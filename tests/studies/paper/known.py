"""Table 1 on noise that is known: each kind by itself, and two at once through the simulator's registers."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calrig.noise.allan import allan_curve
from calrig.noise.analysis import analyse
from calrig.noise.coefficients import Coefficient, coefficients
from calrig.noise.resampling import uniform_log
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from tests.noise.test_coefficients import MAKERS, RATE_HZ

from .sensor import COUNTS_PER_DPS

SAMPLES = 2**18
"""44 min at 100 Hz."""
DENSITY, WALK = 0.02, 0.004
"""Of the simulated sensor: one-sided, °/s/√Hz; and °/s/√s."""
LONG_S = 4 * 3600.0


class Row(NamedTuple):
    """A row of Table 1.

    Attributes:
        name: as it is spoken of, with its symbol and unit.
        formula: its Allan deviation, and the slope.
        value: what the noise is made with.
        read_at_s: τ at which the deviation is the coefficient (`factor` times it for flicker's floor).
        factor: the deviation there over the coefficient.
    """

    name: str
    formula: str
    value: float
    read_at_s: float
    factor: float = 1.0


ROWS = {
    "white": Row("white N, °/√s", "N/√τ, −½", 0.014, 1.0),
    "quantisation": Row("quantisation Q, °", "√3·Q/τ, −1", 0.002, math.sqrt(3.0)),
    "random_walk": Row("rate random walk K, °/s/√s", "K·√(τ/3), +½", 0.004, 3.0),
    "ramp": Row("ramp R, °/s²", "R·τ/√2, +1", 0.001, math.sqrt(2.0)),
    "flicker": Row("flicker B, °/s", "B·√(2·ln 2/π), 0", 0.01, 3.0, math.sqrt(2.0 * math.log(2.0) / math.pi)),
}


def table(seed: int = 7) -> str:
    """Each kind as made, read off the curve at the paper's τ, and fitted with two standard errors."""
    head = ["| noise | σ(τ), slope | made with | read at | fitted |", "| --- | --- | --- | --- | --- |"]
    return "\n".join(head + [_row(kind, row, seed) for kind, row in ROWS.items()])


def _row(kind: str, row: Row, seed: int) -> str:
    rate = MAKERS[kind](np.random.default_rng(seed), row.value, SAMPLES)
    curve = allan_curve(uniform_log({"gyro_x_dps": rate}, None, RATE_HZ), "gyro_x_dps")
    at = np.exp(np.interp(math.log(row.read_at_s), np.log(curve.tau_s), np.log(curve.deviation)))
    found = getattr(coefficients(curve, "°/s"), kind)
    read = f"{at / row.factor:.4g} at {row.read_at_s:.2f} s"
    return f"| {row.name} | {row.formula} | {row.value:.4g} | {read} | {_fitted(found)} |"


def _fitted(found: Coefficient | None) -> str:
    if found is None:
        return "not found"
    # a ramp by itself has nothing random in it
    spread = f" ± {2.0 * found.std:.1g}" if found.std > 1e-9 * found.value else ""
    return f"{found.value:.4g}{spread}"


def simulated(seed: int = 7) -> str:
    """White noise and random walk of one simulated gyro, as made and as found in hours of its registers."""
    imu = {"gyro_noise_dps_per_rthz": DENSITY, "gyro_walk_dps_per_rts": WALK}
    bench = Bench(SimulatorSettings.from_options({"seed": seed, "imu": imu}))
    time_s = np.arange(int(LONG_S * RATE_HZ)) / RATE_HZ
    rate = bench.counts(time_s, RATE_HZ)[:, 4] / COUNTS_PER_DPS
    found = analyse({"gyro_x_dps": rate}, time_s).channels["gyro_x_dps"].coefficients
    cells = [
        f"{letter} = {'not found' if one is None else f'{one.value:.5f} ± {2.0 * one.std:.5f}'} ({made:.5f})"
        for letter, one, made in (
            ("N", found.white, DENSITY / math.sqrt(2.0)),
            ("K", found.random_walk, WALK),
        )
    ]
    others = [kind for kind in ("quantisation", "flicker", "ramp") if getattr(found, kind) is not None]
    return f"{', '.join(cells)}, and {', '.join(others) or 'no other kind'}"
