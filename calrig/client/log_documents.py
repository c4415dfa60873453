"""What a service finds in logs of samples (CONTRACT section 7)."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Any

from calrig.client.documents import Document


class Figure(Document):
    """A picture for `plotly.graph_objects.Figure`, and what it shows."""

    caption: str
    figure: dict[str, Any]


class Coefficient(Document):
    """One kind of noise, in the unit given."""

    value: float
    std: float
    unit: str


class NoiseChannel(Document):
    """The noise of a channel; a kind of noise that the log does not ask for is None."""

    mean: float
    std: float
    adf_slope: float | None
    psd_slope: float | None
    colour: str | None
    coefficients: dict[str, Coefficient | None]
    lines: list[dict[str, Any]]


class NoiseReport(Document):
    """CONTRACT section 7."""

    rate_hz: float
    duration_s: float
    channels: dict[str, NoiseChannel]
    summary: list[str]


class NoiseStudy(Document):
    """The noise of a log, and its pictures; `id` where the service keeps it."""

    id: str | None
    report: NoiseReport
    figures: list[Figure]


class FiltersStudy(Document):
    """The filters side by side on a log, as `calrig filters --json` has them; `id` where it is kept."""

    id: str | None
    report: dict[str, Any]
    figures: list[Figure]
