"""One stage with one sensor in its environment, without a serial link: the physics put together."""

import math
import threading
from typing import NamedTuple

import numpy as np

from calrig.simulator.config import EnvironmentOptions, MountOptions, SimulatorSettings
from calrig.simulator.imu import Counts, Imu, LowPass, NoiseSource, Surroundings, low_passes
from calrig.simulator.mechanics import Mechanics, Vibration
from calrig.simulator.trajectory import FloatArray, Trajectory, Turn, trapezoid

STANDARD_GRAVITY_MPS2 = 9.80665
RELAXATIONS_S = np.logspace(-2.0, 8.0, 21)
"""Retardation times of a joint's springs and dampers, two a decade: it creeps from 10 ms to years."""


CLAMP_VELOCITY_DPS, CLAMP_ACCELERATION_DPS2 = 60.0, 120.0
"""Of the person or dividing head that turns the package in its clamp."""
FACES = {
    "x": np.eye(3),
    "y": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "z": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
}
"""From the clamp's axes to the package's, the named one of which lies along the stage's axis.

At 0° z is up, then x, then y. Reversed faces are turned by half a turn about that vertical.
"""
REVERSED = np.diag([-1.0, -1.0, 1.0])


class Clamping(NamedTuple):
    """From an instant on: the matrix (3, 3) from the clamp's axes to the sensor's."""

    from_s: float
    to_sensor: FloatArray


