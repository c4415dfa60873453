"""A unit's calibration as `calibration.h`: plain C99 in `float`, no allocation, section 6's arithmetic.

The header contains the accelerometer's matrix if there is one, and test vectors for the program that uses it.
"""

import math
import re
import textwrap
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.regression import (
    TEMPERATURE,
    ApplyError,
    Circumstances,
    NotInFlight,
    Parameters,
    VectorInC,
    c_literal,
)
from calrig.calibration.results import (
    AT_ITS_END_DEG,
    HALF_TURN_DEG,
    Application,
    ReadingTurns,
    columns_followed,
    effects_at_rest,
    effects_on_reading_deg,
    felt_elevation_deg,
)
from calrig.estimation.angles import FloatArray
from calrig.export.formats import CalibrationExporter
from calrig.export.triads import curvature_of, is_curved

N_ELEVATIONS = 7
DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-0.6, 0, -0.8], [0, -0.8, 0.6], [0.48, 0.64, -0.6]])
"""Of gravity, g: the first axes, and some between them."""


ROUNDS_OF_AXIS = 4
"""Of Newton's iteration for one axis: curves of 5 % of it need three in `float`."""


def acceleration_function(document: Mapping[str, Any]) -> list[str]:
    """`calrig_acceleration_g`: true = matrix·(raw − bias), g; nothing where the document has no matrix.

    Where the axes have quadratic and cubic terms, each axis is solved for what acts along it first.
    """
    found = document.get("accelerometer")
    if not found:
        return []
    bias = [c_literal(value) for value in found["bias_g"]]
    rows = [
        "    true_g[{}] = {};".format(
            k, " + ".join(f"{c_literal(v)} * {axis}" for v, axis in zip(row, "xyz", strict=True))
        )
        for k, row in enumerate(found["matrix"])
    ]
    lines = [f"    const float {axis} = raw_g[{k}] - {bias[k]};" for k, axis in enumerate("xyz")]
    curved = []
    if is_curved(found):
        gains = np.diag(np.linalg.inv(np.array(found["matrix"], dtype=float)))
        terms = [
            ", ".join(c_literal(float(value)) for value in (gain, *of_axis))
            for gain, of_axis in zip(gains, curvature_of(found).T, strict=True)
        ]
        curved = [
            "/* the straight part of raw = gain*u + quadratic*u*u + cubic*u*u*u, u along the axis, g */",
            "static inline float calrig_straight_g(float raw_g, float gain, float quadratic, float cubic)",
            "{",
            "    float u = raw_g / gain;",
            f"    for (int k = 0; k < {ROUNDS_OF_AXIS}; k++)",
            "        u -= (((cubic * u + quadratic) * u + gain) * u - raw_g)",
            "            / ((3.0f * cubic * u + 2.0f * quadratic) * u + gain);",
            "    return gain * u;",
            "}",
            "",
        ]
        lines = [
            f"    const float {axis} = calrig_straight_g(raw_g[{k}] - {bias[k]}, {terms[k]});"
            for k, axis in enumerate("xyz")
        ]
    return [
        *curved,
        "static inline void calrig_acceleration_g(const float raw_g[3], float true_g[3])",
        "{",
        *lines,
        *rows,
        "}",
        "",
    ]


def test_vectors(document: Mapping[str, Any]) -> list[str]:
    """Arrays of what goes in and what must come out, by the arithmetic of `calrig apply`."""
    found = document.get("accelerometer")
    lines = [
        "#ifdef CALRIG_TEST_VECTORS",
        "/* reading in degrees, temperature in degrees Celsius, elevation in degrees */",
        *_array("calrig_test_elevations", _elevations(document)),
    ]
    if found:
        bias, matrix = np.array(found["bias_g"]), np.array(found["matrix"])
        response = np.linalg.inv(matrix)
        along_g, (quadratic, cubic) = DIRECTIONS @ response.T / np.diag(response), curvature_of(found)
        raw = DIRECTIONS @ response.T + quadratic * along_g**2 + cubic * along_g**3 + bias
        lines += ["/* raw x, y, z and true x, y, z in g */"]
        lines += _array("calrig_test_accelerations", np.hstack([raw, DIRECTIONS]))
    return [*lines, "#endif", ""]


