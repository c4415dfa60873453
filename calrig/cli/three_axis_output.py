"""A solution of whole units as a person reads it."""

from __future__ import annotations

from typing import Any

from calrig.cli.printing import number, print_line, print_table
from calrig.cli.solve_output import print_stage, print_verdict

AXES = "xyz"


def print_whole(found: dict[str, Any]) -> None:
    """Prints accelerometers, gyros, mounts, map, the error before and after."""
    print_verdict(found)
    for unit in found["units"]:
        print_line("")
        _print_accelerometer(unit)
        if unit["gyro"] is not None:
            _print_gyro(unit["gyro"])
        worst, (low, high) = max(unit["elevation_std_deg"]["std_deg"]), unit["range_deg"]
        print_line(f"elevation ± {worst:.2g}° at most, {low:g}° to {high:g}°, less its mean")
    print_line("")
    mounts = (
        (
            one["mount"],
            one["unit"],
            one["mount_axis"],
            f"{one['mount_deg']:g}°",
            number(one["angle_deg"]["value"], "°"),
            number(one["angle_deg"]["std"], "°"),
        )
        for one in found["mounts"]
    )
    print_table(("mount", "unit", "axis", "stated", "found", "±"), mounts)
    print_stage(found)


def _print_accelerometer(unit: dict[str, Any]) -> None:
    found = unit["accelerometer"]
    if found is None:
        print_line(f"unit {unit['unit']}: its accelerometer is not told")
        return
    stds = [found["covariance"][k][k] ** 0.5 for k in range(12)]
    rows = (
        (
            axis,
            _with(1e3 * found["bias_g"][k], 1e3 * stds[k], 2),
            *(_with(found["matrix"][k][m], stds[3 + 3 * k + m], 5) for m in range(3)),
            f"{unit['noise_mg'][k]:.2f}",
        )
        for k, axis in enumerate(AXES)
    )
    headings = ("", "offset, mg", *(f"matrix {axis}" for axis in AXES), "noise, mg")
    frame = "the sensor's own frame" if found["frame"] == "sensor" else "the frame of its faces"
    title = f"unit {unit['unit']}: accelerometer, in {frame}"
    print_table(headings, rows, title=title, caption="true = matrix·(raw − offset)")


def _print_gyro(found: dict[str, Any]) -> None:
    unknown = [[None] * 3] * 3
    matrix, stds = found["matrix"] or unknown, found["matrix_std"] or unknown
    per_g, per_g_std = found["dps_per_g"] or unknown, found["dps_per_g_std"] or unknown
    bias, bias_std = found["bias_dps"] or [None] * 3, found["bias_std_dps"] or [None] * 3
    rows = (
        (
            axis,
            _with(bias[k], bias_std[k], 4),
            *(_with(matrix[k][m], stds[k][m], 6) for m in range(3)),
            *(_with(per_g[k][m], per_g_std[k][m], 4) for m in range(3)),
        )
        for k, axis in enumerate(AXES)
    )
    headings = (
        "",
        "bias, °/s",
        *(f"matrix {axis}" for axis in AXES),
        *(f"°/s per g {axis}" for axis in AXES),
    )
    caption = "true = matrix·(raw − bias − per g·a), against the board's clock"
    print_table(headings, rows, title="gyro", caption=caption)


def _with(value: float | None, std: float | None, decimals: int) -> str:
    if value is None:
        return "not known"
    return f"{value:.{decimals}f}" + ("" if not std else f" ± {std:.2g}")
