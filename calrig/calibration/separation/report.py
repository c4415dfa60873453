"""Write the joint solution as CONTRACT section 8's document, and its pose residuals for figures."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.progress import Progress, unheard
from calrig.calibration.separation.accelerometer import (
    PLANE_CURVATURES,
    PLANE_NAMES,
    PLANE_PER_C,
    PLANE_QUARTIC,
)
from calrig.calibration.separation.gyro import WholeGyro, whole_gyro
from calrig.calibration.separation.held_out import HeldOut, believing_the_stage, held_out
from calrig.calibration.separation.level import Level
from calrig.calibration.separation.map_report import Mapped, mapped
from calrig.calibration.separation.messages import advised, messages_of
from calrig.calibration.separation.solution import Solution
from calrig.calibration.separation.stage_map import basis
from calrig.calibration.separation.unit_results import (
    Accelerometer,
    ElevationUncertainty,
    accelerometer,
    polynomial,
)
from calrig.estimation.angles import FloatArray
from calrig.model.solution import Frame

Value = dict[str, float | None]
UNITS = {
    "y": ("y_mg", 1e3),
    "z": ("z_mg", 1e3),
    "gain": ("gain_pct", 1e2),
    "skew": ("skew_deg", float(np.degrees(1.0))),
    "y2": ("y_mg_per_g2", 1e3),
    "y3": ("y_mg_per_g3", 1e3),
    "z2": ("z_mg_per_g2", 1e3),
    "z3": ("z_mg_per_g3", 1e3),
    "y_per_c": ("y_mg_per_c", 1e3),
    "z_per_c": ("z_mg_per_c", 1e3),
    "y4": ("y_mg_per_g4", 1e3),
    "z4": ("z_mg_per_g4", 1e3),
}
"""A document's names of the parameters, and their units."""


def value(number: float, std: float | None) -> Value:
    """A parameter with its standard error."""
    return {"value": float(number), "std": None if std is None else float(std)}


def uncertainty_document(known: ElevationUncertainty) -> dict[str, Any]:
    """The standard errors of a unit's elevation, and over which range."""
    return {
        "range_deg": known.elevation_deg[[0, -1]].tolist(),
        "elevation_std_deg": {
            "elevation_deg": known.elevation_deg.tolist(),
            "std_deg": known.std_deg.tolist(),
        },
    }


def map_document(on_stage: Mapped) -> dict[str, Any]:
    """The stage's error over its dial."""
    return {
        "stage_deg": on_stage.stage_deg.tolist(),
        "error_deg": _known(on_stage.error_deg),
        "std_deg": _known(on_stage.std_deg),
    }


def _known(values: FloatArray) -> list[float | None]:
    """The values for JSON, null of what is not known."""
    return [value if math.isfinite(value) else None for value in values.tolist()]


@dataclass(frozen=True, slots=True, eq=False)
class WholeUnit:
    """A unit's accelerometer and gyro as matrices; None of what the poses do not identify."""

    accelerometer: Accelerometer | None
    gyro: WholeGyro | None


def whole_units(solution: Solution, frame: Frame = "sensor") -> list[WholeUnit]:
    """Return each unit's matrices in the frame asked for; none of units in the plane."""
    if not solution.table.is_whole:
        return [WholeUnit(None, None)] * len(solution.table.units)
    found = []
    for unit in range(len(solution.table.units)):
        whole = accelerometer(solution.fit, unit, frame)
        found.append(WholeUnit(whole, whole_gyro(solution.fit, unit, whole)))
    return found


def solution_document(
    solution: Solution,
    limits_deg: tuple[float, float] | None = None,
    progress: Progress = unheard,
    *,
    frame: Frame = "sensor",
) -> dict[str, Any]:
    """Return everything that was solved for, how well it is known, and which mounts would help.

    Mounts are advised within the `limits_deg` of the dial. `progress` is called with the share that is done;
    `frame` is of the accelerometers' matrices.
    """
    fit, on_stage = solution.fit, mapped(solution)
    tested, wholes = held_out(fit, progress), whole_units(solution, frame)
    is_whole = solution.table.is_whole
    advice = advised(solution, limits_deg)
    messages = messages_of(solution, on_stage, [whole.gyro for whole in wholes], frame)
    if not is_whole and tested.final_deg >= tested.before_deg:
        messages.append("held-out poses are predicted no better with the map than without it")
    return {
        "units": [_unit(solution, unit, whole) for unit, whole in enumerate(wholes)],
        "stage": _stage(solution, on_stage),
        "mounts": _mounts(solution, on_stage),
        "separable": solution.are_separable,
        **({"rank": dict(zip(("told", "parameters"), fit.identified(), strict=True))} if is_whole else {}),
        "advice": None if advice is None else advice.model_dump(),
        **_figures(solution, tested),
        **_levels(solution),
        "warnings": [*solution.warnings, *messages],
    }


