"""Runs of poses from the simulator's physics, with known causes: nothing here knows the catalogue.

Tables turn, vectors are felt, temperatures rise (calrig.simulator, called directly: a hundred thousand poses
would take days over a wire); each dwell is averaged from `SAMPLES` instants. Only the noise is drawn for the
pose as a whole, as the paper's filter leaves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.signal import lfilter

from calrig.calibration.poses import Pose
from calrig.plan import Plan
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.imu import Imu, Surroundings

from .layout import Layout, timeline

SAMPLES = 20
"""Instants that stand for a dwell's four hundred samples: between them nothing here changes but a slip."""
FILTER_RATE_HZ = 100.0
WARM_UP_C = 6.0
ACROSS_MG = 0.3
"""Noise of the axis along the stage's."""


Turned = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Angle that the sensor adds to what it feels, of time, elevation and supply voltage."""


@dataclass(frozen=True)
class Cause:
    """Something wrong with a rig or a unit, drawn for one run.

    Attributes:
        name, origin, covariate: what a right diagnosis says.
        options: of the simulator's parts, such as `{"mechanics": {"backlash_deg": 0.08}}`.
        turned: a turn that no part of the simulator makes; felt by the gyro where `felt`.
        filter_s: time constant of a filter before the reading alone.
        parameters: the truth, where it is one number each.
        period_deg: of a wave: another one is another effect.
    """

    name: str
    origin: str
    covariate: str
    options: Mapping[str, Any] = field(default_factory=dict)
    turned: Turned | None = None
    felt: bool = False
    filter_s: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    period_deg: float | None = None


@dataclass(frozen=True)
class Noise:
    """Noise of a pose: the reading and the accelerometer's angle share most of theirs.

    `kind`: `white`; `t4` (Student, 4 degrees of freedom, same spread); `ar1`, every channel a first-order
    autoregression of correlation `rho`; `shared`, one such autoregression in all four channels, with
    `SHARED` of their variance, the rest white.
    """

    kind: str = "white"
    rho: float = 0.0
    reading_deg: float = 0.03
    norm_mg: float = 0.3
    move_deg: float = 0.02

    ANGLE_CORRELATION = 0.87
    SHARED = 0.87

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 4): reading, accelerometer's angle, |accelerometer| (g), gyro over the move."""
        own = rng.standard_t(4, (n, 4)) / math.sqrt(2.0) if self.kind == "t4" else rng.standard_normal((n, 4))
        if self.kind == "ar1":
            own = _autoregression(own, self.rho)
        own[:, 1] = self.ANGLE_CORRELATION * own[:, 0] + math.sqrt(1 - self.ANGLE_CORRELATION**2) * own[:, 1]
        if self.kind == "shared":
            common = _autoregression(rng.standard_normal((n, 1)), self.rho)
            own = math.sqrt(self.SHARED) * common + math.sqrt(1 - self.SHARED) * own
        return own * self.spread

    @property
    def spread(self) -> np.ndarray:
        return np.array([self.reading_deg, self.reading_deg, 1e-3 * self.norm_mg, self.move_deg])


def _autoregression(white: np.ndarray, rho: float) -> np.ndarray:
    gain = math.sqrt(1.0 - rho**2)
    start = white[:1] * rho
    driven = np.concatenate([white[:1], gain * white[1:]])
    result, _ = lfilter([1.0], [1.0, -rho], driven, axis=0, zi=0.0 * start)
    return np.asarray(result)


@dataclass(frozen=True)
class Truth:
    """One cause, its noise-free part of the reading (n,), and its parameters."""

    cause: Cause
    shape_deg: np.ndarray
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Run:
    """What was measured, and what is behind it."""

    poses: list[Pose]
    truths: list[Truth]
    noise: Noise


