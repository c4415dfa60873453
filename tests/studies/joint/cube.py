"""Units in a cube, clamped by any of its faces on a stage with a map: rotations, and the simulator's sensor.

Nothing here knows the joint model: directions are turned by `scipy.spatial.transform`, accelerations are made
into what is felt by the simulator's own physics, the gyro by a matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calrig.calibration.poses import Pose
from calrig.calibration.separation.pose_table import MountedPoses
from calrig.simulator.config import ImuOptions
from calrig.simulator.imu import Imu, Surroundings

from .rig import Stage, drawn_stage

UP = np.array([0.0, 0.0, 1.0])
ACCEL = ("accel_x_g", "accel_y_g", "accel_z_g")
MEANS = ("gyro_x_dps", "gyro_y_dps", "gyro_z_dps")
MOVES = ("gyro_move_x_deg", "gyro_move_y_deg", "gyro_move_z_deg")
PAIRS = ("xy", "xz", "yx", "yz", "zx", "zy")
SQUARE = {
    "x": Rotation.identity(),
    "y": Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "z": Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-x": Rotation.from_euler("z", 180, degrees=True),
}
"""From the table's frame, x along the stage's axis, to that of a cube that sits squarely."""


@dataclass(frozen=True)
class WholeUnit:
    """Errors of three axes of an accelerometer, and of a gyro."""

    bias_mg: tuple[float, ...] = (0.0, 0.0, 0.0)
    gain_pct: tuple[float, ...] = (0.0, 0.0, 0.0)
    cross_deg: tuple[float, ...] = (0.0,) * 6
    quadratic_mg: tuple[float, ...] = (0.0, 0.0, 0.0)
    cubic_mg: tuple[float, ...] = (0.0, 0.0, 0.0)
    gyro_bias_dps: tuple[float, ...] = (0.0, 0.0, 0.0)
    gyro_response: np.ndarray = None  # type: ignore[assignment]
    gyro_dps_per_g: np.ndarray = None  # type: ignore[assignment]

    def felt_g(self, force_g: np.ndarray) -> np.ndarray:
        """(n, 3) of a specific force (n, 3)."""
        options = ImuOptions(
            accel_bias_mg=tuple(self.bias_mg),
            accel_gain_error_pct=tuple(self.gain_pct),
            accel_cross_axis_deg=dict(zip(PAIRS, self.cross_deg, strict=True)),
            accel_quadratic_mg_per_g2=tuple(self.quadratic_mg),
            accel_cubic_mg_per_g3=tuple(self.cubic_mg),
        )
        nothing = np.zeros(len(force_g))
        return Imu(options).accel_g(force_g, Surroundings(nothing + options.reference_c, nothing, nothing))

    def in_sensor_frame(self) -> np.ndarray:
        """(3, 3) upper triangular: true = it·(felt − bias), curvatures aside."""
        response = (self.felt_g(np.eye(3)) - self.felt_g(-np.eye(3))).T / 2.0
        response -= np.diag(self.cubic_mg) / 1e3
        _, upper = np.linalg.qr(np.linalg.inv(response))
        return upper * np.sign(np.diag(upper))[:, None]

    def to_sensor_frame(self) -> np.ndarray:
        """(3, 3) rotation from the cube's frame to the sensor's own."""
        response = (self.felt_g(np.eye(3)) - self.felt_g(-np.eye(3))).T / 2.0 - np.diag(self.cubic_mg) / 1e3
        return self.in_sensor_frame() @ response


@dataclass(frozen=True)
class Seat:
    """One clamping: face, angle about the stage's axis, and how far the seat is off, as a rotation vector."""

    face: str
    angle_deg: float = 0.0
    off_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def rotation(self) -> Rotation:
        """From the table's frame to the cube's."""
        off = Rotation.from_rotvec(self.off_deg, degrees=True)
        return off * SQUARE[self.face] * Rotation.from_euler("x", -self.angle_deg, degrees=True)


