"""One stage with one sensor in its environment, without a serial link: the physics put together."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from calrig.simulator.config import EnvironmentOptions, SimulatorSettings
from calrig.simulator.imu import Counts, Imu, LowPass, NoiseSource, Surroundings, low_passes
from calrig.simulator.mechanics import Mechanics, Vibration
from calrig.simulator.mount import Mount
from calrig.simulator.trajectory import FloatArray, Turn

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
        """The sensor's true turn about the stage's axis (with x along it: its elevation), and its rate.

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

    def true_elevation_deg(self, times_s: FloatArray) -> FloatArray:
        """The sensor's true elevation (n,), not wrapped."""
        return self.sensor(np.asarray(times_s, dtype=float)).angle_deg

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
