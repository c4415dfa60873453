"""imucal's JSON of a Ferraris calibration: what `imucal.CalibrationInfo.from_json` reads.

Read of imucal 2.6, `FerrarisCalibrationInfo.calibrate`: acceleration = R_a⁻¹·K_a⁻¹·(raw − b_a), rate =
R_g⁻¹·K_g⁻¹·(raw − K_ga·acceleration − b_g), K diagonal; here from g to m/s² and from deg/s to deg/s. JSON has
no comments: what is to be said, and the test vector, are in its own field `comment`.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import STANDARD_GRAVITY_MPS2, FloatArray
from calrig.export.autopilot import RAW_DPS, RAW_G
from calrig.export.formats import CalibrationExporter
from calrig.export.triads import NotHeldError, gyro_of, origin_of, require_whole, vector

FORMAT_VERSION = "2.0.0"


def imucal(document: Mapping[str, Any]) -> str:
    """Accelerometer and gyro as such a file.

    Raises:
        NotHeldError: the document has not the whole accelerometer, or not the gyro's three offsets.
    """
    accelerometer, gyro = require_whole(document, "imucal"), gyro_of(document)
    if np.isnan(gyro.bias_dps).any():
        raise NotHeldError(
            "imucal holds the gyro's offsets about x, y and z; the document has not all of them"
        )
    scale_a, rotation_a = _parts(np.linalg.inv(STANDARD_GRAVITY_MPS2 * accelerometer.matrix))
    scale_g, rotation_g = _parts(np.linalg.inv(gyro.matrix))
    acceleration = STANDARD_GRAVITY_MPS2 * accelerometer.true_g(RAW_G)
    rate = gyro.matrix @ (RAW_DPS - gyro.dps_per_g @ acceleration / STANDARD_GRAVITY_MPS2 - gyro.bias_dps)
    comment = [
        *origin_of(document),
        "along the chip's own axes",
        *([] if gyro.is_whole else ["of the gyro's scale and misalignment not all was measured"]),
        *([f"not in it: {', '.join(accelerometer.left_out)}"] if accelerometer.left_out else []),
        *accelerometer.uncertainty_says,
        f"test vector: raw {vector(RAW_G)} g, {vector(RAW_DPS)} deg/s -> {vector(acceleration)} m/s^2, "
        f"{vector(rate)} deg/s",
    ]
    held = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": "g",
        "from_gyr_unit": "deg/s",
        "comment": "; ".join(comment),
        "K_a": scale_a.tolist(),
        "R_a": rotation_a.tolist(),
        "b_a": accelerometer.bias_g.tolist(),
        "K_g": scale_g.tolist(),
        "R_g": rotation_g.tolist(),
        "K_ga": (gyro.dps_per_g / STANDARD_GRAVITY_MPS2).tolist(),
        "b_g": gyro.bias_dps.tolist(),
        "cal_type": "Ferraris",
        "_format_version": FORMAT_VERSION,
    }
    return json.dumps(held, indent=4, allow_nan=False) + "\n"


def _parts(response: npt.NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
    """A response K·R, raw of true: the length of each row, and the rows of length 1."""
    lengths = np.linalg.norm(response, axis=1)
    return np.diag(lengths), response / lengths[:, None]


EXPORTER = CalibrationExporter(
    name="imucal",
    title="imucal",
    file_name="imucal.json",
    media_type="application/json",
    contents="JSON of a `FerrarisCalibrationInfo`: accelerometer and gyro, from g to m/s²",
    about_one_axis="refused",
    write=imucal,
)