def _elevations(document: Mapping[str, Any]) -> FloatArray:
    """(n, 3) readings over the range at two temperatures, and their elevations."""
    application = Application.of_document(document)
    low, high = application.turns.single_deg or application.range_deg
    if low > high:
        raise ApplyError(
            "the readings start anew after a turn, and over this range each stands for several elevations"
        )
    if application.turns.wrap:
        low, high = low + AT_ITS_END_DEG, high - AT_ITS_END_DEG  # where a `float` is on the same turn
    ends = application.temperature_c or (20.0, 30.0)
    readings = application.bias_deg + application.scale * np.linspace(low, high, N_ELEVATIONS)
    reading, celsius = (grid.ravel() for grid in np.meshgrid(readings, ends))
    rows = np.column_stack([reading, celsius]).astype(np.float32).astype(np.float64)  # as C has them
    return np.column_stack([rows, application.elevation_deg(rows[:, 0], rows[:, 1])])


def _array(name: str, rows: Sequence[Sequence[float]] | FloatArray) -> list[str]:
    cells = [", ".join(c_literal(float(value)) for value in row) for row in rows]
    return [
        f"static const float {name}[{len(cells)}][{len(rows[0])}] = {{",
        *(f"    {{{row}}}," for row in cells),
        "};",
    ]


CLOSE_DEG = 1e-6
MOST_ROUNDS = 12
LEAST_SLOPE = 0.2
"""Of the reading against the elevation, over the scale: where it is flatter, a `float` no longer tells."""
BEYOND_C = (40.0, 20.0, 10.0, 0.0)
"""Beyond the temperatures of the calibration, the first of these at which the correction can be taken out."""
STEP_DEG = 0.5
LONGEST_LINE = 160
LONGEST_WARNING = 100
Effects = list[tuple[str, Parameters]]
Terms = list[str | VectorInC]


def c_header(document: Mapping[str, Any]) -> str:
    """The header of a calibration document (CONTRACT section 6).

    It defines `static inline float calrig_elevation_deg(float reading_deg, float temperature_c)`. Where an
    effect depends on the elevation, that solves reading = bias + scale·θ + effects(θ) by Newton's iteration,
    in a number of rounds that is fixed here. Effects that are not applied in flight are left out. Where the
    document has the whole accelerometer, `calrig_acceleration_g` takes its errors out; what both must give is
    in the header itself, for programs that define CALRIG_TEST_VECTORS.

    Raises:
        ApplyError: an effect has no formula or lacks a parameter, or they are too large to be taken out.
        ValueError: a number of the document is not known, or not one that a `float` holds.
    """
    effects, left_out = effects_at_rest(document)
    for name in columns_followed(effects):
        if name != TEMPERATURE.name:
            raise ApplyError(
                f"effects follow {name}; the header's function takes reading and temperature only"
            )
    rounds, temperatures_c = _rounds(document, effects)
    guard = _guard(str(document["unit"]))
    bias_deg, scale = _finite(document, "bias_deg"), _finite(document, "scale")
    terms = [_term(name, parameters) for name, parameters in effects]
    body = [
        f"    const float scale = {c_literal(scale)};",
        f"    float aim = reading_deg - {c_literal(bias_deg)};",
        "    float theta = aim / scale;",
    ]
    if not terms:
        body.append("    (void)temperature_c;")
    body += _on_its_turn(Application.of_document(document).turns)
    if terms:
        body += _newton(rounds)
    body.append("    return theta;")
    return "\n".join(
        [
            *_comment(document, [name for name, _ in effects], left_out, temperatures_c),
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <math.h>",
            "",
            *(_effects_function(bias_deg, scale, terms) if terms else []),
            "static inline float calrig_elevation_deg(float reading_deg, float temperature_c)",
            "{",
            *body,
            "}",
            "",
            *acceleration_function(document),
            *test_vectors(document),
            f"#endif /* {guard} */",
            "",
        ]
    )


