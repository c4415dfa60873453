"""A unit's calibration as `calibration.h`: plain C99 in `float`, no allocation, section 6's arithmetic."""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from calrig.calibration.correction import (
    ApplyError,
    Circumstances,
    Parameters,
    effects_on_reading_deg,
    numbers_of,
)
from calrig.calibration.effects import CATALOGUE

OF_THE_UNIT = frozenset({"sensor", "mounting"})
IN_MOTION = frozenset({"gyro_scale"})
"""Of the unit, but seen only after a move: a standing unit's elevation needs no correction for it."""
LARGEST_FLOAT = float(np.finfo(np.float32).max)
SMALLEST_FLOAT = float(np.finfo(np.float32).tiny)
CLOSE_DEG = 1e-6
STEEPEST = 0.5
"""Of the effects against the scale: where they change faster, the iteration takes too many rounds."""
BEYOND_C = 40.0
LONGEST_LINE = 160


def c_header(document: Mapping[str, Any]) -> str:
    """The header of a calibration document (CONTRACT section 6).

    It defines `static inline float calrig_elevation_deg(float reading_deg, float temperature_c)`. Effects of
    a rig are left out. Where an effect depends on the elevation, the function repeats
    θ = (reading − bias − effects(θ))/scale a number of times that is fixed here.

    Raises:
        ApplyError: an effect has no formula, or is too large to be taken out by a few rounds.
        ValueError: a number of the document is not known, or not one that a `float` holds.
    """
    effects, left_out = _sorted_out(document)
    rounds = _rounds(document, effects)
    guard = _guard(str(document["unit"]))
    bias_deg, scale = _finite(document, "bias_deg"), _finite(document, "scale")
    terms = [_TERMS[name](parameters) for name, parameters in effects]
    body = [
        f"    const float scale = {_literal(scale)};",
        f"    float aim = reading_deg - {_literal(bias_deg)};",
        "    float theta;",
    ]
    if not any("temperature_c" in term for term in terms):
        body.append("    (void)temperature_c;")
    body += ["    aim -= 360.0f * ceilf((aim - 180.0f) / 360.0f);", "    theta = aim / scale;"]
    if terms:
        body += _loop(terms, rounds)
    body.append("    return theta;")
    return "\n".join(
        [
            *_comment(document, [name for name, _ in effects], left_out),
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <math.h>",
            "",
            "static inline float calrig_elevation_deg(float reading_deg, float temperature_c)",
            "{",
            *body,
            "}",
            "",
            f"#endif /* {guard} */",
            "",
        ]
    )


def _sorted_out(document: Mapping[str, Any]) -> tuple[list[tuple[str, Parameters]], list[str]]:
    """The effects to be taken out, and the names of those that are not for a unit at rest."""
    origins = {effect.name: effect.origin for effect in CATALOGUE}
    taken: list[tuple[str, Parameters]] = []
    left_out: list[str] = []
    for effect in document["effects"]:
        name = str(effect["name"])
        if name in IN_MOTION or (name in origins and origins[name] not in OF_THE_UNIT):
            left_out.append(name)
        elif name in _TERMS:
            taken.append((name, numbers_of(effect["parameters"])))
        else:
            raise ApplyError(f"the effect {name!r} has no formula of its own that a header could hold")
    return taken, left_out


def _rounds(document: Mapping[str, Any], effects: list[tuple[str, Parameters]]) -> int:
    """How often θ = (aim − effects(θ))/scale is repeated: until a round moves θ by less than a `float`."""
    low, high = (float(limit) for limit in document["range_deg"])
    theta = np.linspace(low, high, 721) if high > low else np.array([low - 1.0, low, low + 1.0])
    known = [value for value in (document.get("temperature_c") or {}).values() if value is not None]
    known += [parameters["reference_c"] for _, parameters in effects if "reference_c" in parameters]
    coldest, warmest = min(known, default=0.0) - BEYOND_C, max(known, default=0.0) + BEYOND_C
    steepest = 0.0
    for celsius in (coldest, warmest):
        given = Circumstances(temperature_c=np.full(len(theta), celsius))
        slope = np.gradient(effects_on_reading_deg(effects, theta, given), theta)
        steepest = max(steepest, float(np.abs(slope).max()) / abs(_finite(document, "scale")))
    if not steepest <= STEEPEST:
        raise ApplyError(
            f"the effects change the reading by {steepest:.2g}° a degree: not a small correction"
        )
    if steepest < 1e-9:
        return 1
    return max(2, math.ceil(math.log(CLOSE_DEG / 360.0) / math.log(steepest)) + 1)


