"""From the controller's command to the table: motor, backlash, gear, encoder; and how the motor shakes it."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calrig.simulator.config import MechanicsOptions
from calrig.simulator.trajectory import FloatArray, Segment, Trajectory, Turn, braking, trapezoid

RESONANCE_Q = 10.0
"""Of a bolted aluminium structure: a twentieth of critical damping."""
HIGHEST_POWER = 3
"""Of a force in what the accelerometer makes of it."""


class Vibration:
    """Of one motor. Each full step is one cycle, so that the motor's angle tells where in it the force is.

    Attributes:
        direction: (3,) unit vector on the table.
    """

    def __init__(self, options: MechanicsOptions) -> None:
        self.on = options.vibration_g > 0
        self.direction = np.array(options.vibration_direction) / np.linalg.norm(options.vibration_direction)
        self._step_deg = options.motor_step_deg
        self._orders = np.arange(1, len(options.vibration_harmonics) + 1)
        self._amplitudes_g = options.vibration_g * np.array(options.vibration_harmonics)
        self._resonance_hz = options.vibration_resonance_hz

    def frequency_hz(self, motor: Turn) -> FloatArray:
        """Full steps per second (n,)."""
        return np.asarray(np.abs(motor.rate_dps) / self._step_deg)

    def cycle_g(self, motor: Turn) -> FloatArray:
        """The force (k, n) at k instants that divide a step, the first where the motor is now.

        There are enough of them for all waves of the cube of this; nothing while the motor is at rest.
        """
        k = 2 * HIGHEST_POWER * len(self._orders) + 2
        steps = motor.angle_deg / self._step_deg + np.arange(k)[:, None] / k
        waves = np.sin(2 * np.pi * self._orders[:, None, None] * steps)
        frequency_hz = self.frequency_hz(motor)
        heights_g = self._amplitudes_g[:, None] * self._answer(self._orders[:, None] * frequency_hz)
        shaking_g: FloatArray = np.einsum("hkn,hn->kn", waves, np.where(frequency_hz > 0, heights_g, 0.0))
        return shaking_g

    def _answer(self, frequency_hz: FloatArray) -> FloatArray:
        """Acceleration of a mass in a damped spring over that of the free mass, under the same force."""
        if self._resonance_hz is None:
            return np.ones_like(frequency_hz)
        ratio = frequency_hz / self._resonance_hz
        return np.asarray(ratio**2 / np.hypot(1 - ratio**2, ratio / RESONANCE_Q))


HOMING_RUN_UP_DEG = 1.0
"""Homing passes its switch by this much and comes back to it upward, whichever side it began on."""

DETENT_STEPS = 12
"""Of Newton's method: from where the currents point it has converged well before."""


class Arrival(NamedTuple):
    """When the motor is at rest, and whether an obstruction stopped it short of its target."""

    at_s: float
    stalled: bool


class _Reference(NamedTuple):
    from_s: float
    motor_deg: float
    encoder_deg: float