def _on_its_turn(turns: ReadingTurns) -> list[str]:
    """The statements of `ReadingTurns.aim_deg`."""
    if turns.is_left_alone:
        return []
    scale, (low_deg, high_deg) = turns.scale, turns.range_deg
    low, high = c_literal(low_deg - AT_ITS_END_DEG), c_literal(high_deg + AT_ITS_END_DEG)
    theta_end = c_literal(turns.middle_deg + HALF_TURN_DEG)
    aim_end = c_literal(scale * turns.middle_deg + HALF_TURN_DEG)
    by_reading = f"360.0f * ceilf((aim - {aim_end}) / 360.0f)"
    by_theta = f"scale * 360.0f * ceilf((theta - {theta_end}) / 360.0f)"
    if turns.wrap is True:
        lines = [f"    aim -= {by_reading};", "    theta = aim / scale;"]
        if turns.single_deg is not None:
            first, last = map(c_literal, turns.single_deg)
            lines += [
                f"    if (theta < {first} || theta > {last})",
                "        return NAN; /* a turn of the reading away is another elevation of the range */",
            ]
        return lines
    lines = [f"    if (theta < {low} || theta > {high}) {{"]
    if turns.wrap is False:
        lines.append(f"        aim -= {by_theta};")
    else:
        lines.append(f"        const float wrapped = aim - {by_reading};")
        condition = "fabsf(reading_deg) <= 180.0f"
        if not turns.covers_a_turn:
            condition += f" || (wrapped / scale >= {low} && wrapped / scale <= {high})"
        lines += [
            f"        aim = {condition} ? wrapped",
            f"            : aim - {by_theta};",
        ]
    return [*lines, "        theta = aim / scale;", "    }"]


def _term(name: str, parameters: Parameters) -> str | VectorInC:
    in_c = effect_of(name).in_c
    assert not isinstance(in_c, NotInFlight)  # noqa: S101 (left out before)
    return in_c(parameters)


def _rounds(document: Mapping[str, Any], effects: Effects) -> tuple[int, tuple[float, float]]:
    """How many rounds of Newton's iteration take the effects out, and at which temperatures, °C."""
    low, high = (float(limit) for limit in document["range_deg"])
    theta = np.linspace(low, high, 721) if high > low else np.array([low - 1.0, low, low + 1.0])
    known = [value for value in (document.get("temperature_c") or {}).values() if value is not None]
    known += [parameters["reference_c"] for _, parameters in effects if "reference_c" in parameters]
    coldest, warmest = min(known, default=0.0), max(known, default=0.0)
    line = _finite(document, "bias_deg"), _finite(document, "scale")
    for beyond in BEYOND_C:
        reached = coldest - beyond, warmest + beyond
        needed = [_rounds_at(theta, line, effects, float(celsius)) for celsius in np.linspace(*reached, 5)]
        if None not in needed:
            return max(n for n in needed if n is not None), reached
    raise ApplyError(
        f"the effects {', '.join(name for name, _ in effects)} are not a small correction: between "
        f"{low:g}° and {high:g}°, {coldest:g} °C and {warmest:g} °C they change the reading so steeply that "
        "one reading stands for many elevations; calibrate over a smaller range, or take them back"
    )


def _rounds_at(theta: FloatArray, line: tuple[float, float], effects: Effects, celsius: float) -> int | None:
    """The rounds at one temperature; None where so few do not get there, or the reading hardly changes."""
    scale = line[1]
    given = Circumstances(temperature_c=np.full(len(theta), celsius))

    def added(at: FloatArray) -> FloatArray:
        return effects_on_reading_deg(effects, at, given, felt_elevation_deg(at, *line))

    def slope(at: FloatArray) -> FloatArray:
        change = (added(at + STEP_DEG) - added(at - STEP_DEG)) / (2.0 * STEP_DEG)
        return np.asarray(scale + change, dtype=np.float64)

    if (slope(theta) / scale < LEAST_SLOPE).any():
        return None
    aim = scale * theta + added(theta)
    found = aim / scale
    for rounds in range(1, MOST_ROUNDS + 1):
        found = found + (aim - scale * found - added(found)) / slope(found)
        if np.abs(found - theta).max() < CLOSE_DEG:
            return rounds
    return None


