"""Where a stage stands that cannot look for its reference, from one process to the next.

Opening its port resets an Arduino, and its count begins anew wherever the table is. So the store remembers
where it was left, and as not known from before each move until it has come to stand. What a person says of
it counts for one run, and is stored once the unit's gravity agrees.
"""

from __future__ import annotations

import logging

from calrig.analysis.errors import Conflict, Invalid, NotTheSame
from calrig.analysis.known_calibration import known_calibration
from calrig.estimation.angles import wrap_deg
from calrig.instruments.axis import Axis
from calrig.instruments.errors import InstrumentError, StageError
from calrig.runs.mounting import Mount
from calrig.settings import RigSettings
from calrig.store import Run, Store

log = logging.getLogger(__name__)

MOST_OFF_DEG = 10.0
"""A unit's offsets before any calibration turn its gravity by half of this."""
SAY_SO = "turn the stage by hand to an elevation that you know and say which"
STARTED_BY = (
    f'{SAY_SO}: "The stage stands at" where the page starts a run, `calrig run --stage-at DEGREES`, or '
    "`stage_at_deg` of POST /api/runs"
)


class StagePosition:
    """One rig's stage. It writes nothing of a stage that can home.

    Args:
        store: remembers.
        rig: as configured.
        run: that moves it.
        said_deg: a person's word for the elevation at which it stands; None where nobody said.
        resumes: whether the run was interrupted, and can be resumed later where it cannot now.
    """

    def __init__(
        self, store: Store, rig: RigSettings, run: Run, said_deg: float | None, *, resumes: bool
    ) -> None:
        self._store, self._rig, self._unit, self._said_deg = store, rig, run.unit, said_deg
        self._refusal = NotTheSame if resumes else StageError
        self._say_so = resumed_by(run.id) if resumes else STARTED_BY
        self._remembers = False

    def take_up(self, axis: Axis, *, homes: bool) -> None:
        """Tells the axis where its stage stands, by a person's word or as it was left, before anything moves.

        Raises:
            StageError: it was left on its way, and nobody knows where.
        """
        self._remembers = not homes
        if homes:
            return
        if self._said_deg is not None:
            axis.stands_at(self._said_deg)
            return
        left = self._store.positions.of(self._rig.name)
        if left is None:
            return
        if left.stage_deg is None:
            raise StageError(
                f"rig {self._rig.name!r}: its stage has no homing, and was left on its way or lost steps: "
                f"where it stands is not known; nothing was moved: {self._say_so}"
            )
        zero_deg, gain = _of(self._rig)
        axis.stands_at((left.stage_deg - zero_deg) / gain)

    def check_gravity(self, stage_deg: float, felt_deg: float, mount: Mount) -> None:
        """Holds where a stage without homing is said to stand against the gravity that the unit feels there.

        Stores it where they agree.

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
            self.stands(stage_deg)
            return
        raise self._refusal(
            f"rig {self._rig.name!r}: the stage is said to stand at {stage_deg:.1f}°, where the unit should "
            f"read {expected_deg:.1f}°, and gravity says {felt_deg:.1f}°; nothing was moved: see that the "
            f"unit sits as it should, then {self._say_so}"
        )

    def leaves(self) -> None:
        """A motion is about to be sent: until it has ended, nobody knows."""
        if self._remembers:
            self._store.positions.save(self._rig.name, None)

    def stands(self, elevation_deg: float) -> None:
        """It has come to stand."""
        if self._remembers:
            zero_deg, gain = _of(self._rig)
            self._store.positions.save(self._rig.name, zero_deg + gain * elevation_deg)

    def is_lost(self) -> None:
        """The stage is not where it says."""
        self.leaves()
        self._remembers = False

    def doubted(self, why: NotTheSame) -> NotTheSame:
        """What a resumed run is to say whose unit reads otherwise than before; the place is not stored."""
        if not self._remembers:
            return why
        self.is_lost()
        return NotTheSame(f"{why}; where the stage did not stand as it was said to, {self._say_so}")

    def was_stopped(self, axis: Axis) -> None:
        """It was halted, maybe on its way; where it can tell where that is, that is kept."""
        if not self._remembers:
            return
        try:
            self.stands(axis.elevation_deg())
        except InstrumentError:  # why, the run's own failure says
            log.warning("where the stage of rig %r was left is not known", self._rig.name)
            self.leaves()

    def _expected_deg(self, stage_deg: float, mount: Mount) -> float:
        """What the unit reads there by its calibration in force; the elevation, if none is of this rig."""
        theta_deg = wrap_deg(mount.felt_at(stage_deg))
        known = known_calibration(self._store, self._unit)
        if known is None or known.run.rig != self._rig.name or mount.axis != "x":
            return theta_deg
        return known.result.bias_deg + (known.result.scale or 1.0) * theta_deg


def resumed_by(run_id: str) -> str:
    """How a person says where the stage of an interrupted run stands."""
    return (
        f'{SAY_SO}: "The stage stands at" where the page resumes the run, `calrig resume {run_id} --stage-at '
        f"DEGREES`, or `stage_at_deg` of POST /api/runs/{run_id}/resume; or end the run"
    )


def check_stage_at(run: Run, stage_at_deg: float | None) -> None:
    """Sees that a person's word on where a stage stands is one that resuming a run can take.

    Raises:
        Conflict: the run is not interrupted: its stage's place is known, or others move it before.
        Invalid: its stage can home.
    """
    if stage_at_deg is None:
        return
    if run.status != "interrupted":
        raise Conflict(f"run {run.id} is {run.status}, not interrupted: resume it without stage_at_deg")
    if _homes(run):
        raise Invalid(
            f"the stage of run {run.id} has homing and finds its place by itself: resume it without "
            "stage_at_deg",
            ["stage_at_deg"],
        )


def is_lost_since(store: Store, run: Run) -> bool:
    """Whether a run's stage has no homing, and was left on its way or lost steps."""
    left = None if run.rig is None or _homes(run) else store.positions.of(run.rig)
    return left is not None and left.stage_deg is None


def _homes(run: Run) -> bool:
    """Whether a run's stage has said that it can home; one that has not been asked yet has not."""
    return bool((run.provenance.get("stage") or {}).get("homes"))


def _of(rig: RigSettings) -> tuple[float, float]:
    """The stage's own angle at elevation 0, and its degrees per degree of elevation."""
    if rig.stage is None:
        return 0.0, 1.0
    return rig.stage.zero_deg, rig.stage.sign * rig.stage.ratio
