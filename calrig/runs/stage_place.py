"""Where a stage stands that cannot look for its reference, from one process to the next.

Opening its port resets an Arduino, and its count begins anew wherever the table is. So the store remembers
where it was left, and as not known from before each move until it has come to stand.
"""

from __future__ import annotations

import logging

from calrig.analysis.errors import NotTheSame
from calrig.analysis.known_calibration import known_calibration
from calrig.estimation.angles import wrap_deg
from calrig.instruments.axis import Axis
from calrig.instruments.errors import InstrumentError, StageError
from calrig.runs.mounting import Mount
from calrig.settings import RigSettings
from calrig.store import Store

log = logging.getLogger(__name__)

MOST_OFF_DEG = 10.0
"""A unit's offsets before any calibration turn its gravity by half of this."""
SAY_SO = (
    'turn the stage by hand to an elevation that you know and say which: "The stage stands at" where the '
    "page starts a run, `calrig run --stage-at DEGREES`, or `stage_at_deg` of POST /api/runs"
)


class StagePlace:
    """One rig's stage. It writes nothing of a stage that can home.

    Args:
        store: remembers.
        rig: as configured.
        unit: the serial number of the unit on it.
        resumes: whether its run was interrupted, and can be resumed later where it cannot now.
    """

    def __init__(self, store: Store, rig: RigSettings, unit: str, *, resumes: bool) -> None:
        self._store, self._rig, self._unit = store, rig, unit
        self._refusal = NotTheSame if resumes else StageError
        self._remembers = False

    def take_up(self, axis: Axis, *, homes: bool) -> None:
        """Tells the axis where its stage was left, before anything moves.

        Raises:
            StageError: it was left on its way, and nobody knows where.
        """
        self._remembers = not homes
        left = None if homes else self._store.left_at(self._rig.name)
        if left is None:
            return
        if left.stage_deg is None:
            raise StageError(
                f"rig {self._rig.name!r}: its stage has no homing, and was left on its way or lost steps: "
                f"where it stands is not known; nothing was moved: {SAY_SO}"
            )
        zero_deg, gain = _of(self._rig)
        axis.stands_at((left.stage_deg - zero_deg) / gain)

    def check_gravity(self, stage_deg: float, felt_deg: float, mount: Mount) -> None:
        """Holds where a stage without homing is said to stand against the gravity that the unit feels there.

        Args:
            stage_deg: elevation, as the stage says.
            felt_deg: elevation, by the unit's accelerometer.
            mount: how the unit is clamped.

        Raises:
            StageError: they differ by more than the unit's known bias and `MOST_OFF_DEG`.
            NotTheSame: likewise, of a run that was interrupted.
        """
        if not self._remembers:
            return
        expected_deg = self._expected_deg(stage_deg, mount)
        if abs(wrap_deg(felt_deg - expected_deg)) <= MOST_OFF_DEG:
            return
        raise self._refusal(
            f"rig {self._rig.name!r}: the stage is said to stand at {stage_deg:.1f}°, where the unit should "
            f"read {expected_deg:.1f}°, and gravity says {felt_deg:.1f}°; nothing was moved: see that the "
            f"unit sits as it should, then {SAY_SO}"
        )

    def leaves(self) -> None:
        """A motion is about to be sent: until it has ended, nobody knows."""
        if self._remembers:
            self._store.leave_at(self._rig.name, None)

    def stands(self, elevation_deg: float) -> None:
        """It has come to stand."""
        if self._remembers:
            leave_at(self._store, self._rig, elevation_deg)

    def is_lost(self) -> None:
        """The stage is not where it says."""
        self.leaves()
        self._remembers = False

    def was_stopped(self, axis: Axis) -> None:
        """It was halted, maybe on its way; where it can tell where that is, that is kept."""
        if not self._remembers:
            return
        try:
            self.stands(axis.elevation_deg())
        except InstrumentError as error:
            log.warning("where the stage of rig %r was left is not known: %s", self._rig.name, error)
            self.leaves()

    def _expected_deg(self, stage_deg: float, mount: Mount) -> float:
        """What the unit reads there by its calibration in force; the elevation, if none is of this rig."""
        theta_deg = wrap_deg(mount.felt_at(stage_deg))
        known = known_calibration(self._store, self._unit)
        if known is None or known.run.rig != self._rig.name or mount.axis != "x":
            return theta_deg
        return float(known.result["bias_deg"] + known.result["scale"] * theta_deg)


def leave_at(store: Store, rig: RigSettings, elevation_deg: float) -> None:
    """Keeps at which elevation a rig's stage stands: by its own word, or by a person's who looked."""
    zero_deg, gain = _of(rig)
    store.leave_at(rig.name, zero_deg + gain * elevation_deg)


def _of(rig: RigSettings) -> tuple[float, float]:
    """The stage's own angle at elevation 0, and its degrees per degree of elevation."""
    if rig.stage is None:
        return 0.0, 1.0
    return rig.stage.zero_deg, rig.stage.sign * rig.stage.ratio
