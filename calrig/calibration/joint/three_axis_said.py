"""What a person should know of a solution of whole units: what the poses did not tell, and what would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.joint.mapped import Mapped
from calrig.calibration.joint.said import OFF_DEG, is_better, of_untold_orders
from calrig.calibration.joint.stage_map import TURN_DEG, goes_round, widest_gap_deg
from calrig.calibration.joint.three_axis_fit import fitted_whole
from calrig.calibration.joint.three_axis_frame import Frame, axes_of, seats_std_rad, untold
from calrig.calibration.joint.three_axis_gyro import WholeGyro
from calrig.calibration.joint.three_axis_solution import ThreeAxisSolution
from calrig.estimation.angles import AXES, wrap_deg

CLOCK_ERRORS = 3.0
"""Standard errors from which a clock is said to be off."""


def three_axis_sentences(
    solution: ThreeAxisSolution, on_stage: Mapped, gyros: Sequence[WholeGyro | None], frame: Frame
) -> list[str]:
    """All that is to be said, the weightiest first."""
    said = _of_linear(solution)
    for unit, gyro in enumerate(gyros):
        said += [*_of_accelerometer(solution, unit, frame), *_of_gyro(solution.table.units[unit], gyro)]
    return [*said, *_of_mounts(solution, on_stage), *_of_dial(solution)]


def _of_accelerometer(solution: ThreeAxisSolution, unit: int, frame: Frame) -> list[str]:
    """What of it the poses do not tell, and how well its seats repeat."""
    fit, serial, axes = solution.fit, solution.table.units[unit], axes_of(solution.fit, unit)
    missing = [axis for axis in AXES if axis not in axes]
    if names := untold(fit, unit):
        told, asked = fit.told()
        remedy = (
            f": clamp it with its {' and its '.join(missing)} along the stage's axis too" if missing else ""
        )
        return [
            f"unit {serial}: these poses do not tell {', '.join(names)} ({told} of {asked} parameters are "
            f"told, by singular values), so there is no matrix of it{remedy}"
        ]
    if frame == "faces" and len(axes) == len(AXES):
        seat_deg = float(np.degrees(seats_std_rad(fit, unit)))
        return [
            f"unit {serial}: the faces were off by {seat_deg:.2g}° from being square, root mean square: the "
            "frame of the matrix is as good as that, its other six numbers are better"
        ]
    return []


def _of_gyro(serial: str, gyro: WholeGyro | None) -> list[str]:
    if gyro is None:
        return []
    said = []
    if gyro.turns is None:
        said.append(
            f"unit {serial}: no gyro matrix: it needs gyro_move_x_deg, gyro_move_y_deg and gyro_move_z_deg "
            "of moves in mounts with x, y and z along the stage's axis"
        )
    else:
        if not gyro.turns.closed:
            said.append(
                f"unit {serial}: no full turns: the gyro's scale rests on the stage's map; turns of 360° "
                "between dwells do not"
            )
        if gyro.turns.one_way:
            said.append(
                f"unit {serial}: turned one way only: Earth's rate and gravity's influence stay in the "
                "gyro's matrix and its uncertainty; turn both ways"
            )
    if gyro.clock is not None and abs(gyro.clock.error) > CLOCK_ERRORS * gyro.clock.std:
        way = "fast" if gyro.clock.error > 0.0 else "slow"
        said.append(
            f"unit {serial}: the board's clock is {way} by {1e6 * abs(gyro.clock.error):.0f} ppm ± "
            f"{1e6 * gyro.clock.std:.0f} ppm of the host's; the gyro's matrix is for the board's seconds"
        )
    if gyro.dwells is not None and not gyro.dwells.told:
        said.append(f"unit {serial}: these attitudes do not tell what gravity does to the gyro")
    return said


def _of_linear(solution: ThreeAxisSolution) -> list[str]:
    """Whether the poses contradict that the units are."""
    fit = solution.fit
    if not fit.problem.linear:
        return []
    bent = fitted_whole(replace(fit.problem, linear=False), fit.weights, fit.parameters)
    said = "the units are stated to be linear, and these poses contradict that"
    return [said] if is_better(bent, fit) else []


def _of_mounts(solution: ThreeAxisSolution, on_stage: Mapped) -> list[str]:
    """Mounts that stand elsewhere than somebody said."""
    return [
        f"mount {mount.name} of unit {solution.table.units[mount.unit]}: mount_deg is {mount.nominal_deg:g}, "
        f"gravity says {mount.on_its_turn(float(angle_deg)):.1f}° about {face}"
        for mount, angle_deg, face in zip(
            solution.table.mounts, on_stage.mounts_deg, solution.of.faces, strict=True
        )
        if mount.nominal_deg is not None and abs(wrap_deg(float(angle_deg) - mount.nominal_deg)) > OFF_DEG
    ]


def _of_dial(solution: ThreeAxisSolution) -> list[str]:
    dial, said = solution.table.dial_deg[solution.fit.kept], []
    if not goes_round(dial):
        arc = TURN_DEG - widest_gap_deg(dial)
        said.append(f"the poses stand on {arc:.0f}° of the dial: the map is known there and nowhere else")
    return [*said, *of_untold_orders(solution.choice)]
