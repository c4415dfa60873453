"""A joint solution as a person reads it."""

from __future__ import annotations

from typing import Any

from calrig.cli.printing import number, print_line, print_parameter, print_table, print_warnings


def print_solution(found: dict[str, Any]) -> None:
    """Prints a joint solution: what an elevation is worth, units, mounts, map, the error before and after."""
    print_verdict(found)
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
    print_stage(found)
    if found["advice"] is not None:
        print_line(f"recommended: {found['advice']['says']}")


def print_verdict(found: dict[str, Any]) -> None:
    """Whether stage and units are separable, and the noise."""
    verdict = f"stage and units are {'' if found['separable'] else 'not '}separable"
    print_line(f"{verdict}; a pose's noise is {number(found['noise']['std_deg'], '°')}", style="bold")


def print_stage(found: dict[str, Any]) -> None:
    """The stage's map, the error before and after, and what a person should know of it."""
    stage = found["stage"]
    error, orders = stage["map"]["error_deg"], len(stage["harmonics"])
    print_line(f"map of the stage: {min(error):+.3f}° to {max(error):+.3f}°, {orders} orders")
    for name in ("axis_dip_deg", "backlash_deg"):
        if (parameter := stage.get(name)) is not None:
            print_parameter(name, parameter)
    before, after = (number(found[model]["held_out_rms_deg"], "°") for model in ("before", "final"))
    print_line(f"held-out RMS: {before} without the map, {after} with the map")
    print_warnings(found["warnings"])


def _measurand(unit: dict[str, Any]) -> str:
    level = (unit["level"] or {"deg": {"std": None}})["deg"]
    if level["std"] is None:
        return ", less its mean"
    return f"; its level {level['value']:+.3f}° ± {level['std']:.2g}° is in it"


def _with_std(parameter: dict[str, float], unit: str) -> tuple[str, str]:
    return number(parameter["value"], unit), number(parameter["std"], unit)
