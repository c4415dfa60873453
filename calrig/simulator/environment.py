"""What surrounds the sensor: the die's temperature and the supply's voltage, functions of time alone."""

from __future__ import annotations

import numpy as np

from calrig.simulator.config import EnvironmentOptions
from calrig.simulator.trajectory import FloatArray

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