def measure(
    laid_out: Layout | Plan,
    causes: Sequence[Cause],
    noise: Noise,
    rng: np.random.Generator,
    around: Mapping[str, Any] | None = None,
) -> Run:
    """One run of a rig with these causes; `around` is what else there is, drawn where it is not given."""
    layout = Layout.of(laid_out) if isinstance(laid_out, Plan) else laid_out
    when = timeline(layout)
    around = surroundings(when.duration_s, rng) if around is None else around
    drawn = noise.draw(rng, len(when.target_deg))
    columns = dict(layout.columns)
    if "supply" in _covariates(causes):
        columns["lamp_current"] = rng.normal(1.0, 0.1, len(drawn))
    clean = _Clean(layout, causes, around)
    truths = []
    for one in causes:
        shape = clean.reading_deg - _Clean(layout, [c for c in causes if c is not one], around).reading_deg
        parameters = dict(one.parameters)
        if one.name == "settling":
            moves = np.diff(clean.when.target_deg, prepend=clean.when.target_deg[0])
            parameters["fraction"] = float(-(shape @ moves) / (moves @ moves))
        truths.append(Truth(one, shape, parameters))
    return Run(clean.poses(drawn, columns, rng), truths, noise)


def shape_deg(layout: Layout, cause: Cause, around: Mapping[str, Any]) -> np.ndarray:
    """(n,) what one cause by itself adds to the readings, free of noise."""
    return _Clean(layout, [cause], around).reading_deg - _Clean(layout, [], around).reading_deg


def _covariates(causes: Sequence[Cause]) -> str:
    return " ".join(cause.covariate for cause in causes)


def surroundings(duration_s: float, rng: np.random.Generator) -> dict[str, Any]:
    """Every run warms up by 6 °C, more or less bent, so that time and temperature are always suspects.

    What temperature does, it does about its mean over the run, end − 6 °C/bend: no standing offset besides.
    """
    bend = rng.uniform(2.0, 5.0)
    end_c = 20.0 + WARM_UP_C / -math.expm1(-bend)
    return {
        "environment": {
            "start_c": 20.0,
            "end_c": end_c,
            "warm_up_s": duration_s / bend,
        },
        "imu": {"gyro_scale_error_pct": [0.4, 0.0, 0.0], "reference_c": end_c - WARM_UP_C / bend},
        "mount": {"offset_deg": 0.8},
        "mechanics": {"scale_error_pct": 0.2},
    }


