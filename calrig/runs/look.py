"""What a look at a rig's board gave, and what that says of the unit which is asked for.

The two are apart because they may be on two machines: the look is a bench's, the question its centre's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calrig.estimation.angles import wrap_deg
from calrig.instruments.types import BoardIdentity, Samples
from calrig.runs.mounting import Mount, angle_about_deg
from calrig.runs.stage_place import MOST_OFF_DEG

MOVES_G, MOVES_DPS, MOVES_DEG = 0.03, 2.0, 1.0
"""Standard deviation over a look of a unit that somebody has in hand; one at rest has a tenth of it."""
WEIGHT_G = (0.8, 1.2)
"""What a healthy accelerometer feels of gravity."""

State = Literal["looking", "absent", "moving", "askew", "wrong", "there"]


@dataclass(frozen=True, slots=True)
class Sighting:
    """What is seen of a unit on a rig.

    Attributes:
        state: `absent` where no board answers, `askew` where gravity contradicts; never `wrong` by itself.
        serial: by the board's own word; "" where it has none, None where no board answers.
        says: the same for a person; of a unit that is there, how gravity finds it.
    """

    state: State
    serial: str | None
    says: str

    def of_unit(self, unit: str) -> Sighting:
        """The same, where that unit is to be there."""
        if self.serial and self.serial != unit:
            return Sighting("wrong", self.serial, f"The board says that it is {self.serial}, not {unit}.")
        if self.state != "there":
            return self
        known = f"{unit} is there, says its board."
        if not self.serial:
            known = f"A unit is there; its board has no serial: see that it is {unit}."
        return replace(self, says=f"{known} {self.says}")


@dataclass(frozen=True, slots=True)
class Look:
    """What the last look at a rig's board gave. Without a serial or a trouble: nothing yet.

    Attributes:
        serial: by the board's own word; "" where it has none, None where no board has answered.
        trouble: why none answers.
        accel_g: mean specific force; None of a board that sends an angle of its own.
        own_deg: that angle, whose zero may be anywhere.
        moves: whether somebody has the unit in hand.
        stage_deg: elevation at which the last run left the stage; None where that is not known.
    """

    serial: str | None = None
    trouble: str | None = None
    accel_g: tuple[float, float, float] | None = None
    own_deg: float | None = None
    moves: bool = False
    stage_deg: float | None = None

    def sighting(self, mount: Mount) -> Sighting:
        """What it says of a unit that is to be clamped so."""
        if self.serial is None:
            if self.trouble is None:
                return Sighting("looking", None, "Looking for the unit's board.")
            return Sighting("absent", None, f"No unit answers: {self.trouble}")
        if self.moves:
            return Sighting("moving", self.serial, "The unit is being moved.")
        if self.accel_g is None:
            return self._still("its own reckoning", self.own_deg or 0.0)
        return self._by_gravity(np.array(self.accel_g), mount)

    def _by_gravity(self, accel_g: np.typing.NDArray[np.float64], mount: Mount) -> Sighting:
        weight_g, angle_deg = float(np.linalg.norm(accel_g)), angle_about_deg(mount.axis, accel_g)
        if not WEIGHT_G[0] < weight_g < WEIGHT_G[1]:
            return self._askew(
                f"Its accelerometer feels {weight_g:.2f} g at rest, not 1 g: it is broken, or its range "
                "another."
            )
        agreeing_deg = mount.sense * angle_deg - mount.deg
        if refusal := mount.refusal(agreeing_deg, angle_deg, accel_g):
            return self._askew(f"{refusal[0].upper()}{refusal[1:]}.")
        stage_deg = self.stage_deg
        if stage_deg is not None and abs(mount.clamped_at(stage_deg, angle_deg) - mount.deg) > MOST_OFF_DEG:
            return self._askew(
                f"Gravity finds the unit at {angle_deg:.1f}°. Clamped as asked it would be at "
                f"{wrap_deg(mount.felt_at(stage_deg)):.1f}°, if the stage still stands at {stage_deg:.1f}° "
                "where the last run left it."
            )
        return self._still("gravity", angle_deg)

    def _askew(self, says: str) -> Sighting:
        return Sighting("askew", self.serial, says)

    def _still(self, by: str, angle_deg: float) -> Sighting:
        return Sighting("there", self.serial, f"It sits still, by {by} at {angle_deg:z.1f}°.")


def felt(identity: BoardIdentity, samples: Samples, stage_deg: float | None) -> Look:
    """What a board's word and its samples of a moment are.

    Args:
        identity: of the board.
        samples: of a moment.
        stage_deg: elevation at which the stage was left; None where that is not known.
    """
    accel_g = samples.accel_g.mean(axis=0)
    if np.isnan(accel_g).any():
        turns = np.exp(1j * np.radians(samples.angle_deg))
        moves = np.degrees(np.angle(turns / turns.mean())).std() > MOVES_DEG
        own_deg = float(np.degrees(np.angle(turns.mean())))
        return Look(identity.serial, own_deg=own_deg, moves=bool(moves), stage_deg=stage_deg)
    spread_dps = float(np.nan_to_num(samples.gyro_dps.std(axis=0)).max())
    moves = samples.accel_g.std(axis=0).max() > MOVES_G or spread_dps > MOVES_DPS
    x_g, y_g, z_g = accel_g.tolist()
    return Look(identity.serial, accel_g=(x_g, y_g, z_g), moves=bool(moves), stage_deg=stage_deg)
