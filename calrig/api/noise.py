"""Noise and filters: of a run's samples, or of a log that somebody brings."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.
# What computes is imported where it is used: its half of scipy would be a second of the service's start.

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from fastapi import APIRouter, File, Form, UploadFile

from calrig.analysis.errors import Invalid
from calrig.api.context import Context, KnownRun
from calrig.api.errors import problems
from calrig.api.limits import UPLOAD_BYTES, Turn, name_of
from calrig.api.models import Answer
from calrig.api.models import Figure as FigureAnswer
from calrig.estimation.angles import FloatArray
from calrig.export.cells import CsvError
from calrig.export.static_csv import StaticLog, read_static
from calrig.figures.parts import Figure

if TYPE_CHECKING:
    from calrig.noise.analysis import Noise
    from calrig.noise.filters import FilterStudy

router = APIRouter(tags=["noise"])
T = TypeVar("T")

MOST_SAMPLES = 2_000_000
"""Of an uploaded log; the command line takes a longer one, on the memory of whoever asks."""
LogFile = Annotated[UploadFile, File(description="CONTRACT section 4's static log")]
Rate = Annotated[float | None, Form(gt=0, le=1e6, description="Samples a second; wins over time_s.")]
Range = Annotated[float | None, Form(gt=0, le=1e5, description="Full scale of raw counts.")]


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
    figure: FigureAnswer


class NoiseAnswer(Answer):
    """The report of a static log, and its pictures."""

    report: NoiseReport
    figures: list[CaptionedFigure]


class FiltersAnswer(Answer):
    """What `calrig filters --json` prints, and its pictures."""

    report: dict[str, Any]
    figures: list[CaptionedFigure]


@router.get(
    "/api/runs/{run_id}/noise",
    response_model=NoiseAnswer,
    responses=problems(404, 409, 422),
    summary="The noise in the log of a static run",
)
def run_noise(run: KnownRun, context: Context, _turn: Turn) -> dict[str, Any]:
    """Allan deviation, spectrum, distribution and dependence on temperature of each channel."""
    from calrig.analysis.noise_studies import noise_of_run

    return _noise_answer(noise_of_run(context.store, run.id))


@router.get(
    "/api/runs/{run_id}/filters",
    response_model=FiltersAnswer,
    responses=problems(404, 409, 422),
    summary="The filters side by side on a run's samples",
)
def run_filters(run: KnownRun, context: Context, _turn: Turn) -> dict[str, Any]:
    """Jitter, lag and largest offset of each, the Kalman filter tuned from the run's own rests among them."""
    from calrig.analysis.noise_studies import filters_of_run

    return _filters_answer(filters_of_run(context.store, run.id))


@router.post(
    "/api/noise",
    max_body_size=UPLOAD_BYTES,
    response_model=NoiseAnswer,
    responses=problems(408, 413, 422, 503),
    summary="The noise in a log from anybody's sensor",
)
def log_noise(
    _turn: Turn,
    file: LogFile,
    rate_hz: Rate = None,
    accel_range_g: Range = None,
    gyro_range_dps: Range = None,
) -> dict[str, Any]:
    """The sensor was at rest. Nothing is stored."""
    from calrig.noise.analysis import analyse

    return _noise_answer(*_studied(analyse, file, rate_hz, accel_range_g, gyro_range_dps))


@router.post(
    "/api/filters",
    max_body_size=UPLOAD_BYTES,
    response_model=FiltersAnswer,
    responses=problems(408, 413, 422, 503),
    summary="The filters side by side on a log from anybody's sensor",
)
def log_filters(
    _turn: Turn,
    file: LogFile,
    rate_hz: Rate = None,
    accel_range_g: Range = None,
    gyro_range_dps: Range = None,
) -> dict[str, Any]:
    """The sensor was at rest and was turned about its x axis. Nothing is stored."""
    from calrig.noise.filters import study_filters

    return _filters_answer(*_studied(study_filters, file, rate_hz, accel_range_g, gyro_range_dps))


def _studied(
    study: Callable[[dict[str, FloatArray], FloatArray | None, float | None], T],
    file: UploadFile,
    rate_hz: float | None,
    accel_range_g: float | None,
    gyro_range_dps: float | None,
) -> tuple[T, tuple[str, ...]]:
    """What a study makes of an uploaded log, and what was said of the file itself."""
    name, log = _read(file, accel_range_g, gyro_range_dps)
    try:
        return study(log.channels, log.time_s, rate_hz), log.warnings
    except ValueError as error:
        raise Invalid(f"{name}: {error}") from error


def _read(
    file: UploadFile, accel_range_g: float | None, gyro_range_dps: float | None
) -> tuple[str, StaticLog]:
    name = name_of(file)
    try:
        return name, read_static(
            file.file.read(),
            accel_range_g=accel_range_g,
            gyro_range_dps=gyro_range_dps,
            max_samples=MOST_SAMPLES,
        )
    except CsvError as error:
        raise Invalid(f"{name}: {error}") from error


def _noise_answer(found: "Noise", warnings: tuple[str, ...] = ()) -> dict[str, Any]:
    from calrig.figures.noise import noise_figures
    from calrig.noise.report import noise_document

    return _answer(noise_document(found), noise_figures(found), warnings)


def _filters_answer(found: "FilterStudy", warnings: tuple[str, ...] = ()) -> dict[str, Any]:
    from calrig.figures.filters import filters_figures
    from calrig.noise.filters import filters_document

    return _answer(filters_document(found), filters_figures(found), warnings)


def _answer(
    report: dict[str, Any], figures: Sequence[Sequence[tuple[str, Figure]]], warnings: tuple[str, ...]
) -> dict[str, Any]:
    from calrig.noise.report import said_first

    drawn = [{"caption": caption, "figure": figure} for row in figures for caption, figure in row]
    return {"report": said_first(warnings, report), "figures": drawn}