def parameters_of(solution: Solution, unit: int) -> dict[str, Value]:
    """Return a unit's parameters about its x axis in the units of documents.

    Those of temperature where the data carry them; without a standard error what is fixed.
    """
    plane, reference_c = solution.planes[unit], float(solution.table.reference_c[unit])
    stds, is_warmed = np.sqrt(np.maximum(np.diag(plane.covariance), 0.0)), bool(np.isfinite(reference_c))
    has_quartic = solution.fit.problem.spread.quartic_g > 0.0
    found: dict[str, Value] = {}
    for name, (stated_as, factor) in UNITS.items():
        k = PLANE_NAMES.index(name)
        if (k in PLANE_PER_C and not is_warmed) or (k in PLANE_QUARTIC and not has_quartic):
            continue
        is_fixed = solution.fit.problem.linear and k in PLANE_CURVATURES
        found[stated_as] = value(factor * plane.own[k], None if is_fixed else factor * stds[k])
    if is_warmed:
        found["reference_c"] = value(reference_c, None)
    return found


def _unit(solution: Solution, unit: int, whole: WholeUnit) -> dict[str, Any]:
    known, level, linear = solution.measurand(unit), solution.levels[unit], solution.fit.problem.linear
    coefficients, covariance = polynomial(solution.planes[unit], known.elevation_deg)
    stds = [None, None] if linear else np.sqrt(np.maximum(np.diag(covariance), 0.0))
    names = ("deg_per_deg2", "deg_per_deg3")
    shape = solution.fit.problem.shape
    noise_mg = {} if shape is None else {"noise_mg": (1e3 * solution.fit.noise * shape[unit]).tolist()}
    return {
        "unit": solution.table.units[unit],
        "parameters": {
            **parameters_of(solution, unit),
            **{name: value(c, s) for name, c, s in zip(names, coefficients, stds, strict=True)},
        },
        "accelerometer": accelerometer_document(whole.accelerometer),
        "gyro": gyro_document(whole.gyro),
        **noise_mg,
        **uncertainty_document(known),
        "level": None if level is None else level_document(level),
    }


def accelerometer_document(found: Accelerometer | None) -> dict[str, Any] | None:
    """What makes true = matrix·(raw − bias); curvatures q·u² + c·u³ are to be taken off raw before."""
    if found is None:
        return None
    return {
        "bias_g": found.bias_g.tolist(),
        "matrix": found.matrix.tolist(),
        "covariance": found.covariance.tolist(),
        "frame": found.frame,
        "quadratic_g_per_g2": None if found.curvature_g is None else found.curvature_g[0].tolist(),
        "cubic_g_per_g3": None if found.curvature_g is None else found.curvature_g[1].tolist(),
    }


def gyro_document(found: WholeGyro | None) -> dict[str, Any] | None:
    """What makes true = matrix·(raw − bias − dps_per_g·a), time being the board's."""
    if found is None:
        return None
    dwells, turns = found.dwells, found.turns
    return {
        "bias_dps": None if dwells is None else dwells.bias_dps.tolist(),
        "bias_std_dps": None if dwells is None else dwells.bias_std_dps.tolist(),
        "matrix": _listed(found.matrix),
        "matrix_std": _listed(found.matrix_std),
        "dps_per_g": _listed(found.dps_per_g),
        "dps_per_g_std": _listed(found.dps_per_g_std),
        "turns": None
        if turns is None
        else {
            "n": turns.n,
            "closed": turns.closed,
            "both_ways": not turns.one_way,
            "noise_deg": turns.noise_deg,
        },
        "clock": "board",
        "clock_error_ppm": None
        if found.clock is None
        else value(1e6 * found.clock.error, 1e6 * found.clock.std),
    }


