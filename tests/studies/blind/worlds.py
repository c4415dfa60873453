"""Worlds: other rigs than the board's first one, each with effects that its poses can show, and with none.

Every effect is five times as large as the least that the world's poses and noise can show (`limits.py`), but
where its size is said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .causes import (
    backlash,
    bias_tempco,
    creep,
    drift,
    gain,
    gain_tempco,
    package_turn,
    periodic,
    settling,
    slip,
)
from .layout import Layout, timeline
from .limits import Part
from .physics import Noise, Run, measure, surroundings
from .world_causes import circle_of, late, linear_in, offset_of_y, step_in, turn_of
from .world_layouts import (
    eleven_turns,
    grid,
    irregular,
    nearly_even,
    one_turn,
    stroke,
    table_of_angles,
    to_and_fro,
    with_weather,
)

Nuisance = Callable[[np.random.Generator], Mapping[str, Any]]
GYRO = ("gyro_move_deg",)
WITNESSES = ("accel_x_g", "accel_y_g", "accel_z_g", *GYRO)
HISTORY = ("sweep", "approach", "time_s", "temperature_c", "settle_s")
MOVING = ("settle_s", *GYRO)
WHOLE_TURN: Mapping[str, Any] = {"mechanics": {"scale_error_pct": 0.0}}
"""An axis that goes round comes back to where it was: it has no error of scale."""
WHITE = Noise()
QUIET = Noise(reading_deg=0.005, norm_mg=0.05, move_deg=0.0033)
LOUD = Noise(reading_deg=0.3, norm_mg=3.0, move_deg=0.2)


@dataclass(frozen=True)
class World:
    """One rig, or one way to measure.

    Attributes:
        name: of the world.
        layout: of a run.
        cells: what is wrong in them, by name.
        noise: of the poses.
        lacks: what no pose of this world has.
        around: of the simulator's parts, other than on the first board.
        unit: what else there is of a unit, drawn for each run.
        nulls: of `NULLS`, those that are nulls here.
        dear: whether a diagnosis takes so long that few runs are made.
    """

    name: str
    layout: Callable[[np.random.Generator], Layout]
    cells: Mapping[str, tuple[Part, ...]]
    noise: Noise = WHITE
    lacks: tuple[str, ...] = ()
    around: Mapping[str, Any] = field(default_factory=dict)
    unit: Nuisance = lambda _rng: {}
    nulls: tuple[str, ...] = ("nothing", "nothing, AR(1) 0.6")
    dear: bool = False

    def run(self, cell: str, seed: int, only: int | None = None) -> Run:
        """The run of a seed in a cell; with `only` one of its causes, and the same noise."""
        rng = np.random.default_rng([*self.name.encode(), *cell.encode(), seed])
        layout = self.layout(rng)
        others = surroundings(timeline(layout).duration_s, rng)
        around = _merged(_merged(others, self.around), self.unit(rng))
        parts = self.parts(cell)
        causes = [
            part.cause(layout, self.noise, around, [*self.name.encode(), *cell.encode(), seed, k])
            for k, part in enumerate(parts)
            if only is None or k == only
        ]
        noise = replace(self.noise, **NULLS.get(cell, {}))
        run = measure(layout, causes, noise, rng, around)
        nothing = dict.fromkeys(self.lacks)
        return replace(run, poses=[replace(pose, **nothing) for pose in run.poses])

    def parts(self, cell: str) -> tuple[Part, ...]:
        """What is wrong in a cell."""
        return () if cell in NULLS else self.cells[cell]


NULLS: Mapping[str, Mapping[str, Any]] = {
    "nothing": {},
    "nothing, AR(1) 0.6": {"kind": "ar1", "rho": 0.6},
}
"""Noise alone, white and correlated from pose to pose. Of a table sorted by angle the latter is an error
of the angle, and no null."""


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    return {**base, **{part: {**base.get(part, {}), **values} for part, values in over.items()}}


def _a_unit(rng: np.random.Generator) -> Mapping[str, Any]:
    """Clamped by hand, with a gyro's scale of its own."""
    return {
        "mount": {"offset_deg": float(rng.uniform(-5.0, 5.0))},
        "imu": {"gyro_scale_error_pct": [float(rng.uniform(-3.0, 3.0)), 0.0, 0.0]},
    }


UP = Part(lambda size: slip(size, sense=1.0), 0.1)
WARMER, COOLER = (Part(lambda size, sense=sense: package_turn(size, sense), 0.02) for sense in (1.0, -1.0))
BACKLASH, SLIP, DRIFT = Part(backlash, 0.1), Part(slip, 0.1), Part(drift, 0.1)
TEMPERATURE, SETTLING, GAIN = Part(package_turn, 0.02), Part(settling, 0.01), Part(gain, 0.5)
OFFSET_OF_Y = Part(offset_of_y, 5.0)
PERIODIC = Part(periodic, 0.05)
SHORT = Part(lambda size: periodic(size, (2.2, 4.0)), 0.05)
LONG = Part(lambda size: periodic(size, (30.0, 45.0)), 0.5)
SEVENTH = Part(lambda size: periodic(size, (360.0 / 7.0, 360.0 / 7.0)), 0.05)
WORM = Part(lambda size: periodic(size, (7.2, 7.2)), 0.05)
ORDERS = {f"order {k}": (Part(turn_of(k), 0.1),) for k in (1, 2, 4, 8)}
SEVERAL_ORDERS = tuple(Part(turn_of(k), 0.1) for k in (1, 2, 4, 8))
COMMON = {
    "backlash": (BACKLASH,),
    "slip": (SLIP,),
    "temperature": (TEMPERATURE,),
    "offset of y": (OFFSET_OF_Y,),
}