def _loop(terms: list[str], rounds: int) -> list[str]:
    """The statements that take the effects out; each term adds to `effects` and may use s, c and theta."""
    angles = any(re.search(r"\b[sc]\b", term) for term in terms)
    return [
        f"    for (int k = 0; k < {rounds}; k++) {{",
        "        float effects = 0.0f;",
        *(["        const float s = sinf(theta * 0.01745329252f);"] if angles else []),
        *(["        const float c = cosf(theta * 0.01745329252f);"] if angles else []),
        *(f"        effects += {term};" for term in terms),
        "        theta = (aim - effects) / scale;",
        "    }",
    ]


def _turn(across: str, along: str) -> str:
    return f"57.29577951f * atan2f({across}, 1.0f + {along})"


def _offset(p: Parameters) -> str:
    y, z = (_literal(p.get(name, 0.0) / 1e3) for name in ("y_mg", "z_mg"))
    return _turn(f"{y} * c - {z} * s", f"{y} * s + {z} * c")


def _mismatch(p: Parameters) -> str:
    gain = p.get("gain_pct", 0.0) / 100.0
    skew = (1.0 + gain) * math.sin(math.radians(p.get("skew_deg", 0.0)))
    error = f"({_literal(gain)} * s + {_literal(skew)} * c)"
    return _turn(f"{error} * c", f"{error} * s")


def _polynomial(p: Parameters) -> str:
    square, cube = (_literal(p.get(name, 0.0)) for name in ("deg_per_deg2", "deg_per_deg3"))
    return f"({square} + {cube} * theta) * theta * theta"


def _with_temperature(p: Parameters) -> str:
    deg_per_c = p.get("deg_per_c", 0.0)
    if not p.get("of_axis_y"):
        return f"{_literal(deg_per_c)} * {_warmer(p)}"
    y = f"{_literal(math.radians(deg_per_c))} * {_warmer(p)}"
    return _turn(f"{y} * c", f"{y} * s")


def _warmer(p: Parameters) -> str:
    return f"(temperature_c - {_literal(p['reference_c'])})"


_TERMS: dict[str, Callable[[Parameters], str]] = {
    "accelerometer_offset": _offset,
    "axis_mismatch": _mismatch,
    "nonlinearity": _polynomial,
    "temperature_bias": _with_temperature,
    "temperature_curvature": lambda p: f"{_literal(p.get('deg_per_c2', 0.0))} * {_warmer(p)} * {_warmer(p)}",
    "temperature_scale": lambda p: f"{_literal(p.get('per_c', 0.0))} * {_warmer(p)} * theta",
    "mount_slip": lambda p: _literal(p.get("step_deg", 0.0)),
}
"""What `applied` computes, as C expressions; a slip has happened, so that its whole step stays."""


def _literal(value: float) -> str:
    """A `float` constant, in brackets where it is negative."""
    if not math.isfinite(value) or abs(value) > LARGEST_FLOAT:
        raise ValueError(f"{value} is not a number that a float holds")
    text = f"{value if abs(value) >= SMALLEST_FLOAT else 0.0:.9g}"
    text = text if re.search(r"[.e]", text) else f"{text}.0"
    return f"({text}f)" if text.startswith("-") else f"{text}f"


def _finite(document: Mapping[str, Any], key: str) -> float:
    value = document[key]
    if value is None or not math.isfinite(value):
        raise ValueError(f"{key} is not known: there is nothing to apply")
    return float(value)


def _guard(unit: str) -> str:
    """An identifier of its own for every serial number: two units' headers in one program are an error."""
    name = re.sub(r"[^A-Z0-9]+", "_", unit.upper()).strip("_")[:32]
    return f"CALRIG_{name}_{zlib.crc32(unit.encode()):08X}_H"


def _comment(document: Mapping[str, Any], effects: list[str], left_out: list[str]) -> list[str]:
    low, high = document["range_deg"]
    expanded = document.get("expanded_uncertainty_deg")
    worth = "not known" if expanded is None else f"{expanded:.3g} deg (k = {document['coverage_factor']})"
    lines = [
        f"Calibration of the unit {document['unit']}, run {document['run_id']}, {document['calibrated_at']}",
        "elevation = (reading - bias - effects)/scale, degrees; temperature in degrees Celsius",
        f"range {low:.6g} to {high:.6g} deg; expanded uncertainty {worth}",
        f"effects: {', '.join(effects) or 'none'}",
    ]
    if left_out:
        lines.append(f"accepted, but not of this unit at rest: {', '.join(left_out)}")
    if any("temperature" in name for name in effects):
        lines.append("where no thermometer is read, pass the reference temperature of the effects")
    return ["/*", *(f" * {_harmless(line)}" for line in lines), " */"]


def _harmless(text: str) -> str:
    """Text that cannot end a comment, begin one, join lines or turn the writing round."""
    return re.sub(r"[^ -~]|[*\\?]", "_", text)[:LONGEST_LINE]
