"""Answers about noise and filters: CONTRACT section 7, and the picture that goes with it."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Any, Literal

from calrig.api.models import Answer, Figure


class Dropped(Answer):
    """What could not be used of a log."""

    gaps: int
    not_finite: int


class AllanAnswer(Answer):
    """Overlapping Allan deviation with its confidence limits."""

    tau_s: list[float]
    deviation: list[float]
    low: list[float]
    high: list[float]


class CoefficientAnswer(Answer):
    """One kind of noise, in the unit given."""

    value: float
    std: float
    unit: str


class CoefficientsAnswer(Answer):
    """The kinds of noise that the log asks for; null for the others."""

    quantisation: CoefficientAnswer | None
    white: CoefficientAnswer | None
    flicker: CoefficientAnswer | None
    random_walk: CoefficientAnswer | None
    ramp: CoefficientAnswer | None


class LineAnswer(Answer):
    """A spectral line."""

    frequency_hz: float
    amplitude: float
    p_value: float


class DistributionAnswer(Answer):
    """Whether the samples are Gaussian; null where quantisation hides it."""

    gaussian: bool | None
    p_value: float | None
    skewness: float | None
    kurtosis: float | None
    outliers: int


class TemperatureAnswer(Answer):
    """Dependence on temperature, per °C."""

    per_c: float
    std: float


class ChannelAnswer(Answer):
    """The noise of one channel, in its unit."""

    mean: float
    std: float
    adf_slope: float | None
    psd_slope: float | None
    colour: Literal["white", "pink", "brown", "quantisation-limited", "lines", "mixed"] | None
    allan: AllanAnswer
    coefficients: CoefficientsAnswer
    lines: list[LineAnswer]
    distribution: DistributionAnswer
    temperature: TemperatureAnswer | None


class NoiseReport(Answer):
    """CONTRACT section 7."""

    rate_hz: float
    duration_s: float
    dropped: Dropped
    channels: dict[str, ChannelAnswer]
    summary: list[str]


class CaptionedFigure(Answer):
    """A picture and what it shows."""

    caption: str
    figure: Figure


class NoiseAnswer(Answer):
    """The report of a static log, and its pictures."""

    report: NoiseReport
    figures: list[CaptionedFigure]


class FiltersAnswer(Answer):
    """What `calrig filters --json` prints, and its pictures."""

    report: dict[str, Any]
    figures: list[CaptionedFigure]