class Mechanics:
    """One rotary stage. Counted angles are what the controller calls them; motor angles begin at the home.

    Commands carry their instant and may not go back in time; every other method takes any instants.
    """

    def __init__(self, options: MechanicsOptions, rng: np.random.Generator) -> None:
        self._options = options
        self._rng = rng
        start_deg = options.power_up_deg
        relaxation_s = options.creep_s if options.creep_fraction else math.inf
        self._motor = Trajectory(start_deg)
        self._follower = Trajectory(start_deg, relaxation_s)
        at_start = float(self._encoder(np.zeros(1))[0])
        self._references = [_Reference(-math.inf, start_deg, at_start)]

    def move(self, at_s: float, target_deg: float, velocity_dps: float, acceleration_dps2: float) -> Arrival:
        """Turns the motor from rest to a counted angle; where it ends is off by the following error."""
        zero_deg = self._reference(at_s).motor_deg
        missed_deg = self._rng.normal(0.0, self._options.following_std_deg)
        begin_s = at_s + self._options.following_lag_s
        from_deg = self._motor.state(begin_s)[0]
        to_deg = zero_deg + target_deg + missed_deg
        return self._drive(trapezoid(begin_s, from_deg, to_deg, velocity_dps, acceleration_dps2))

    def home(self, at_s: float, velocity_dps: float, acceleration_dps2: float) -> Arrival:
        """Looks for the reference from rest; once there, the controller counts from it."""
        home_deg = self._rng.normal(0.0, self._options.homing_std_deg)
        begin_s = at_s + self._options.following_lag_s
        from_deg = self._motor.state(begin_s)[0]
        past_deg = home_deg - HOMING_RUN_UP_DEG
        way = trapezoid(begin_s, from_deg, past_deg, velocity_dps, acceleration_dps2)
        back = trapezoid(way[-1].start_s, past_deg, home_deg, velocity_dps, acceleration_dps2)
        arrival = self._drive(way[:-1] + back)
        if not arrival.stalled:
            encoder_deg = float(self._encoder(np.array([arrival.at_s]))[0])
            self._references.append(_Reference(arrival.at_s, home_deg, encoder_deg))
        return arrival

    def follow(self, way: Sequence[Segment]) -> Arrival:
        """Turns the motor along a way, as pulses command a stepper: it goes on from wherever it is.

        The way may count from any origin; its first segment begins where and when the motor is to go on.
        """
        lag_s = self._options.following_lag_s
        begin_s = way[0].start_s + lag_s
        origin_deg = self._motor.state(begin_s)[0] - way[0].position_deg
        return self._drive(
            [
                segment._replace(
                    start_s=segment.start_s + lag_s, position_deg=segment.position_deg + origin_deg
                )
                for segment in way
            ]
        )

    def draw_homing_error_deg(self) -> float:
        """Draws how far a switch is off this time."""
        return float(self._rng.normal(0.0, self._options.homing_std_deg))

    def halt(self, at_s: float, acceleration_dps2: float) -> float:
        """Decelerate any motion and return the instant of standstill. A homing under way is lost."""
        begin_s = at_s + self._options.following_lag_s
        self._references = [reference for reference in self._references if reference.from_s <= at_s]
        return self._drive(braking(begin_s, *self._motor.state(begin_s), acceleration_dps2)).at_s

    def encoder_deg(self, times_s: FloatArray, age_s: float = 0.0) -> FloatArray:
        """The counted angle that the controller reports, in steps of the encoder's resolution.

        Reported at `times_s`, it is the encoder's angle `age_s` before, counted from the home known by then.
        """
        starts, _, zeros = np.array(self._references).T
        counted = self._encoder(times_s - age_s) - zeros[np.searchsorted(starts, times_s, side="right") - 1]
        step = self._options.encoder_resolution_deg
        reported: FloatArray = np.round(counted / step) * step if step else counted
        return reported

    def motor(self, times_s: FloatArray) -> Turn:
        """The motor's angle past the home, seen through a perfect gear."""
        return self._motor.at(times_s)

    def table(self, times_s: FloatArray) -> Turn:
        """Where the table truly is, and how fast it turns.

        The gear ends in a table that rotates about a centre off its bearing's: an angle φ becomes
        φ + A·sin(φ + phase), and its divisions and its bearing add waves of further orders.
        """
        geared = self._geared(times_s)
        eccentricity = self._options.eccentricity_deg
        phase = np.radians(geared.angle_deg + self._options.eccentricity_phase_deg)
        angle_deg = geared.angle_deg + eccentricity * np.sin(phase)
        ratio = 1 + np.radians(eccentricity) * np.cos(phase)
        for wave in self._options.harmonics:
            phase = np.radians(wave.order * geared.angle_deg + wave.phase_deg)
            angle_deg = angle_deg + wave.amplitude_deg * np.sin(phase)
            ratio = ratio + np.radians(wave.amplitude_deg) * wave.order * np.cos(phase)
        return Turn(angle_deg, geared.rate_dps * ratio)

    def _drive(self, way: list[Segment]) -> Arrival:
        way, stalled = self._obstructed(way)
        begin_s = way[0].start_s
        follower_deg = self._follower.state(begin_s)[0]
        follower = through_play(way, follower_deg, self._options.backlash_deg)
        self._motor.replace_from(begin_s, way)
        self._follower.replace_from(begin_s, follower)
        return Arrival(way[-1].start_s, stalled)

    def _obstructed(self, way: list[Segment]) -> tuple[list[Segment], bool]:
        wall_deg = self._options.obstruction_deg
        if wall_deg is None:
            return way, False
        outward = math.copysign(1.0, wall_deg - self._options.power_up_deg)
        for index, (segment, following) in enumerate(pairwise(way)):
            room_deg = outward * (wall_deg - segment.position_deg)
            if outward * (following.position_deg - segment.position_deg) > max(room_deg, 0.0):
                hit_s = segment.reach_s(outward, max(room_deg, 0.0))
                return [*way[:index], *([segment] if room_deg > 0 else []), Segment(hit_s, wall_deg)], True
        return way, False

    def _geared(self, times_s: FloatArray) -> Turn:
        options = self._options
        angle_deg, rate_dps = self._follower.at(times_s)
        if options.creep_fraction:
            behind = self._follower.behind(times_s)
            angle_deg = angle_deg - options.creep_fraction * behind.angle_deg
            rate_dps = rate_dps - options.creep_fraction * behind.rate_dps
        angle_deg, rate_dps = self._detained(angle_deg, rate_dps)
        turns = 2 * np.pi / options.worm_period_deg
        phase = turns * angle_deg + np.radians(options.worm_phase_deg)
        ratio = 1 + 0.01 * options.scale_error_pct
        return Turn(
            ratio * angle_deg + options.worm_deg * np.sin(phase),
            rate_dps * (ratio + options.worm_deg * turns * np.cos(phase)),
        )

    def _detained(self, angle_deg: FloatArray, rate_dps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where the currents hold the rotor against its detents.

        Four full steps are a cycle φ of the currents, and the detents have four to it: the rotor rests where
        sin(φ − φ₀) + share·sin 4φ = 0 (Kenjo & Sugawara, Stepping Motors, 1994, chapter 3).
        """
        share = self._options.detent_share
        if not share:
            return angle_deg, rate_dps
        cycle_deg = 4.0 * self._options.motor_step_deg
        commanded = 2.0 * np.pi * angle_deg / cycle_deg
        phi = commanded
        for _ in range(DETENT_STEPS):
            held, detents = np.sin(phi - commanded), share * np.sin(4.0 * phi)
            phi = phi - (held + detents) / (np.cos(phi - commanded) + 4.0 * share * np.cos(4.0 * phi))
        stiffness = np.cos(phi - commanded)
        follows = stiffness / (stiffness + 4.0 * share * np.cos(4.0 * phi))
        return phi * cycle_deg / (2.0 * np.pi), rate_dps * follows

    def _encoder(self, times_s: FloatArray) -> FloatArray:
        seen = self._motor.at(times_s) if self._options.encoder_on == "motor" else self._geared(times_s)
        return seen.angle_deg

    def _reference(self, at_s: float) -> _Reference:
        index = bisect_right(self._references, at_s, key=lambda reference: reference.from_s)
        return self._references[index - 1]


def through_play(motor: Sequence[Segment], follower_deg: float, gap_deg: float) -> list[Segment]:
    """How a follower moves that the motor pushes by one flank or the other of a gap.

    Args:
        motor: the motor's motion from rest or on its way, each segment without a change of direction, the
            last one at rest.
        follower_deg: where the follower is when the first segment starts, within gap_deg/2 of the motor.
        gap_deg: the whole width of the gap.

    Returns:
        The follower's motion over the same time; it is at rest wherever no flank touches.
    """
    half = 0.5 * gap_deg
    follower: list[Segment] = []
    for index, segment in enumerate(motor):
        end_s = motor[index + 1].start_s if index + 1 < len(motor) else math.inf
        follower += _pushed(segment, end_s, follower_deg, half)
        if math.isfinite(end_s):
            follower_deg = follower[-1].at(end_s)[0]
    return follower


def _pushed(segment: Segment, end_s: float, follower_deg: float, half_deg: float) -> list[Segment]:
    standing = Segment(segment.start_s, follower_deg)
    push = segment.velocity_dps or segment.acceleration_dps2
    if push == 0:
        return [standing]
    sense = math.copysign(1.0, push)
    to_contact_deg = sense * (follower_deg - segment.position_deg) + half_deg
    way_deg = sense * (segment.at(end_s)[0] - segment.position_deg)
    if to_contact_deg >= way_deg:
        return [standing]
    if to_contact_deg <= 0:
        return [segment._replace(position_deg=segment.position_deg - sense * half_deg)]
    speed, gain = sense * segment.velocity_dps, sense * segment.acceleration_dps2
    # The smaller root of speed·t + gain·t²/2 = way, in the form that survives gain = 0 and speed = 0.
    contact_s = 2 * to_contact_deg / (speed + math.sqrt(max(speed**2 + 2 * gain * to_contact_deg, 0.0)))
    at_contact = segment.start_s + contact_s
    if at_contact >= end_s:
        return [standing]
    velocity = segment.velocity_dps + segment.acceleration_dps2 * contact_s
    return [standing, Segment(at_contact, follower_deg, velocity, segment.acceleration_dps2)]
