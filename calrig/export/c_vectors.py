"""Of `calibration.h`: the accelerometer's matrix, and vectors that tell whether a program applies it well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calrig.calibration.regression import c_literal
from calrig.calibration.results import Application
from calrig.estimation.angles import FloatArray
from calrig.export.formats.triads import is_curved

N_ELEVATIONS = 7
DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-0.6, 0, -0.8], [0, -0.8, 0.6], [0.48, 0.64, -0.6]])
"""Of gravity, g: the first axes, and some between them."""


def acceleration_function(document: Mapping[str, Any]) -> list[str]:
    """`calrig_acceleration_g`: true = matrix·(raw − bias), g; nothing where the document has no matrix."""
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
    curved = ["/* the document's quadratic and cubic terms of the axes are not taken out here */"]
    return [
        *(curved if is_curved(found) else []),
        "static inline void calrig_acceleration_g(const float raw_g[3], float true_g[3])",
        "{",
        *(f"    const float {axis} = raw_g[{k}] - {bias[k]};" for k, axis in enumerate("xyz")),
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
        raw = DIRECTIONS @ np.linalg.inv(matrix).T + bias
        lines += ["/* raw x, y, z and true x, y, z in g */"]
        lines += _array("calrig_test_accelerations", np.hstack([raw, DIRECTIONS]))
    return [*lines, "#endif", ""]


def _elevations(document: Mapping[str, Any]) -> FloatArray:
    """(n, 3) readings over the range at two temperatures, and their elevations."""
    application = Application.of_document(document)
    low, high = application.range_deg
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
