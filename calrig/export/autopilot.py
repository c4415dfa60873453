"""What the parameters of an autopilot hold of a calibration: an offset and a scale an axis, in SI units.

A driver hands on its chip's axes in an order and sense of its own, and parameters are along these.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.estimation.angles import STANDARD_GRAVITY_MPS2, FloatArray
from calrig.export.triads import Accelerometer, NotHeldError, accelerometer_of, gyro_of, vector

RAW_G = np.array([0.3, -0.5, 0.8])
RAW_DPS = np.array([10.0, -20.0, 30.0])
WARMER_C = 5.0
"""The test vectors: along the chip's own axes, and above the reference temperature."""


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Along the driver's axes x, y, z; NaN in an offset where nothing is known of the axis.

    Attributes:
        offset_mps2, scale: (3,) of the accelerometer, corrected = (raw − offset)·scale.
        per_c_mps2: (3,) by what its offset follows the temperature above `reference_c`.
        gyro_offset_rps: (3,).
        reference_c: None where the temperature plays no part.
        temperatures_c: between which that was calibrated.
        axes: (3, 3) from the chip's axes to the driver's.
        notes: what is not in the parameters, a line each.
    """

    offset_mps2: FloatArray
    scale: FloatArray
    per_c_mps2: FloatArray
    gyro_offset_rps: FloatArray
    reference_c: float | None
    temperatures_c: tuple[float, float]
    axes: FloatArray
    notes: list[str]

    def rows(self, offset: str, scale: str, gyro_offset: str) -> list[tuple[str, float]]:
        """Parameters of what is known of each axis; names have `{}` where the axis' letter stands."""
        rows: list[tuple[str, float]] = []
        for axis, offset_mps2, factor in zip("XYZ", self.offset_mps2, self.scale, strict=True):
            if not np.isnan(offset_mps2):
                rows += [(offset.format(axis), offset_mps2), (scale.format(axis), factor)]
        for axis, offset_rps in zip("XYZ", self.gyro_offset_rps, strict=True):
            if not np.isnan(offset_rps):
                rows.append((gyro_offset.format(axis), offset_rps))
        return rows

    def tests(self) -> list[str]:
        """Lines of test vectors, by the arithmetic that PX4 and ArduPilot have in common."""
        raw = self.axes @ RAW_G * STANDARD_GRAVITY_MPS2
        celsius, thermal = None, np.zeros(3)
        if self.reference_c is not None:
            celsius = float(np.clip(self.reference_c + WARMER_C, *self.temperatures_c))
            thermal = self.per_c_mps2 * (celsius - self.reference_c)
        corrected = (raw - thermal - np.nan_to_num(self.offset_mps2)) * self.scale
        at = "" if celsius is None else f" at {celsius:.6g} degrees Celsius"
        lines = [f"test vector, m/s^2{at}:", f"  raw {vector(raw)} -> corrected {vector(corrected)}"]
        if np.isnan(self.gyro_offset_rps).all():
            return lines
        raw = self.axes @ np.radians(RAW_DPS)
        corrected = raw - np.nan_to_num(self.gyro_offset_rps)
        return [*lines, "test vector, rad/s:", f"  raw {vector(raw)} -> corrected {vector(corrected)}"]


def parameters_of(document: Mapping[str, Any], axes: FloatArray, format_: str) -> Parameters:
    """What such parameters hold of a document.

    `axes` (3, 3) lead from the chip's axes to the driver's: a permutation with signs. `format_` names the
    format in a refusal.

    Raises:
        NotHeldError: nothing of it.
    """
    accelerometer, gyro = accelerometer_of(document), gyro_of(document)
    if accelerometer is None and np.isnan(gyro.bias_dps).all():
        raise NotHeldError(
            f"{format_} holds offsets and scales of the accelerometer's axes, and this calibration has bias "
            "and scale of an angle: solve runs of the unit clamped at several angles (`calrig solve --out`), "
            "or accept what a diagnosis finds of its axes"
        )
    notes = [] if accelerometer is None else _notes(accelerometer)
    if accelerometer is None:
        notes.append("the accelerometer's axes are not known: its parameters stay as they are on the vehicle")
        accelerometer = Accelerometer(np.full(3, np.nan), np.eye(3), np.zeros(3), None, False, ())
    if np.isnan(gyro.bias_dps).any():
        notes.append("a gyro offset that is not here is not known: it stays as it is on the vehicle")
    if not np.allclose(gyro.matrix, np.eye(3), atol=1e-9):
        notes.append("the gyro's scale and misalignment are not held by these parameters")
    warmth = document.get("temperature_c") or {}
    ends = [value for value in (warmth.get("min"), warmth.get("max")) if value is not None]
    reference_c = accelerometer.reference_c
    around = [] if reference_c is None else [*(ends or (reference_c + WARMER_C,)), reference_c]
    return Parameters(
        offset_mps2=_signed(axes, accelerometer.bias_g) * STANDARD_GRAVITY_MPS2,
        scale=np.abs(axes) @ np.diag(accelerometer.matrix),
        per_c_mps2=axes @ accelerometer.per_c_g * STANDARD_GRAVITY_MPS2,
        gyro_offset_rps=_signed(axes, np.radians(gyro.bias_dps)),
        reference_c=reference_c,
        temperatures_c=(min(around), max(around)) if around else (math.nan, math.nan),
        axes=axes,
        notes=notes,
    )


def _signed(axes: FloatArray, values: FloatArray) -> FloatArray:
    """(3,) along the driver's axes, NaN staying with its axis."""
    place = np.abs(axes).argmax(axis=1)
    return np.asarray(axes[np.arange(3), place] * values[place])


def _notes(accelerometer: Accelerometer) -> list[str]:
    notes = []
    if not accelerometer.known:
        notes.append("at rest the accelerometer's axes are not known: offsets and scales stay as they are")
    elif len(accelerometer.known) < 3:
        notes += [
            "a planar calibration: of the chip's x nothing is known, its parameters stay as they are on the",
            "vehicle; the scale of y is relative to that of z, which counts as 1",
        ]
    if accelerometer.reference_c is not None:
        notes.append("the offsets of y and z of the chip follow temperature; of that of x nothing is known")
    left = np.diag(np.diag(accelerometer.matrix)) @ np.linalg.inv(accelerometer.matrix) - np.eye(3)
    turned_deg = math.degrees(float(np.linalg.norm(left, 2)))
    if turned_deg > 1e-6:
        notes.append(
            f"misalignment of axes is not held by these parameters, up to {turned_deg:.2g} degrees of it"
        )
    notes += accelerometer.uncertainty_says
    if accelerometer.left_out:
        notes.append(
            f"of the document, but not held by these parameters: {', '.join(accelerometer.left_out)}"
        )
    return notes