class _Clean:
    """A run free of noise."""

    def __init__(self, layout: Layout, causes: Sequence[Cause], around: Mapping[str, Any]) -> None:
        self._layout, self._causes = layout, causes
        options: dict[str, Any] = dict(around)
        for cause in causes:
            for part, values in cause.options.items():
                options[part] = {**options.get(part, {}), **values}
        settings = SimulatorSettings.from_options(options)
        self._bench = Bench(settings)
        self._imu = Imu(settings.imu)
        self._nominal_v = settings.environment.supply_v
        self._environment = self._bench._environment
        self.when = layout.carried_out(self._bench)
        n = len(self.when.target_deg)
        share = (np.arange(SAMPLES) + 0.5) / SAMPLES
        self._times = self.when.begin_s[:, None] + share * (self.when.end_s - self.when.begin_s)[:, None]
        felt = self._accel_g(self._times.ravel()).reshape(n, SAMPLES, 3)
        self.accel_g = felt.mean(axis=1)
        targets = self.when.target_deg[:, None]
        self.reading_deg = _near(_elevation_deg(felt), targets).mean(axis=1) + self._lagging_deg()

    def _accel_g(self, times_s: np.ndarray) -> np.ndarray:
        """What the accelerometer gives, (m, 3)."""
        environment = self._environment
        supply_v = environment.supply_v(times_s)
        around = Surroundings(
            environment.die_c(times_s), environment.stress_c(times_s), supply_v - self._nominal_v
        )
        felt = self._imu.accel_g(self._bench.specific_force_g(times_s), around)
        turn = np.radians(self._turned_deg(times_s))
        s, c = np.sin(turn), np.cos(turn)
        return np.stack([felt[:, 0], felt[:, 1] * c + felt[:, 2] * s, felt[:, 2] * c - felt[:, 1] * s], 1)

    def _turned_deg(self, times_s: np.ndarray, *, felt_only: bool = False) -> np.ndarray:
        total = np.zeros_like(times_s)
        elevation = self._bench.sensor(times_s).angle_deg
        for cause in self._causes:
            if cause.turned is not None and (cause.felt or not felt_only):
                total = total + cause.turned(times_s, elevation, self._environment.supply_v(times_s))
        return total

    def _lagging_deg(self) -> np.ndarray:
        """What a filter of one time constant adds to the mean of each dwell, (n,)."""
        filter_s = max((cause.filter_s for cause in self._causes), default=0.0)
        if not filter_s:
            return np.zeros(len(self._times))
        clock_s = np.arange(0.0, self.when.duration_s, 1.0 / FILTER_RATE_HZ)
        elevation = self._bench.sensor(clock_s).angle_deg
        keep = math.exp(-1.0 / (FILTER_RATE_HZ * filter_s))
        start = [keep * elevation[0]]
        filtered, _ = lfilter([1.0 - keep], [1.0, -keep], elevation, zi=start)
        lag = np.interp(self._times.ravel(), clock_s, filtered - elevation)
        return np.asarray(lag.reshape(self._times.shape).mean(axis=1))

    def _headed(self) -> np.ndarray:
        """Where the stage came from, or where it goes while it is read: of the sign of the approach."""
        if self._layout.every_s is not None:
            return self._bench.mechanics.motor(self.when.begin_s).rate_dps
        return np.diff(self.when.target_deg, prepend=0.0)

    def _moved_deg(self) -> np.ndarray:
        """The gyro's integral from the end of the dwell before to the beginning of the dwell."""
        scale = 1.0 + 0.01 * self._imu._options.gyro_scale_error_pct[0]
        instants = np.stack([self.when.move_s, self.when.begin_s]).ravel()
        angle = self._bench.sensor(instants).angle_deg + self._turned_deg(instants, felt_only=True)
        before, after = angle.reshape(2, -1)
        return np.asarray(scale * (after - before))

    def poses(
        self, drawn: np.ndarray, nuisance: Mapping[str, np.ndarray], rng: np.random.Generator
    ) -> list[Pose]:
        """The poses with noise (n, 4) added."""
        reading = self.reading_deg + drawn[:, 0]
        norm = np.hypot(self.accel_g[:, 1], self.accel_g[:, 2]) * (1.0 + drawn[:, 2])
        angle = np.radians(_elevation_deg(self.accel_g) + drawn[:, 1])
        moved = self._moved_deg() + drawn[:, 3]
        middle_s = self._times.mean(axis=1)
        die_c = self._environment.die_c(middle_s) + rng.normal(0.0, 0.01, len(reading))
        approach = np.sign(self._headed())
        for k in range(1, len(approach)):
            approach[k] = approach[k] or approach[k - 1]
        columns = dict(nuisance)
        if "supply_v" in _covariates(self._causes):
            columns["supply_v"] = self._environment.supply_v(middle_s)
        across = self.accel_g[:, 0] + rng.normal(0.0, ACROSS_MG * 1e-3, len(reading))
        sweeps = self._layout.sweep if self._layout.every_s is None else np.zeros(len(reading))
        return [
            Pose(
                target_deg=float(self.when.target_deg[k]),
                reading_deg=float(reading[k]),
                sweep=int(sweeps[k]),
                approach=int(approach[k]),
                time_s=float(middle_s[k] - self.when.move_s[0]),
                temperature_c=float(die_c[k]),
                stage_deg=float(self.when.target_deg[k]),
                accel_x_g=float(across[k]),
                accel_y_g=float(norm[k] * math.sin(angle[k])),
                accel_z_g=float(norm[k] * math.cos(angle[k])),
                gyro_move_deg=None if k == 0 else float(moved[k]),
                settle_s=self._layout.settle_s,
                covariates={name: float(column[k]) for name, column in columns.items()},
            )
            for k in range(len(reading))
        ]


def _elevation_deg(accel_g: np.ndarray) -> np.ndarray:
    return np.asarray(np.degrees(np.arctan2(accel_g[..., 1], accel_g[..., 2])))


def _near(angle_deg: np.ndarray, target_deg: np.ndarray) -> np.ndarray:
    """An angle on the turn that its target is on."""
    return np.asarray(angle_deg + 360.0 * np.round((target_deg - angle_deg) / 360.0))
