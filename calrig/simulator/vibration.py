"""How a turning motor shakes what it turns: a force at its step frequency and at multiples of it."""

from __future__ import annotations

import numpy as np

from calrig.simulator.motion_options import MechanicsOptions
from calrig.simulator.trajectory import FloatArray, Turn

RESONANCE_Q = 10.0
"""Of a bolted aluminium structure: a twentieth of critical damping."""
HIGHEST_POWER = 3
"""Of a force in what the accelerometer makes of it."""


class Vibration:
    """Of one motor. Each full step is one cycle, so that the motor's angle tells where in it the force is.

    Attributes:
        on: whether there is any.
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

        There are enough of them for all waves of the cube of this; nothing while the motor stands.
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
