"""A calibration in a program of one's own: `calrig.load(path_or_url).elevation_deg(reading_deg)`."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calrig.calibration.regression import ApplyError
from calrig.calibration.results import Application
from calrig.errors import InputError
from calrig.estimation.angles import FloatArray
from calrig.export.calibration_document import read_document

Numbers = npt.ArrayLike


class Calibration:
    """A unit's calibration, ready to be applied.

    Attributes:
        document: all of it (CONTRACT section 6).
        unit: serial number.
        revision: None for a joint solution that was not issued.
        range_deg: lowest and highest elevation.
        effects: what is taken out in addition to bias and scale, as the document has it.
    """

    def __init__(self, document: dict[str, Any]) -> None:
        """Of a document as `read_document` gives it."""
        try:
            self._application = Application.of_document(document)
        except ApplyError as error:
            raise InputError(f"the calibration of {document['unit']!r} cannot be applied: {error}") from error
        self.document = document
        self.unit: str = document["unit"]
        self.revision: int | None = document.get("revision")
        self.range_deg = self._application.range_deg
        self.effects: list[dict[str, Any]] = document["effects"]

    def __repr__(self) -> str:
        return f"<calrig.Calibration of {self.unit!r}, revision {self.revision}>"

    def elevation_deg(
        self,
        reading_deg: Numbers | None = None,
        *,
        temperature_c: Numbers | None = None,
        accel_g: Numbers | None = None,
        columns: Mapping[str, Numbers] | None = None,
    ) -> Any:
        """Calibrated elevations, degrees: a number of numbers, an array of arrays.

        Args:
            reading_deg: any shape.
            temperature_c: of each or of all; needed where effects follow it.
            accel_g: instead of readings, (…, 3) accelerations along x, y, z; NaN for an x that is not known.
            columns: by name, of each or of all, whatever else effects follow.

        Returns:
            NaN where a reading has many elevations, far beyond the range.

        Raises:
            TypeError: neither or both of reading and accelerations.
            ValueError: a temperature or another column is needed and not given, or shapes differ.
        """
        return self._applied(reading_deg, temperature_c, accel_g, columns, lambda elevation, *_: elevation)

    def elevation_std_deg(
        self,
        reading_deg: Numbers | None = None,
        *,
        temperature_c: Numbers | None = None,
        accel_g: Numbers | None = None,
        columns: Mapping[str, Numbers] | None = None,
    ) -> Any:
        """Standard uncertainty (k = 1) of each, of the elevation relative to its mean over the range.

        Of one reading as noisy as those of the calibration; NaN beyond the range and where the document does
        not know it. Where `level_known` it is of the elevation itself.
        """
        return self._applied(reading_deg, temperature_c, accel_g, columns, self._application.std_deg)

    def _applied(
        self,
        reading_deg: Numbers | None,
        temperature_c: Numbers | None,
        accel_g: Numbers | None,
        columns: Mapping[str, Numbers] | None,
        made_of: Callable[..., FloatArray],
    ) -> Any:
        if (reading_deg is None) == (accel_g is None):
            raise TypeError("give either readings or accelerations (accel_g)")
        reading = self._readings(reading_deg, accel_g)

        def of_each(values: Numbers) -> FloatArray:
            return np.broadcast_to(np.asarray(values, dtype=np.float64), reading.shape).ravel()

        celsius = None if temperature_c is None else of_each(temperature_c)
        others = {name: of_each(values) for name, values in (columns or {}).items()}
        elevation = self._application.elevation_deg(reading.ravel(), celsius, others)
        made = made_of(elevation, celsius, others).reshape(reading.shape)
        return float(made) if made.ndim == 0 else made

    def _readings(self, reading_deg: Numbers | None, accel_g: Numbers | None) -> FloatArray:
        if accel_g is None:
            return np.asarray(reading_deg, dtype=np.float64)
        vectors = np.asarray(accel_g, dtype=np.float64)
        if vectors.ndim == 0 or vectors.shape[-1] != 3:
            raise ValueError(f"accelerations have x, y and z, their shape ends in 3: {vectors.shape}")
        return self._application.reading_of_deg(vectors.reshape(-1, 3)).reshape(vectors.shape[:-1])


def load(source: str | Path) -> Calibration:
    """The calibration in a file or at an address (CALRIG_TOKEN is its token).

    Raises:
        InputError: it cannot be read, was changed since it was issued, or cannot be applied.
        WorkError: the service refuses or cannot be reached.
    """
    return Calibration(read_document(source))