def _effects_function(bias_deg: float, scale: float, terms: Terms) -> list[str]:
    """The sum of the terms, each of which may use s, c, theta and temperature_c."""
    added = [term for term in terms if isinstance(term, str)]
    vectors = [term for term in terms if isinstance(term, VectorInC)]
    used = " ".join(
        [*added, *(f"{one.y_g} {one.z_g}" for one in vectors), *("s c theta" for _ in vectors[:1])]
    )
    unused = [n for n in ("theta", "temperature_c") if not re.search(rf"\b{n}\b", used)]
    felt = f"({c_literal(bias_deg)} + {c_literal(scale)} * theta) * 0.01745329252f"
    return [
        "static inline float calrig_effects_deg(float theta, float temperature_c)",
        "{",
        "    float effects = 0.0f;",
        *(_turned_vector(felt, vectors) if vectors else []),
        *(f"    (void){name};" for name in unused),
        *(f"    effects += {term};" for term in added),
        "    return effects;",
        "}",
        "",
    ]


def _turned_vector(felt: str, vectors: list[VectorInC]) -> list[str]:
    """What errors of both axes together turn: they add up first (`sensor_vector.turned_vector`)."""
    return [
        f"    const float s = sinf({felt});",
        f"    const float c = cosf({felt});",
        "    float y = 0.0f;",
        "    float z = 0.0f;",
        *(f"    {axis} += {term};" for one in vectors for axis, term in (("y", one.y_g), ("z", one.z_g))),
        "    effects += 57.29577951f * atan2f(y * c - z * s, 1.0f + y * s + z * c);",
    ]


def _newton(rounds: int) -> list[str]:
    step = c_literal(STEP_DEG)
    return [
        f"    for (int k = 0; k < {rounds}; k++) {{",
        f"        const float ahead = calrig_effects_deg(theta + {step}, temperature_c);",
        f"        const float behind = calrig_effects_deg(theta - {step}, temperature_c);",
        "        const float left = aim - scale * theta - calrig_effects_deg(theta, temperature_c);",
        "        theta += left / (scale + (ahead - behind));",
        "    }",
    ]


def _finite(document: Mapping[str, Any], key: str) -> float:
    value = document[key]
    if value is None or not math.isfinite(value):
        raise ValueError(f"{key} is not known: there is nothing to apply")
    return float(value)


def _guard(unit: str) -> str:
    """An identifier of its own for every serial number: two units' headers in one program are an error."""
    name = re.sub(r"[^A-Z0-9]+", "_", unit.upper()).strip("_")[:32]
    return f"CALRIG_{name}_{zlib.crc32(unit.encode()):08X}_H"


def _comment(
    document: Mapping[str, Any], effects: list[str], left_out: list[str], temperatures_c: tuple[float, float]
) -> list[str]:
    low, high = document["range_deg"]
    expanded = document.get("expanded_uncertainty_deg")
    worth = "not known" if expanded is None else f"{expanded:.3g} deg (k = {document['coverage_factor']})"
    lines = [
        f"Calibration of the unit {document['unit']}, run {document['run_id']}, {document['calibrated_at']}",
        "elevation = (reading - bias - effects)/scale, degrees; temperature in degrees Celsius",
        f"range {low:.6g} to {high:.6g} deg; expanded uncertainty {worth}",
        f"effects: {', '.join(effects) or 'none'}",
    ]
    for one in document.get("warnings") or ():
        lines += textwrap.wrap(f"WARNING: {_in_ascii(one)}", LONGEST_WARNING)
    if left_out:
        lines.append(f"accepted, but not of this unit at rest: {', '.join(left_out)}")
    if any(effect_of(name).covariate is TEMPERATURE for name in effects):
        coldest, warmest = temperatures_c
        lines.append(f"for temperatures from {coldest:.4g} to {warmest:.4g} degrees Celsius")
        lines.append("where no thermometer is read, pass the reference temperature of the effects")
    return ["/*", *(f" * {_harmless(line)}" for line in lines), " */"]


def _in_ascii(text: str) -> str:
    for sign, instead in (("°", " deg"), ("−", "-"), ("±", "+-")):
        text = text.replace(sign, instead)
    return text


def _harmless(text: str) -> str:
    """Text that cannot end a comment, begin one, join lines or turn the writing round."""
    return re.sub(r"[^ -~]|[*\\?]", "_", text)[:LONGEST_LINE]


EXPORTER = CalibrationExporter(
    name="c-header",
    title="C header",
    file_name="calibration.h",
    contents="C99 in `float`; `calrig_acceleration_g` if there is a matrix; test vectors with "
    "`CALRIG_TEST_VECTORS`",
    about_one_axis="all of it",
    write=c_header,
)
