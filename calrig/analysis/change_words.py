"""What changed between two runs, in sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

from calrig.calibration.effects import EFFECTS
from calrig.calibration.histories import Differences

FIGURES = (("bias", "°"), ("scale", ""))
STANDS_OUT = 3.0
"""Standard uncertainties beyond which a figure is named beside the one that changed most."""


def difference_in_words(differences: Sequence[Differences], k: int, verdict: str) -> str:
    """The k-th difference of bias and scale: how far each moved, and what that is held against."""
    named = zip(FIGURES, differences, strict=True)
    known = [(name, unit, d) for (name, unit), d in named if math.isfinite(d.value[k])]
    if verdict == "not_known":
        moved = (f"{name} by {plus_minus(d.value[k], d.type_a_std[k], unit)}" for name, unit, d in known)
        by = " and ".join(moved) or "nothing that is known"
        return (
            f"Moved: {by} (the noise of both runs alone). What clamping anew and "
            "the day add is not known yet: that takes more units that were calibrated twice."
        )
    tested = [one for one in known if math.isfinite(one[2].std[k])]
    if verdict == "unchanged":
        by = ", ".join(f"{name} {plus_minus(d.value[k], d.std[k], unit)}" for name, unit, d in tested)
        return f"No more than repeatability: {by}."
    tested.sort(key=lambda one: -abs(one[2].sigma[k]))
    told = [tested[0], *(one for one in tested[1:] if abs(one[2].sigma[k]) > STANDS_OUT)]
    moved = (
        f"{name} moved by {plus_minus(d.value[k], d.std[k], unit)} ({abs(d.sigma[k]):.0f} times that)"
        for name, unit, d in told
    )
    return _sentence("; ".join(moved))


def traced_in_words(effects: Sequence[dict[str, Any]]) -> str:
    """Such as "z offset moved by 6.0 ± 0.1 mg."; without a capital where it begins with an axis."""
    said = []
    for effect in effects:
        moved = " and ".join(_moved(effect)) or f"{_title(effect['name'])} changed"
        others = " or ".join(_title(name).lower() for name in effect["confusable_with"])
        doubt = "" if effect["verdict"] == "named" else f" (or: {others or 'something else'})"
        said.append(f"{moved}{doubt}")
    return _sentence("; ".join(said))


def _moved(effect: dict[str, Any]) -> Iterator[str]:
    """Of each parameter that is more than its error; at least the most significant one."""
    known = effect["parameters"]
    catalogued = EFFECTS[effect["name"]].parameters if effect["name"] in EFFECTS else ()
    given = [
        (parameter, known[parameter.name]["value"], known[parameter.name]["std"])
        for parameter in catalogued
        if known.get(parameter.name) is not None and known[parameter.name]["std"]
    ]
    given.sort(key=lambda one: -abs(one[1]) / one[2])
    for place, (parameter, value, std) in enumerate(given):
        if place == 0 or abs(value) > STANDS_OUT * std:
            title = re.sub(r"^Offset of (\w+)$", r"\1 offset", parameter.title)
            yield f"{title} moved by {plus_minus(value, std, parameter.unit or '')}"


def _title(name: str) -> str:
    return EFFECTS[name].title if name in EFFECTS else name


def _sentence(words: str) -> str:
    return f"{words[0] if re.match('[xyz] ', words) else words[0].upper()}{words[1:]}."


def plus_minus(value: float, std: float, unit: str) -> str:
    """Such as "6.0 ± 0.1 mg": both to the first digit of the error."""
    unit = unit if unit in {"", "°"} else f" {unit}"
    if not (math.isfinite(std) and std > 0.0):
        return f"{value:.4g}{unit}".replace("-", "−")
    decimals = max(0, -math.floor(math.log10(std) + 0.02))
    rounded = round(value, decimals) + 0.0  # no −0.00
    return f"{rounded:.{decimals}f} ± {std:.{decimals}f}{unit}".replace("-", "−")
