"""The board's cells: what is wrong, how the run is laid out, what the noise is like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.plan import Plan

from .causes import (
    Draw,
    askew,
    backlash,
    bias_tempco,
    creep,
    cycle,
    drift,
    eccentricity,
    gain,
    gain_tempco,
    kink,
    motor_steps,
    offset,
    offset_anywhere,
    package_turn,
    periodic,
    settling,
    slip,
    slow_heat,
    supply,
    supply_bias,
)
from .layout import timeline
from .physics import Noise, Run, measure

GRID = Plan(start_deg=-60.0, stop_deg=60.0, step_deg=5.0, sweeps=4)
"""100 poses, 4 sweeps, ±60°."""

JITTER_DEG = 2.0
WHITE = Noise()


@dataclass(frozen=True)
class Cell:
    """One row of the board: `kind` is `null`, `one`, `limit`, `two` or `unnamed`."""

    name: str
    kind: str
    draws: tuple[Draw, ...] = ()
    jitter_deg: float = 0.0
    noise: Noise = WHITE

    def run(self, seed: int) -> Run:
        """The run of a seed: the same seed gives the same run on every machine."""
        rng = np.random.default_rng([*self.name.encode(), seed])
        plan = GRID.model_copy(update={"jitter_deg": self.jitter_deg, "seed": int(rng.integers(2**31))})
        causes = [draw(rng, timeline(plan)) for draw in self.draws]
        return measure(plan, causes, self.noise, rng)


CELLS = {
    cell.name: cell
    for cell in (
        Cell("null white", "null"),
        Cell("null t4", "null", noise=Noise("t4")),
        Cell("null AR 0.3", "null", noise=Noise("ar1", 0.3)),
        Cell("null AR 0.6 shared", "null", noise=Noise("shared", 0.6)),
        Cell("null AR 0.6 each", "null", noise=Noise("ar1", 0.6)),
        Cell("backlash 0.08°", "one", (backlash(0.08),)),
        Cell("temperature 0.02 °/°C", "one", (package_turn(0.02),)),
        Cell("bias tempco 0.02 °/°C", "one", (bias_tempco(0.02),)),
        Cell("gain tempco 0.11 %/°C", "one", (gain_tempco(0.11),)),
        Cell("drift 0.12°", "one", (drift(0.12),)),
        Cell("creep 0.08° a decade", "one", (creep(0.08),)),
        Cell("askew by 5°, 2° out of level", "one", (askew(5.0, 2.0),)),
        Cell("slip 0.12°", "one", (slip(0.12),)),
        Cell("periodic 0.06°", "one", (periodic(0.06),), JITTER_DEG),
        Cell("motor steps of 1.8°", "one", (motor_steps(1.8, 0.08),), JITTER_DEG),
        Cell("settling 1 %", "one", (settling(0.01),), JITTER_DEG),
        Cell("offset 2.1 mg", "one", (offset(2.1),)),
        Cell("offset 2.1 mg any axis", "one", (offset_anywhere(2.1),)),
        Cell("offset 2.1 mg |a| 0.52 mg", "one", (offset(2.1),), noise=Noise(norm_mg=0.52)),
        Cell("gain 0.28 %", "one", (gain(0.28),)),
        Cell("eccentricity 0.3°", "one", (eccentricity(0.3),)),
        Cell("limit backlash 0.038°", "limit", (backlash(0.038),)),
        Cell("limit temperature 0.013 °/°C", "limit", (package_turn(0.013),)),
        Cell("limit periodic 0.027°", "limit", (periodic(0.027),), JITTER_DEG),
        Cell("limit slip 0.038°", "limit", (slip(0.038, 0.4, 0.6),)),
        Cell("backlash and temperature", "two", (backlash(0.08), package_turn(0.02))),
        Cell("slip with temperature", "two", (slip(0.12, sense=1.0), package_turn(0.02, sense=1.0))),
        Cell("slip against temperature", "two", (slip(0.12, sense=1.0), package_turn(0.02, sense=-1.0))),
        Cell("backlash and periodic", "two", (backlash(0.08), periodic(0.06)), JITTER_DEG),
        Cell("temperature and a delay of 30 s", "two", (package_turn(0.02), slow_heat(30.0))),
        Cell("supply 0.25 °/V", "unnamed", (supply(0.25),)),
        Cell("supply bias 0.25 °/V", "unnamed", (supply_bias(0.25),)),
        Cell("slow cycle 0.06°", "unnamed", (cycle(0.06),)),
        Cell("kink 0.006 °/°", "unnamed", (kink(0.006),)),
    )
}