_ALL = (
    World(
        "first board",
        grid(5.0, 4, 2.0),
        {
            **COMMON,
            "drift": (DRIFT,),
            "creep": (Part(creep, 0.08),),
            "periodic": (PERIODIC,),
            "settling": (SETTLING,),
            "gain": (GAIN,),
            "bias tempco": (Part(bias_tempco, 0.02),),
            "gain tempco": (Part(gain_tempco, 0.1),),
            "slip with temperature": (UP, WARMER),
            "slip against temperature": (UP, COOLER),
        },
    ),
    World(
        "full turn",
        one_turn,
        {
            **ORDERS,
            "orders 1, 2, 4, 8": SEVERAL_ORDERS,
            "backlash": (BACKLASH,),
            "offset of y": (OFFSET_OF_Y,),
        },
        around=WHOLE_TURN,
    ),
    World(
        "a table of angles",
        table_of_angles,
        {**ORDERS, "orders 1, 2, 4, 8": SEVERAL_ORDERS},
        lacks=(*WITNESSES, *HISTORY),
        nulls=("nothing",),
        around=WHOLE_TURN,
    ),
    World(
        "eleven turns",
        eleven_turns,
        {**ORDERS, "gear of seven to a turn": (SEVENTH,), "worm of 7.2°": (WORM,), "backlash": (BACKLASH,)},
        lacks=WITNESSES,
        around=WHOLE_TURN,
    ),
    World(
        "±5°",
        grid(0.5, 4, 0.2, 5.0),
        {"backlash": (BACKLASH,), "slip": (SLIP,), "temperature": (TEMPERATURE,), "periodic": (SHORT,)},
    ),
    World("noise 0.005°", grid(5.0, 4, 2.0), {**COMMON, "periodic": (PERIODIC,), "gain": (GAIN,)}, QUIET),
    World(
        "noise 0.3°",
        grid(5.0, 4, 2.0),
        {name: COMMON[name] for name in ("backlash", "slip", "temperature")} | {"periodic": (LONG,)},
        LOUD,
    ),
    World(
        "20° beside 0.02°",
        one_turn,
        {
            "order 1 of 20°, backlash": (Part(turn_of(1), 0.1, 20.0), Part(backlash, 0.1, 0.02)),
            "slip of 20°, temperature": (Part(slip, 0.1, 20.0), Part(package_turn, 0.02, 0.01)),
        },
        Noise(reading_deg=0.003, norm_mg=0.03, move_deg=0.002),
        around=WHOLE_TURN,
    ),
    World("20 poses", grid(40.0 / 3.0, 2, 2.0), COMMON),
    World(
        "1,000 poses",
        grid(120.0 / 49.0, 20, 1.0),
        {"backlash": (BACKLASH,), "periodic": (PERIODIC,)},
        dear=True,
    ),
    World(
        "no witness",
        grid(5.0, 4, 2.0),
        {**COMMON, "drift": (DRIFT,), "periodic": (PERIODIC,), "gain": (GAIN,)},
        lacks=WITNESSES,
    ),
    World(
        "constant speed, one way",
        stroke,
        {**ORDERS, "orders 1, 2, 4, 8": SEVERAL_ORDERS},
        lacks=(*MOVING, "temperature_c"),
        around=WHOLE_TURN,
    ),
    World(
        "constant speed, to and fro",
        to_and_fro,
        {"backlash": (BACKLASH,), "late": (Part(late, 0.005),), "order 2": ORDERS["order 2"]},
        lacks=MOVING,
        around=WHOLE_TURN,
    ),
    World("irregular", irregular, {**COMMON, "settling": (SETTLING,), "periodic": (PERIODIC,)}),
    World(
        "nearly even",
        nearly_even,
        {name: ORDERS[name] for name in ("order 2", "order 4", "order 8")},
        lacks=GYRO,
        around=WHOLE_TURN,
    ),
    World(
        "several units",
        grid(5.0, 4, 2.0),
        {
            "backlash, each with its tempco": (BACKLASH, TEMPERATURE),
            "one slipped": (SLIP,),
            "offset of y": (OFFSET_OF_Y,),
        },
        unit=_a_unit,
    ),
    World(
        "unknown columns",
        with_weather,
        {
            "azimuth, a circle": (Part(circle_of("azimuth_deg"), 0.1),),
            "humidity": (Part(linear_in("humidity_pct"), 0.01),),
            "pressure, a step": (Part(step_in("pressure_hpa"), 0.1),),
            "backlash": (BACKLASH,),
        },
    ),
)
WORLDS: Mapping[str, World] = {world.name: world for world in _ALL}
HARD: Mapping[tuple[str, str], str] = {
    ("first board", "slip against temperature"): "one cancels the other",
    (
        "eleven turns",
        "worm of 7.2°",
    ): "of a fifth of twice the mean spacing, which is as far as periods are searched",
    ("20° beside 0.02°", "order 1 of 20°, backlash"): "the play is seen through the wave's slope",
    ("irregular", "settling"): "a lag saturates in a long move, so that it is in part a backlash",
}
"""Cells beyond what the diagnosis is made for, and why: judged, and told apart."""
