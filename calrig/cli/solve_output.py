"""A joint solution as a person reads it."""

from __future__ import annotations

from typing import Any

from calrig.cli.printing import number, print_line, print_parameter, print_table, print_warnings


def print_solution(found: dict[str, Any]) -> None:
    """Prints a joint solution: what an elevation is worth, units, mounts, map, the error before and after."""
    verdict = "stage and units told apart" if found["separable"] else "stage and units not told apart"
    print_line(f"{verdict}; a pose's noise is {number(found['noise']['std_deg'], '°')}", style="bold")
    for unit in found["units"]:
        worst = max(unit["elevation_std_deg"]["std_deg"])
        low, high = unit["range_deg"]
        of_what = _measurand(unit)
        print_line(f"\nunit {unit['unit']}: elevation ± {worst:.2g}° at most, {low:g}° to {high:g}°{of_what}")
        for name, parameter in unit["parameters"].items():
            print_parameter(name, parameter)
    print_line("")
    mounts = (
        (one["mount"], one["unit"], f"{one['mount_deg']:g}°", *_with_std(one["angle_deg"], "°"))
        for one in found["mounts"]
    )
    print_table(("mount", "unit", "stated", "found", "±"), mounts)
    error, orders = found["stage"]["map"]["error_deg"], len(found["stage"]["harmonics"])
    print_line(f"map of the stage: {min(error):+.3f}° to {max(error):+.3f}°, {orders} orders")
    if found["stage"]["backlash_deg"] is not None:
        print_parameter("backlash_deg", found["stage"]["backlash_deg"])
    before, after = (number(found[model]["held_out_rms_deg"], "°") for model in ("before", "final"))
    print_line(f"RMS of held-out stretches: {before} believing the stage, {after} with its map")
    print_warnings(found["warnings"])
    if found["advice"] is not None:
        print_line(f"what would help: {found['advice']['says']}")


def _measurand(unit: dict[str, Any]) -> str:
    level = (unit["level"] or {"deg": {"std": None}})["deg"]
    if level["std"] is None:
        return ", less its mean"
    return f"; its level {level['value']:+.3f}° ± {level['std']:.2g}° is in it"


def _with_std(parameter: dict[str, float], unit: str) -> tuple[str, str]:
    return number(parameter["value"], unit), number(parameter["std"], unit)