class Mount:
    """A package in a clamp on a table: it may sit askew, slip, bend under a cable, and be remounted.

    `rng` draws how well each clamping is seated.
    """

    def __init__(self, options: MountOptions, rng: np.random.Generator | None = None) -> None:
        self._options = options
        self._rng = rng or np.random.default_rng(0)
        self._in_case = _about("x", options.roll_deg) @ _about("y", options.pitch_deg)
        self._in_case = self._in_case @ _about("z", options.yaw_deg)
        self._clamp = Trajectory(options.clamped_deg)
        self._clampings = [self._seated(-math.inf, options.clamped_axis)]

    def clamp(self, at_s: float, mount_deg: float, axis: str) -> float:
        """Turns the package in its clamp, or puts it in by another face; returns when that is done."""
        from_deg = self._clamp.state(at_s)[0]
        way = trapezoid(at_s, from_deg, mount_deg, CLAMP_VELOCITY_DPS, CLAMP_ACCELERATION_DPS2)
        self._clamp.replace_from(at_s, way)
        self._clampings.append(self._seated(way[-1].start_s, axis))
        return way[-1].start_s

    def _seated(self, from_s: float, axis: str) -> Clamping:
        """A clamping by a face, each seated as well as it happens."""
        seat = self._rng.normal(0.0, self._options.seat_std_deg, 3)
        askew = _about("x", seat[0]) @ _about("y", seat[1]) @ _about("z", seat[2])
        face = FACES[axis[-1]] @ (REVERSED if axis.startswith("-") else np.eye(3))
        return Clamping(from_s, self._in_case @ face @ askew)

    def _to_sensor(self, times_s: FloatArray | None) -> FloatArray:
        """(3, 3), or (n, 3, 3) if the package was remounted in between."""
        if len(self._clampings) == 1 or times_s is None:
            return self._clampings[0].to_sensor
        begins = [clamping.from_s for clamping in self._clampings]
        chosen = np.searchsorted(begins, times_s, side="right") - 1
        return np.array([clamping.to_sensor for clamping in self._clampings])[chosen]

    def package(self, table: Turn, times_s: FloatArray) -> Turn:
        """The clamp's turn about the stage's axis, the angle at which the package is clamped included."""
        clamp = self._clamp.at(times_s)
        parts = table, clamp, self._sag(table), self._slip(times_s), self._creep(times_s)
        angle_deg = sum((part.angle_deg for part in parts), np.full_like(times_s, self._options.offset_deg))
        return Turn(angle_deg, sum((part.rate_dps for part in parts), np.zeros_like(times_s)))

    def specific_force_g(self, angle_deg: FloatArray, times_s: FloatArray | None = None) -> FloatArray:
        """Gravity's reaction along the sensor's axes, (n, 3): the vertical turned, its length always 1 g.

        `times_s` (n,) tells which clamping it was; without, the first.
        """
        tilt, angle = math.radians(self._options.axis_tilt_deg), np.radians(angle_deg)
        along_axis = np.full_like(angle, math.sin(tilt))
        up = np.stack([along_axis, math.cos(tilt) * np.sin(angle), math.cos(tilt) * np.cos(angle)], axis=-1)
        felt: FloatArray = np.einsum("...ij,...j->...i", self._to_sensor(times_s), up)
        return felt

    def angular_rate_dps(self, rate_dps: FloatArray, times_s: FloatArray | None = None) -> FloatArray:
        """The turn about the stage's axis along the sensor's axes, (n, 3)."""
        rates: FloatArray = rate_dps[..., None] * self._to_sensor(times_s)[..., 0]
        return rates

    def from_table(self, vectors: FloatArray, times_s: FloatArray) -> FloatArray:
        """Vectors (..., n, 3) that turn with the table, along the sensor's axes.

        They are given along the stage's axis, tangential, and radial, upward with the table at 0.
        """
        turned = np.radians(self._clamp.at(times_s).angle_deg)
        along, tangential, radial = np.moveaxis(vectors, -1, 0)
        s, c = np.sin(turned), np.cos(turned)
        in_clamp = np.stack([along, c * tangential + s * radial, c * radial - s * tangential], axis=-1)
        felt: FloatArray = np.einsum("...ij,...j->...i", self._to_sensor(times_s), in_clamp)
        return felt

    def swing_g(self, rate_dps: FloatArray, rate_change_dps2: FloatArray, times_s: FloatArray) -> FloatArray:
        """What turning on an arm adds to the specific force (n, 3): tangential and centripetal."""
        arm = self._options.lever_arm_m / STANDARD_GRAVITY_MPS2
        tangential, radial = -arm * np.radians(rate_change_dps2), -arm * np.radians(rate_dps) ** 2
        return self.from_table(np.stack([np.zeros_like(radial), tangential, radial], axis=-1), times_s)

    def _sag(self, table: Turn) -> Turn:
        """What the cable bends: its weight on its arm, and its winding up, each against the motion upward."""
        options = self._options
        moment_nm = options.cable_mass_kg * STANDARD_GRAVITY_MPS2 * options.cable_arm_m
        lean = np.radians(table.angle_deg - options.cable_horizontal_deg)
        stiffness = options.cable_stiffness_nm_per_deg
        torque_nm = -moment_nm * np.cos(lean) - stiffness * table.angle_deg
        slope = np.radians(moment_nm) * np.sin(lean) - stiffness
        compliance = options.compliance_deg_per_nm
        return Turn(compliance * torque_nm, compliance * slope * table.rate_dps)

    def _slip(self, times_s: FloatArray) -> Turn:
        """A step that takes `slip_s`, smooth at both ends, so that a gyro feels it."""
        options = self._options
        done = np.clip((times_s - options.slip_at_s) / options.slip_s, 0.0, 1.0)
        return Turn(
            options.slip_deg * done**2 * (3 - 2 * done),
            options.slip_deg / options.slip_s * 6 * done * (1 - done),
        )

    def _creep(self, times_s: FloatArray) -> Turn:
        """Kelvin-Voigt elements in a row, all under the clamp's constant load: a spring and a damper each."""
        options = self._options
        if not options.creep_deg_per_decade:
            return Turn(np.zeros_like(times_s), np.zeros_like(times_s))
        under_load_s = np.maximum(times_s - options.creep_began_s, 0.0)[..., None]
        gives_deg = options.creep_deg_per_decade * math.log10(RELAXATIONS_S[1] / RELAXATIONS_S[0])
        left = np.exp(-under_load_s / RELAXATIONS_S)
        loaded = under_load_s > 0.0
        return Turn(
            (gives_deg * (1.0 - left)).sum(axis=-1),
            (gives_deg * loaded * left / RELAXATIONS_S).sum(axis=-1),
        )


def _about(axis: str, angle_deg: float) -> FloatArray:
    """A vector's components along axes that were turned by this angle about one of themselves.

    Turned about x the elevation rises by it.
    """
    s, c = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    k = "xyz".index(axis)
    turned = np.eye(3)
    i, j = (k + 1) % 3, (k + 2) % 3
    turned[i, i], turned[i, j], turned[j, i], turned[j, j] = c, s, -s, c
    return turned


STRESS_STEP_S = 1.0
"""Temperature changes over minutes: its turning points are known well enough to the second."""


