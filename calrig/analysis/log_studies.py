"""A log's noise, or the filters on it: the document, and what draws it.

All that computes is imported where it is used: a command of one log loads nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from calrig.estimation.angles import FloatArray
    from calrig.figures.files import Rows

    Found = tuple[dict[str, Any], Callable[[], Rows]]

Study = Literal["noise", "filters"]


def studied(
    study: Study,
    channels: dict[str, FloatArray],
    time_s: FloatArray | None,
    rate_hz: float | None = None,
    warnings: Sequence[str] = (),
    *,
    gyro_scale: float = 1.0,
    progress: Callable[[float], None] | None = None,
) -> Found:
    """Return the document of a log, which begins with the warnings, and what draws its figures.

    Arguments are as of `analyse` and `study_filters`.

    Raises:
        ValueError: it cannot be studied, and why.
    """
    from calrig.noise.report import noise_document, said_first

    if study == "noise":
        from calrig.figures.noise import noise_figures
        from calrig.noise.analysis import analyse

        noise = analyse(channels, time_s, rate_hz, progress)
        return said_first(warnings, noise_document(noise)), partial(noise_figures, noise)

    from calrig.figures.filters import filters_figures
    from calrig.noise.filters import filters_document, study_filters

    filters = study_filters(channels, time_s, rate_hz, gyro_scale=gyro_scale)
    return said_first(warnings, filters_document(filters)), partial(filters_figures, filters)