def level_document(level: Level) -> dict[str, Any]:
    """The angle of the sensor in its case, and what its standard error rests on."""
    return {
        "deg": value(level.value_deg, level.std_deg),
        "reversals": level.reversals,
        "seat_std_deg": level.seat_std_deg,
        "seat_from": level.seat_from,
    }


def _levels(solution: Solution) -> dict[str, Any]:
    """Whether the level of every unit is known, and of all of them the worst."""
    levels = [solution.known_level(unit) for unit in range(len(solution.table.units))]
    stds = [level.std_deg for level in levels if level is not None and level.std_deg is not None]
    known = len(stds) == len(levels)
    return {"level_known": known, "level_std_deg": max(stds) if known else None}


def _stage(solution: Solution, on_stage: Mapped) -> dict[str, Any]:
    """The stage's map, its harmonics and backlash; the dip of its axis, which whole units alone show."""
    fit, at = solution.fit, solution.fit.problem.dip_at
    dip = [value(*one) for one in np.degrees([fit.parameters[at], fit.stds[at]]).T]
    return {
        "map": map_document(on_stage),
        "harmonics": [harmonic.model_dump() for harmonic in on_stage.harmonics],
        "backlash_deg": None if on_stage.backlash is None else value(*on_stage.backlash),
        **({"axis_dip_deg": dip[0]} if dip else {}),
    }


def _figures(solution: Solution, tested: HeldOut) -> dict[str, Any]:
    """The error of held-out poses before and after, and the noise."""
    return {
        "held_out": {"how": f"{tested.stretches} stretches of elevation", "n_poses": tested.n_poses},
        "before": {"held_out_rms_deg": tested.before_deg},
        "final": {"held_out_rms_deg": tested.final_deg},
        "noise": {
            "std_deg": solution.noise_deg,
            "lag1_correlation": solution.fit.problem.correlation,
        },
    }


def _mounts(solution: Solution, on_stage: Mapped) -> list[dict[str, Any]]:
    fit, table = solution.fit, solution.table
    p_values = {test.mount: test.p_value for test in solution.mount_tests}
    found = []
    for k, mount in enumerate(table.mounts):
        tilts = np.degrees(fit.parameters[fit.problem.tilts_at(k)]).tolist()
        angle_deg = mount.on_its_turn(float(on_stage.mounts_deg[k]))
        found.append(
            {
                "mount": mount.name,
                "unit": table.units[mount.unit],
                "mount_deg": mount.nominal_deg or 0.0,
                "mount_axis": mount.axis,
                "angle_deg": value(angle_deg, on_stage.mounts_std_deg[k]),
                **({"tilts_deg": tilts} if table.is_whole else {"fits_p_value": p_values.get(k)}),
            }
        )
    return found


def _listed(matrix: Any) -> list[list[float]] | None:
    return None if matrix is None else matrix.tolist()


DECIMALS = 6
"""Of a degree: what is kept to be drawn need not be more."""


def pose_residuals(solution: Solution) -> dict[str, list[Any]]:
    """Columns of the poses that were not left out as an outlier, in degrees.

    `mount` is the index of the pose's mount, `dial_deg` the stage's own angle, `on_map_deg` the map there
    (less its mean, and without play) with what the pose leaves of it; `before_deg` is what it leaves
    of the unit's elevation believing the stage, `left_deg` with its map. Of
    whole units all columns are empty.
    """
    fit, table = solution.fit, solution.table
    if table.is_whole:
        return {name: [] for name in ("mount", "dial_deg", "on_map_deg", "before_deg", "left_deg")}
    before, left = np.degrees(believing_the_stage(fit).left()), np.degrees(fit.left())
    series = basis(table.dial_deg, np.zeros(len(table)), fit.problem.orders)
    on_map = series @ np.degrees(fit.parameters[fit.problem.map_at]) - mapped(solution).mean_deg + left
    columns = {
        "dial_deg": table.dial_deg,
        "on_map_deg": on_map,
        "before_deg": table.sense * before,
        "left_deg": table.sense * left,
    }
    return {
        "mount": table.mount[fit.kept].tolist(),
        **{name: [round(v, DECIMALS) for v in of[fit.kept].tolist()] for name, of in columns.items()},
    }
