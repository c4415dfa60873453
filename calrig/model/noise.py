"""Noise of a sensor and filters for it (CONTRACT section 7), as studies of a log report them."""

from typing import Any, Literal

from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from calrig.model.base import Model


class Figure(TypedDict):
    """A figure in plotly's JSON form."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # type: ignore[misc]

    data: list[dict[str, Any]]
    layout: dict[str, Any]


class CaptionedFigure(Model):
    """A figure and its caption."""

    caption: str
    figure: Figure


class Dropped(Model):
    """Samples of a log that could not be used."""

    gaps: int
    not_finite: int


class AllanDeviation(Model):
    """Overlapping Allan deviation with its confidence limits."""

    tau_s: list[float]
    deviation: list[float]
    low: list[float]
    high: list[float]


class Coefficient(Model):
    """A noise coefficient, in the unit given."""

    value: float
    std: float
    unit: str


class Coefficients(Model):
    """The coefficients that the log supports; the others are null."""

    quantisation: Coefficient | None
    white: Coefficient | None
    flicker: Coefficient | None
    random_walk: Coefficient | None
    ramp: Coefficient | None


class SpectralLine(Model):
    """A spectral line."""

    frequency_hz: float
    amplitude: float
    p_value: float


class Distribution(Model):
    """Whether the samples are Gaussian; null where quantisation hides it."""

    gaussian: bool | None
    p_value: float | None
    skewness: float | None
    kurtosis: float | None
    outliers: int


class TemperatureDependence(Model):
    """Dependence on temperature, per °C."""

    per_c: float
    std: float


class ChannelNoise(Model):
    """The noise of one channel, in its unit."""

    mean: float
    std: float
    adf_slope: float | None
    psd_slope: float | None
    colour: Literal["white", "pink", "brown", "quantisation-limited", "lines", "mixed"] | None
    allan: AllanDeviation
    coefficients: Coefficients
    lines: list[SpectralLine]
    distribution: Distribution
    temperature: TemperatureDependence | None


class NoiseReport(Model):
    """CONTRACT section 7."""

    rate_hz: float
    duration_s: float
    dropped: Dropped
    channels: dict[str, ChannelNoise]
    summary: list[str]


class StatedNoise(Model):
    """A channel's noise as in data sheets, with its unit: one-sided density and bias instability."""

    white: str | None
    flicker: str | None


class NoiseStudy(Model):
    """The report of a static log, and its figures; `id` is that of a stored study of a file."""

    id: str | None = None
    report: NoiseReport
    stated: dict[str, StatedNoise]
    figures: list[CaptionedFigure]


class FiltersStudy(Model):
    """The filter comparison of a log, and its figures; `id` is that of a stored study of a file."""

    id: str | None = None
    report: dict[str, Any] = Field(description="The document that `calrig filters --json` prints.")
    figures: list[CaptionedFigure]