class Environment:
    """Die temperature T = start + (end − start)·(1 − exp(−t/τ)) and a slow swing of the room; supply."""

    def __init__(self, options: EnvironmentOptions) -> None:
        self._options = options
        self._stress_c = [options.start_c]
        self._body_c = [options.start_c]

    def die_c(self, times_s: FloatArray) -> FloatArray:
        """The die's temperature."""
        options = self._options
        warm = -np.expm1(-np.maximum(times_s, 0.0) / options.warm_up_s)
        room = options.ambient_amplitude_c * np.sin(2 * np.pi * times_s / options.ambient_period_s)
        temperature: FloatArray = options.start_c + (options.end_c - options.start_c) * warm + room
        return temperature

    def stress_c(self, times_s: FloatArray) -> FloatArray:
        """The temperature that the package's stress answers to: its body's, through a play of `hysteresis_c`.

        Between two turning points the play's output is its last value, clipped to within half its width of
        the input; it is carried from second to second.
        """
        body_c = self.body_c(times_s)
        if not self._options.hysteresis_c or not np.size(times_s):
            return body_c
        index = np.maximum(times_s // STRESS_STEP_S, 0).astype(np.intp)
        self._carry_to(int(index.max()))
        half = 0.5 * self._options.hysteresis_c
        first = int(index.min())
        carried = np.array(self._stress_c[first : int(index.max()) + 1])[index - first]
        stress: FloatArray = np.clip(carried, body_c - half, body_c + half)
        return stress

    def body_c(self, times_s: FloatArray) -> FloatArray:
        """The temperature of the package's body: heat flows into it from the die, a little every second."""
        if not self._options.stress_lag_s or not np.size(times_s):
            return self.die_c(times_s)
        last = int(np.ceil(np.max(times_s) / STRESS_STEP_S))
        seconds = STRESS_STEP_S * np.arange(len(self._body_c), last + 1, dtype=np.float64)
        stays = np.exp(-STRESS_STEP_S / self._options.stress_lag_s)
        for die_c in self.die_c(seconds - 0.5 * STRESS_STEP_S).tolist():
            self._body_c.append(die_c + stays * (self._body_c[-1] - die_c))
        known_s = STRESS_STEP_S * np.arange(len(self._body_c))
        body: FloatArray = np.interp(times_s, known_s, self._body_c)
        return body

    def supply_v(self, times_s: FloatArray) -> FloatArray:
        """The supply's voltage."""
        options = self._options
        wave = np.sin(2 * np.pi * times_s / options.supply_period_s)
        if options.supply_waveform == "square":
            wave = np.where(wave >= 0, 1.0, -1.0)
        voltage: FloatArray = options.supply_v + options.supply_ripple_v * wave
        return voltage

    def _carry_to(self, index: int) -> None:
        known = len(self._stress_c)
        if index < known:
            return
        half = 0.5 * self._options.hysteresis_c
        stress_c = self._stress_c[-1]
        for body_c in self.body_c(STRESS_STEP_S * np.arange(known, index + 1, dtype=np.float64)).tolist():
            stress_c = min(max(stress_c, body_c - half), body_c + half)
            self._stress_c.append(stress_c)


TURN_STEP_S = 0.05
"""Half the span over which the package's slow turn with temperature is differentiated."""
SWING_STEP_S = 5e-4
"""Over which the table's rate is differentiated, short against any ramp: what comes is not commanded yet."""


class _Motion(NamedTuple):
    """What the sensor lives through at n instants, along its axes.

    Attributes:
        force_g: specific force (n, 3); where the motor shakes it (k, n, 3), over the step that begins there.
        rate_dps: angular rate (n, 3).
        step_hz: steps of the motor per second (n,).
    """

    force_g: FloatArray
    rate_dps: FloatArray
    step_hz: FloatArray


class Bench:
    """A table and a sensor, at any instant of simulated time. Arrays of instants in, arrays out.

    Nothing here reads a clock. A thread that shares a bench takes `lock`, reads the clock and
    commands or samples while holding it, so that no command falls into a past already sampled.

    Attributes:
        mechanics: takes the commands (`home`, `move`, `halt`) and gives the encoder's view.
        lock: for those who share the bench.
    """

    def __init__(self, settings: SimulatorSettings) -> None:
        mechanics_seed, noise_seed, seat_seed = np.random.SeedSequence(settings.seed).spawn(3)
        self.lock = threading.RLock()
        self.mechanics = Mechanics(settings.mechanics, np.random.default_rng(mechanics_seed))
        self._mount = Mount(settings.mount, np.random.default_rng(seat_seed))
        self._environment = Environment(settings.environment)
        self._nominal_v = settings.environment.supply_v
        self._imu = Imu(settings.imu)
        self._low_passes = low_passes(settings.imu.dlpf_cfg)
        self._vibration = Vibration(settings.mechanics)
        self._swings = settings.mount.lever_arm_m > 0
        self._turns_with_temperature = settings.imu.package_turn_deg_per_c != 0
        self._noise = NoiseSource(settings.imu, noise_seed)

    def clamp(self, at_s: float, mount_deg: float, axis: str = "x") -> float:
        """Turns the unit in its clamp, from now on; returns the instant at which it sits."""
        return self._mount.clamp(at_s, mount_deg, axis)

    def sensor(self, times_s: FloatArray) -> Turn:
        """The sensor's true turn about the stage's axis (with x along it: its elevation), not wrapped.

        How it is turned in its case, and how well the clamping is seated, is in `specific_force_g` alone.
        """
        package = self._mount.package(self.mechanics.table(times_s), times_s)
        if not self._turns_with_temperature:
            return package
        turned, before, after = (
            self._imu.package_turn_deg(self._environment.stress_c(times_s + step_s))
            for step_s in (0.0, -TURN_STEP_S, TURN_STEP_S)
        )
        return Turn(package.angle_deg + turned, package.rate_dps + (after - before) / (2 * TURN_STEP_S))

    def specific_force_g(self, times_s: FloatArray) -> FloatArray:
        """The true specific force along the sensor's axes, (n, 3), without the motor's vibration."""
        times_s = np.asarray(times_s, dtype=float)
        return self._force_g(self.sensor(times_s), times_s)

    def angular_rate_dps(self, times_s: FloatArray) -> FloatArray:
        """The true angular rate along the sensor's axes, (n, 3)."""
        times_s = np.asarray(times_s, dtype=float)
        return self._mount.angular_rate_dps(self.sensor(times_s).rate_dps, times_s)

    def temperature_c(self, times_s: FloatArray) -> FloatArray:
        """The die's true temperature (n,)."""
        return self._environment.die_c(np.asarray(times_s, dtype=float))

    def counts(self, times_s: FloatArray, rate_hz: float = 200.0) -> Counts:
        """The chip's registers at increasing instants (n,): ax ay az temp gx gy gz, (n, 7) i16.

        Each call draws the noise of the samples that follow those of the call before; cutting the same
        instants into other blocks gives the same counts. `rate_hz` sets the noise's bandwidth.
        """
        times_s = np.asarray(times_s, dtype=float)
        around = Surroundings(
            self._environment.die_c(times_s),
            self._environment.stress_c(times_s),
            self._environment.supply_v(times_s) - self._nominal_v,
        )
        noise = self._noise.draw(times_s, rate_hz)
        accel, gyro = self._low_passes
        motion = self._motion(times_s - accel.delay_s)
        accel_g = self._filtered(accel, self._imu.accel_g(motion.force_g, around), motion)
        if gyro.delay_s != accel.delay_s:
            motion = self._motion(times_s - gyro.delay_s)
        sensed_dps = self._imu.gyro_dps(motion.rate_dps, motion.force_g, around)
        gyro_dps = self._filtered(gyro, sensed_dps, motion)
        return self._imu.registers(
            accel_g + noise.accel_g, gyro_dps + noise.gyro_dps, around.die_c + noise.temperature_c
        )

    def _force_g(self, turn: Turn, times_s: FloatArray) -> FloatArray:
        force_g = self._mount.specific_force_g(turn.angle_deg, times_s)
        if not self._swings:
            return force_g
        before, now = (self.mechanics.table(times_s - ago_s).rate_dps for ago_s in (SWING_STEP_S, 0.0))
        return force_g + self._mount.swing_g(now, (now - before) / SWING_STEP_S, times_s)

    def _motion(self, times_s: FloatArray) -> _Motion:
        turn = self.sensor(times_s)
        force_g = self._force_g(turn, times_s)
        rate_dps = self._mount.angular_rate_dps(turn.rate_dps, times_s)
        if not self._vibration.on:
            return _Motion(force_g, rate_dps, np.zeros_like(times_s))
        motor = self.mechanics.motor(times_s)
        along = np.broadcast_to(self._vibration.direction, force_g.shape)
        shaking_g = self._vibration.cycle_g(motor)[..., None] * self._mount.from_table(along, times_s)
        return _Motion(force_g + shaking_g, rate_dps, self._vibration.frequency_hz(motor))

    def _filtered(self, low_pass: LowPass, sensed: FloatArray, motion: _Motion) -> FloatArray:
        """What is left in a channel (n, 3) of what its element makes of the motion.

        The element is bent where it is shaken, before any filter: what it rectifies of a vibration stays.
        """
        return low_pass.of_cycle(sensed, motion.step_hz) if self._vibration.on else sensed
