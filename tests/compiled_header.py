"""`calibration.h` as flight software would use it: compiled as strict C99 and run."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np

COMPILER = shutil.which("gcc") or shutil.which("clang")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion")

PROGRAM = """\
#include "calibration.h"
#include <stdio.h>
int main(void)
{
    float reading_deg, temperature_c;
    while (scanf("%f %f", &reading_deg, &temperature_c) == 2)
        printf("%.9g\\n", (double)calrig_elevation_deg(reading_deg, temperature_c));
    return 0;
}
"""


def compiled(header, folder):
    """The program of a header, its path."""
    (folder / "calibration.h").write_text(header, encoding="ascii")
    (folder / "main.c").write_text(PROGRAM, encoding="ascii")
    subprocess.run([COMPILER, *STRICT, "main.c", "-o", "apply", "-lm"], cwd=folder, check=True)
    return folder / "apply"


def applied(program, reading_deg, temperature_c):
    """(n,) the elevations that a program makes of readings and temperatures."""
    lines = "".join(
        f"{r!r} {t!r}\n" for r, t in zip(reading_deg.tolist(), temperature_c.tolist(), strict=True)
    )
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    return np.array(done.stdout.split(), dtype=np.float64)


def document(effects=(), **changes):
    """A calibration document with some effects."""
    return {
        "unit": "AS-0042",
        "run_id": "17",
        "calibrated_at": "2026-11-20T09:03:20Z",
        "range_deg": [-60.0, 60.0],
        "bias_deg": 0.2537,
        "scale": 1.00213,
        "effects": [{"name": name, "parameters": parameters} for name, parameters in effects],
        "expanded_uncertainty_deg": 0.58,
        "coverage_factor": 2,
        "temperature_c": {"min": 21.5, "max": 29.0},
        **changes,
    }


TEST_VECTORS = """\
#define CALRIG_TEST_VECTORS
#include "calibration.h"
#include <stdio.h>
#define ROWS(array) (int)(sizeof(array) / sizeof(array[0]))
int main(void)
{
    for (int k = 0; k < ROWS(calrig_test_elevations); k++) {
        const float *const row = calrig_test_elevations[k];
        printf("%.9g %.9g\\n", (double)calrig_elevation_deg(row[0], row[1]), (double)row[2]);
    }
#ifdef WITH_MATRIX
    for (int k = 0; k < ROWS(calrig_test_accelerations); k++) {
        const float *const row = calrig_test_accelerations[k];
        float true_g[3];
        calrig_acceleration_g(row, true_g);
        for (int axis = 0; axis < 3; axis++)
            printf("%.9g %.9g\\n", (double)true_g[axis], (double)row[3 + axis]);
    }
#endif
    return 0;
}
"""


def test_vectors(header, folder, with_matrix):
    """(n, 2) what a program makes of the header's own test vectors, and what it must."""
    (folder / "calibration.h").write_text(header, encoding="ascii")
    (folder / "vectors.c").write_text(TEST_VECTORS, encoding="ascii")
    more = ["-DWITH_MATRIX"] if with_matrix else []
    subprocess.run([COMPILER, *STRICT, *more, "vectors.c", "-o", "vectors", "-lm"], cwd=folder, check=True)
    done = subprocess.run([folder / "vectors"], capture_output=True, text=True, check=True)
    return np.array([line.split() for line in done.stdout.splitlines()], dtype=np.float64)


test_vectors.__test__ = False