@dataclass(frozen=True)
class CubeBench:
    """A unit, a stage whose axis dips, and the seats; the same dial angles in each."""

    unit: WholeUnit
    stage: Stage
    seats: tuple[Seat, ...]
    dial_deg: np.ndarray
    approach: np.ndarray
    dip_deg: float = 0.0
    noise_deg: float = 0.03
    gyro_density: float = 0.005
    """dps/√Hz, one-sided."""
    dwell_s: float = 2.0
    velocity_dps: float = 60.0
    earth_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In the frame of the stage that does not turn."""
    turns: tuple[int, ...] = ()
    """Full turns after the poses of a seat, of sense +1 or −1."""

    def up(self, seat: Seat, dial_deg: np.ndarray, approach: np.ndarray) -> np.ndarray:
        """(n, 3) in the cube's frame."""
        return self._seen(seat, dial_deg, approach, UP)

    def felt_g(self, seat: Seat) -> np.ndarray:
        """(n, 3) without noise."""
        return self.unit.felt_g(self.up(seat, self.dial_deg, self.approach))

    def measured(self, rng: np.random.Generator, name: str = "U0") -> list[MountedPoses]:
        """The poses of each seat; with turns, their gyro as well."""
        return [self._of_seat(seat, k, name, rng) for k, seat in enumerate(self.seats)]

    def _seen(self, seat: Seat, dial_deg: np.ndarray, approach: np.ndarray, what: np.ndarray) -> np.ndarray:
        table = self.stage.table_deg(dial_deg, approach)
        dip = Rotation.from_euler("y", self.dip_deg, degrees=True)
        return (seat.rotation() * Rotation.from_euler("x", -table[:, None], degrees=True) * dip).apply(what)

    def _of_seat(self, seat: Seat, place: int, name: str, rng: np.random.Generator) -> MountedPoses:
        dial = np.concatenate([self.dial_deg, self.dial_deg[-1] + 360.0 * np.cumsum(self.turns)])
        approach = np.concatenate([self.approach, np.sign(self.turns)])
        vector = self.unit.felt_g(self.up(seat, dial, approach))
        vector = vector + rng.normal(0.0, math.radians(self.noise_deg), vector.shape)
        gyro = self._gyro(seat, dial, approach, rng) if self.turns else [{}] * len(dial)
        poses = [
            Pose(
                target_deg=float(dial[k]),
                stage_deg=float(dial[k]),
                reading_deg=float(np.degrees(np.arctan2(vector[k, 1], vector[k, 2]))),
                approach=int(approach[k]),
                time_s=10.0 * (k + place * len(dial)),
                accel_x_g=float(vector[k, 0]),
                accel_y_g=float(vector[k, 1]),
                accel_z_g=float(vector[k, 2]),
                covariates=gyro[k],
            )
            for k in range(len(dial))
        ]
        return MountedPoses(name, f"m{place}", seat.angle_deg, "cube", poses, seat.face)

    def _gyro(
        self, seat: Seat, dial: np.ndarray, approach: np.ndarray, rng: np.random.Generator
    ) -> list[dict[str, float | None]]:
        """Means of each dwell, and integrals less the bias of the two dwells, of a rate that is constant."""
        white = self.gyro_density / math.sqrt(2.0)
        mean = self._rate_dps(seat, dial, approach)
        mean = mean + rng.normal(0.0, white / math.sqrt(self.dwell_s), mean.shape)
        found = [
            dict(zip(("gyro_x_dps", "gyro_y_dps", "gyro_z_dps"), map(float, row), strict=True))
            for row in mean
        ]
        for k in range(1, len(dial)):
            start, end = self.stage.table_deg(dial[k - 1 : k + 1], approach[k - 1 : k + 1])
            lasts = max(abs(end - start) / self.velocity_dps, 0.5)
            way = np.linspace(dial[k - 1], dial[k], 73)[:-1]
            drift = self._rate_dps(seat, way, np.full(len(way), approach[k])).mean(axis=0)
            axis = seat.rotation().apply([1.0, 0.0, 0.0])
            turned = self.unit.gyro_response @ axis * (end - start) + drift * lasts
            turned = turned + rng.normal(0.0, white * math.sqrt(lasts), 3)
            turned = turned - 0.5 * (mean[k] + mean[k - 1]) * lasts
            found[k] |= dict(zip(MOVES, map(float, turned), strict=True))
        return found

    def _rate_dps(self, seat: Seat, dial: np.ndarray, approach: np.ndarray) -> np.ndarray:
        """(n, 3) that the gyro says where the stage stands."""
        earth = self._seen(seat, dial, approach, np.array(self.earth_dps))
        force = self.up(seat, dial, approach)
        return (
            earth @ self.unit.gyro_response.T
            + force @ self.unit.gyro_dps_per_g.T
            + np.array(self.unit.gyro_bias_dps)
        )


