"""imu_tk's file of a calibrated triad: what `CalibratedTriad::load` reads and `save` writes.

Read of imu_tk, `include/imu_tk/calibration.h` (Tedaldi, Pretto, Menegatti, ICRA 2014): X' = T·K·(X − B), the
misalignment T with ones on its diagonal, the scale K diagonal, the bias B; 21 numbers row by row, blank lines
between. Here X and B are in m/s², as in its examples. It reads no further than the numbers.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calrig.estimation.angles import STANDARD_GRAVITY_MPS2, FloatArray
from calrig.export.autopilot import RAW_G
from calrig.export.formats import CalibrationExporter
from calrig.export.triads import comments, origin_of, require_whole, vector


def imu_tk(document: Mapping[str, Any]) -> str:
    """The accelerometer as such a file.

    Raises:
        NotHeldError: the document has not the whole of it.
    """
    found = require_whole(document, "imu-tk")
    scale = np.diag(found.matrix)
    misalignment, bias = found.matrix / scale, found.bias_g * STANDARD_GRAVITY_MPS2
    raw = RAW_G * STANDARD_GRAVITY_MPS2
    corrected = misalignment @ np.diag(scale) @ (raw - bias)
    left_out = ", ".join(found.left_out) or "none"
    said = [
        *origin_of(document),
        "accelerometer, m/s^2 along the chip's own axes: corrected = T*K*(raw - B), T, K and B as above",
        f"effects of the document that are not in it: {left_out}",
        *found.uncertainty_says,
        f"test vector: raw {vector(raw)} -> corrected {vector(corrected)}",
    ]
    blocks = (misalignment, np.diag(scale), bias[:, None])
    return "\n".join([*(_rows(block) for block in blocks), *comments(said), ""])


def _rows(matrix: FloatArray) -> str:
    return "".join(" ".join(f"{value:.12g}" for value in row) + "\n" for row in matrix)


EXPORTER = CalibrationExporter(
    name="imu-tk",
    title="imu_tk",
    file_name="imu-tk.txt",
    contents="misalignment, scale and bias of the accelerometer, m/s²",
    about_one_axis="refused",
    write=imu_tk,
)
