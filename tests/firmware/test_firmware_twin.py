"""The driver `calrig` and its sketch on ../shared/twin, over a pseudo-terminal: truth, then faults.

The driver, the simulated processor and the sensor share one virtual clock: no busy machine changes a result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import NamedTuple

import numpy as np
import pytest
from firmware_twin import BOOT_S, Twin
from support import running_service
from virtual_time.clock import VirtualClock
from virtual_time.world import SimWire

from calrig.estimation.angles import elevation_deg
from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.errors import BoardError, PortError
from calrig.instruments.types import GAP_PERIODS, Samples
from calrig.plan import Plan
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.stages.smc100 import Smc100

RATE_HZ = 200
GYRO_BIAS_DPS = 1.4
QUIET = f"--mount 10 --anoise 1 --gnoise 0.02 --gbias {GYRO_BIAS_DPS}"
"""A unit at 10° whose samples scatter by less than 0.05°."""
SCATTER_DEG = 0.5
"""No sample is off by so much, unless a bit of it is wrong."""
TURN_DEG = 20.0
TWIN_TURNS_DPS = 60.0
SWITCHED_ON_S = 2.0
"""Longer than the boot loader and the sketch take until samples flow again."""


class Desk(NamedTuple):
    """A twin, a driver on its port, and the time that both live in."""

    twin: Twin
    board: CalrigBoard
    clock: VirtualClock

    def more(self, duration_s: float) -> Samples:
        """The samples since the last call and of this long from now on."""
        until_s = self.clock.now_s() + duration_s
        blocks = []
        while (left_s := until_s - self.clock.now_s()) > 0:
            blocks.append(self.board.take(left_s))
        return Samples.join(blocks)


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    """Time for the driver and the twin; the test takes part in it."""
    clock = VirtualClock()
    with clock.taking_part():
        yield clock


@pytest.fixture
def desk(start_twin: Callable[..., Twin], clock: VirtualClock) -> Iterator[Desk]:
    """A quiet board, identified and streaming."""
    twin = start_twin(clock, QUIET)
    with closing(CalrigBoard.open(twin.port)) as board:
        board.identify()
        board.start(RATE_HZ)
        yield Desk(twin, board, clock)


def assert_readings(samples: Samples, *elevations_deg: float) -> None:
    """Every sample is one of a unit that turns from the first to the last of these elevations, or rests."""
    assert len(samples)
    angle_deg = elevation_deg(samples.accel_g)
    assert angle_deg.min() > min(elevations_deg) - SCATTER_DEG
    assert angle_deg.max() < max(elevations_deg) + SCATTER_DEG
    assert np.abs(np.linalg.norm(samples.accel_g, axis=1) - 1).max() < 0.01
    assert np.abs(samples.accel_g[:, 0]).max() < 0.01
    assert np.abs(samples.temperature_c - 25).max() < 0.1
    if len(set(elevations_deg)) == 1:
        bias_dps = GYRO_BIAS_DPS * np.array([1.0, 0.3, -0.2])
        assert np.abs(samples.gyro_dps - bias_dps).max() < 0.2


def test_identity_start_and_stop(start_twin, clock):
    twin = start_twin(clock, QUIET)
    with closing(CalrigBoard.open(twin.port)) as board:
        identity = board.identify()
        assert (identity.firmware, identity.chip, identity.max_rate_hz) == ("calrig_imu 1.0", "MPU-6050", 400)
        clock.sleep(0.5)
        n_silent = twin.truth().n_sent
        board.start(identity.max_rate_hz)
        clock.sleep(1.0)
        board.stop()
        assert 390 < len(board.take(0.0)) < 420
        n_stopped = twin.truth().n_sent
        clock.sleep(1.0)
        assert twin.truth().n_sent == n_stopped > n_silent
        assert len(board.take(0.0)) == 0
        assert board.faults == {}


@pytest.mark.parametrize("rate_hz", [50, 400])
def test_samples_come_at_the_rate_and_a_rotation_is_measured_as_it_is(start_twin, clock, rate_hz):
    twin = start_twin(clock, QUIET)
    with closing(CalrigBoard.open(twin.port)) as board:
        board.identify()
        board.start(rate_hz)
        desk = Desk(twin, board, clock)
        before, before_deg = desk.more(1.0), twin.truth().elevation_deg
        twin.tell("turn 70")
        moving = desk.more(1.5)
        after, after_deg = desk.more(1.0), twin.truth().elevation_deg
        assert (before_deg, after_deg) == (10.0, 80.0)
        assert board.faults == {}

    all_samples = Samples.join([before, moving, after])
    steps_s = np.diff(all_samples.time_s)
    assert steps_s.mean() == pytest.approx(1 / rate_hz, rel=1e-4)
    assert np.ptp(steps_s) < 1e-4
    assert len(all_samples) == pytest.approx(3.5 * rate_hz, abs=0.1 * rate_hz)
    assert elevation_deg(before.accel_g).mean() == pytest.approx(before_deg, abs=0.02)
    assert elevation_deg(after.accel_g).mean() == pytest.approx(after_deg, abs=0.02)

    bias_dps = before.gyro_dps[:, 0].mean()
    assert bias_dps == pytest.approx(GYRO_BIAS_DPS, abs=0.01)
    turned_deg = np.trapezoid(all_samples.gyro_dps[:, 0] - bias_dps, all_samples.time_s)
    between_samples_deg = TWIN_TURNS_DPS / rate_hz / 2  # its rate jumps there, at either end
    assert turned_deg == pytest.approx(after_deg - before_deg, abs=between_samples_deg + 0.05)
    assert_readings(before, before_deg)
    assert_readings(after, after_deg)


LOST = {"sequence_gap"}


@pytest.mark.parametrize(
    ("break_it", "mend_it", "lasts_s", "counted"),
    [
        ("noise b 0.01", "noise b 0", 2.0, LOST | {"damaged"}),
        ("cut b 40", "truth", 0.5, LOST | {"damaged"}),
        ("mute b 1", "mute b 0", 0.7, LOST),
        ("freeze 1", "freeze 0", 0.7, {"frozen"}),
        ("nack 1", "nack 0", 0.7, LOST | {"board_error"}),
        ("dead 1", "dead 0", 0.7, LOST | {"board_error"}),
    ],
)
def test_each_sample_that_a_fault_takes_is_counted_and_none_is_wrong(
    desk, break_it, mend_it, lasts_s, counted
):
    before = desk.more(0.5)
    desk.twin.tell(break_it)
    desk.twin.tell(f"turn {TURN_DEG:g}")
    during = desk.more(lasts_s)
    desk.twin.tell(mend_it)
    until_mended = desk.more(1.0)
    after = desk.more(0.5)
    truth_deg = desk.twin.truth().elevation_deg

    assert truth_deg == pytest.approx(10 + TURN_DEG)
    assert_readings(before, 10.0)
    assert_readings(Samples.join([before, during, until_mended]), 10.0, truth_deg)
    assert_readings(after, truth_deg)
    kinds = {kind for kind, n in desk.board.faults.items() if n}
    assert {"damaged" if kind in ("crc", "unparsed") else kind for kind in kinds} == counted
    samples = Samples.join([before, during, until_mended, after])
    due = round((samples.time_s[-1] - samples.time_s[0]) * RATE_HZ) + 1
    assert len(samples) + desk.board.faults["sequence_gap"] + desk.board.faults["frozen"] == due


@pytest.mark.parametrize(
    ("break_it", "mend_it", "lasts_s", "counted"),
    [
        ("reset b", "truth", 0.5, "board_reset"),
        ("power b", "truth", 0.5, "board_reset"),
        ("mute b 1", "mute b 0", 1.5, "restarted"),
    ],
)
def test_a_board_that_begins_again_leaves_a_gap_in_time(desk, break_it, mend_it, lasts_s, counted):
    before = desk.more(0.5)
    desk.twin.tell(break_it)
    desk.twin.tell(f"turn {TURN_DEG:g}")
    during = desk.more(lasts_s)
    desk.twin.tell(mend_it)
    after = desk.more(SWITCHED_ON_S)
    truth_deg = desk.twin.truth().elevation_deg

    assert desk.board.faults[counted] >= 1
    assert_readings(before, 10.0)
    samples = Samples.join([before, during, after])
    gaps_s = np.diff(samples.time_s)
    assert np.count_nonzero(gaps_s > GAP_PERIODS / RATE_HZ) == 1
    last_before = int(np.argmax(gaps_s))
    assert_readings(samples.between(0.0, samples.time_s[last_before + 1]), 10.0)
    assert_readings(samples.between(samples.time_s[last_before + 1], np.inf), truth_deg)


def test_a_cable_that_is_pulled_ends_the_port_and_put_back_the_board_is_read_again(desk):
    before = desk.more(0.5)
    assert_readings(before, 10.0)
    desk.twin.tell("unplug b")
    with pytest.raises(PortError, match="went away"):
        while True:
            assert_readings(desk.more(0.1), 10.0)
    desk.twin.tell(f"turn {TURN_DEG:g}")
    with pytest.raises(PortError, match="is it plugged in"):
        CalrigBoard.open(desk.twin.port)
    desk.clock.sleep(TURN_DEG / TWIN_TURNS_DPS + 0.1)
    desk.twin.tell("plug b")
    with closing(CalrigBoard.open(desk.twin.port)) as again:
        again.identify()
        again.start(RATE_HZ)
        assert_readings(Desk(desk.twin, again, desk.clock).more(0.5), desk.twin.truth().elevation_deg)
        assert again.faults == {}, "what was on its way when the cable was pulled is no fault of this port"


def test_a_board_that_opening_its_port_resets_is_waited_for(start_twin, clock):
    twin = start_twin(clock, f"{QUIET} --dtr")
    opened_s = clock.now_s()
    with closing(CalrigBoard.open(twin.port)) as board:
        assert board.identify().chip == "MPU-6050"
        assert BOOT_S < clock.now_s() - opened_s < BOOT_S + 1.0
        board.start(RATE_HZ)
        assert_readings(Desk(twin, board, clock).more(0.5), 10.0)
        assert board.faults == {}


def test_a_board_at_another_baud_rate_is_silent_and_has_no_identity(start_twin, clock):
    twin = start_twin(clock, QUIET)
    clock.sleep(0.5)
    with (
        closing(CalrigBoard.open(twin.port, baudrate=57600)) as board,
        pytest.raises(BoardError, match=r"silent.*baud rate"),
    ):
        board.identify()


def test_a_board_that_does_not_receive_is_not_taken_as_stopped(desk):
    desk.twin.tell("deaf b 1")
    with pytest.raises(BoardError, match="did not acknowledge STOP"):
        desk.board.stop()
    desk.twin.tell("deaf b 0")
    desk.board.stop()


class Coupling:
    """Turns the twin's unit with a simulated table, and breaks something in one dwell after another.

    Args:
        table: its angle is followed.
        twin: the board.
        clock: the time of both.
        faults: a command of the twin for each rest of the table.
        in_dwell_s: how long the table has been at rest then.
    """

    interval_s = 0.002

    def __init__(
        self, table: Bench, twin: Twin, clock: VirtualClock, faults: list[str], in_dwell_s: float
    ) -> None:
        self._table, self._twin, self._clock = table, twin, clock
        self._faults, self._in_dwell_s = faults, in_dwell_s
        self._at_deg, self._still_since_s = 0.0, np.inf

    def emit(self) -> bytes:
        """Follows the table; the twin turns its unit as fast as that."""
        now_s, angle_deg = self._clock.now_s(), self._angle_deg()
        if angle_deg != self._at_deg:
            self._twin.tell(f"turn {angle_deg - self._at_deg:.9f}")
            self._at_deg, self._still_since_s = angle_deg, now_s
        elif self._faults and now_s - self._still_since_s > self._in_dwell_s:
            self._twin.tell(self._faults.pop(0))
            self._still_since_s = np.inf  # until it has moved
        return b""

    def receive(self, data: bytes) -> bytes:
        """Nothing is sent to it."""
        raise NotImplementedError

    def _angle_deg(self) -> float:
        with self._table.lock:
            return float(self._table.mechanics.table(np.array([self._clock.now_s()])).angle_deg[0])


def test_a_run_with_a_fault_in_each_dwell_measures_what_is_true(start_twin, tmp_path):
    motion = {"velocity_dps": 50.0, "acceleration_dps2": 200.0, "homing_velocity_dps": 50.0}
    physics = SimulatorSettings.from_options({"stage": motion})
    table, clock = Bench(physics), VirtualClock()
    mount_deg = 0.8
    faults = ["power b", "cut b 2000", "noise b 0.01"]
    plan = Plan(elevations_deg=[-20.0, 10.0, 40.0], sweeps=1, settle_s=0.5, dwell_s=1.0)
    with ExitStack() as stack:
        twin = start_twin(clock, f"{QUIET} --mount {mount_deg}")
        stage = SimWire(Smc100(physics.stage, table, clock.now_s), "stage", clock)
        coupling = SimWire(Coupling(table, twin, clock, faults, 1.0), "coupling", clock)
        for wire in (stage, coupling):
            stack.callback(wire.stop)
            wire.start()
        stack.callback(clock.stop)
        rig = RigSettings(
            name="twin",
            stage=StageSettings(driver="smc100", port=stage.url),
            imu=BoardSettings(driver="calrig", port=twin.port),
            reference=ReferenceSettings(std_deg=0.29),
        )
        with running_service(tmp_path / "calrig.db", rig) as service:
            run = service.wait(service.start(unit="AS-1", plan=plan).id, 60.0)
    assert run.status == "completed", run.error
    assert run.result.n_poses == 3
    assert run.result.bias_deg == pytest.approx(mount_deg, abs=0.02)
    assert run.result.scale == pytest.approx(1.0, abs=0.001)
    assert run.result.rms_calibrated_deg < 0.02, "no pose holds a wrong sample"
    assert run.result.gyro.bias_dps[0] == pytest.approx(GYRO_BIAS_DPS, abs=0.01)
    assert run.result.gyro.scale == pytest.approx(1.0, abs=0.002)
    assert run.faults["board_reset"] == 1
    assert {"retried_pose", "sequence_gap", "crc", "unparsed"} <= run.faults.keys()