def drawn_whole_unit(rng: np.random.Generator, *, cubic: bool = True) -> WholeUnit:
    """A unit of the size of the issue's, a degree askew in its case; gyro 1 % and 1° off, 0.1 dps/g."""
    curved = 5.0 if cubic else 0.0
    return WholeUnit(
        tuple(rng.normal(0.0, (50.0, 50.0, 80.0))),
        tuple(rng.normal(0.0, 2.0, 3)),
        tuple(rng.normal(0.0, 0.7, 6)),
        tuple(rng.normal(0.0, curved, 3)),
        tuple(rng.normal(0.0, curved, 3)),
        tuple(rng.normal(0.0, 1.0, 3)),
        np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
        rng.normal(0.0, 0.05, (3, 3)),
    )


def drawn_cube_bench(
    seed: int,
    *,
    cubic: bool = True,
    n: int = 24,
    faces: tuple[str, ...] = ("x", "y", "z"),
    highest: int = 6,
    turns: tuple[int, ...] = (),
) -> CubeBench:
    """Full turns on an unknown stage of 0.29°, seats a third of a degree off, an axis that dips."""
    rng = np.random.default_rng([seed, 155])
    unit, stage = drawn_whole_unit(rng, cubic=cubic), drawn_stage(rng, highest)
    seats = tuple(Seat(face, float(rng.normal(0.0, 0.8)), tuple(rng.normal(0.0, 0.3, 3))) for face in faces)
    dial = np.linspace(-180.0, 180.0, n, endpoint=False)
    latitude = math.radians(50.0)
    east = rng.uniform(0.0, 2.0 * math.pi)
    earth = np.array(
        [math.cos(latitude) * math.cos(east), math.cos(latitude) * math.sin(east), math.sin(latitude)]
    )
    return CubeBench(
        unit,
        stage,
        seats,
        dial,
        np.ones(n),
        dip_deg=float(rng.normal(0.0, 0.3)),
        earth_dps=tuple(15.041 / 3600.0 * earth),
        turns=turns,
    )


def as_csv(lots: list[MountedPoses]) -> str:
    """The poses as a file for `calrig solve`."""
    names = ("target_deg", "stage_deg", "reading_deg", "approach", "time_s", *ACCEL)
    own = [name for name in (*MEANS, *MOVES) if any(name in p.covariates for lot in lots for p in lot.poses)]
    rows = [[*names, *own, "unit", "mount", "mount_deg", "mount_axis"]]
    for lot in lots:
        for pose in lot.poses:
            cells = [getattr(pose, name) for name in names] + [pose.covariates.get(name) for name in own]
            texts = ["" if cell is None else f"{cell:.9g}" for cell in cells]
            rows.append([*texts, lot.unit, lot.mount, f"{lot.nominal_deg:.4f}", lot.axis])
    return "\n".join(map(",".join, rows)) + "\n"
