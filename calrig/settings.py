"""The configuration, calrig.toml: rigs, limits, webhook, centre; and where store and packed files are."""

import os
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import platformdirs
from pydantic import (
    ConfigDict,
    Field,
    IPvAnyNetwork,
    PrivateAttr,
    ValidationError,
    field_validator,
    model_validator,
)

from calrig.invalid_fields import first_problem
from calrig.laboratory import STANDARDS, LaboratorySettings, Overdue, StandardSettings, Strict
from calrig.model.result import Distribution, StatedKind
from calrig.model.verdict import Interval, Limit


class WebhookSettings(Strict):
    """Where another program is told of each run's end, and what its key is kept in: a file or a variable."""

    url: Annotated[str, Field(pattern=r"^https?://[^\s/@]+(/\S*)?$", max_length=2000)]
    secret_file: Path | None = None
    secret_env: Annotated[str, Field(pattern=r"^\w+$", max_length=200)] | None = None

    @model_validator(mode="after")
    def _has_one_key(self) -> Self:
        if (self.secret_file is None) == (self.secret_env is None):
            raise ValueError(
                "a webhook needs secret_file or secret_env, one of them: what it sends is signed"
            )
        return self


Positive = Annotated[float, Field(gt=0)]


class LimitSettings(Limit):
    """A limit as people give it, a `[[limit]]` or an entry of `/api/limits`; it limits one figure or more."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    TITLES: ClassVar = {
        "max_error_deg": "Largest error",
        "bias_deg": "Bias",
        "scale": "Scale",
        "rms_deg": "RMS error",
        "expanded_uncertainty_deg": "Expanded uncertainty",
        "rule": "Decision rule",
        "guard": "Guard",
    }
    """What the page calls its fields."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    units: Annotated[str, Field(min_length=1, max_length=200)] = "*"
    rig: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    max_error_deg: Positive | None = None
    rms_deg: Positive | None = None
    expanded_uncertainty_deg: Positive | None = None
    guard: Annotated[float, Field(gt=0, le=10)] = 1.0

    @field_validator("bias_deg", "scale")
    @classmethod
    def _is_ordered(cls, ends: Interval | None) -> Interval | None:
        if ends is not None and ends[0] >= ends[1]:
            raise ValueError(f"the lower end {ends[0]:g} is not below the upper one {ends[1]:g}")
        return ends

    @model_validator(mode="after")
    def _asks_something(self) -> Self:
        asked = (self.max_error_deg, self.bias_deg, self.scale, self.rms_deg, self.expanded_uncertainty_deg)
        if all(one is None for one in asked):
            raise ValueError(f"the limit {self.name!r} asks nothing: give it at least one figure")
        return self


Period = Annotated[float, Field(gt=0, le=360)]
MOST_PERIODS = 20
CONFIG_NAME = "calrig.toml"
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+_.-]*://")


class SettingsError(Exception):
    """The configuration cannot be used; the message names file, rig and key, and what to do."""


ReleasePolicy = Literal["auto", "pass", "manual"]
"""Who puts a draft of a calibration in force: nobody need to, its limits, a person (CONTRACT section 6)."""


class StageSettings(Strict):
    """A rig's stage: elevation = sign · (stage − zero_deg) / ratio.

    `port`, of a board as well, is anything `serial.serial_for_url` opens, or `usb:` and the serial number of
    the USB adapter, which stays the same when the system renames its ports.
    """

    driver: str
    port: str
    axis: int = Field(default=1, ge=1, le=31)
    baudrate: int | None = Field(default=None, gt=0)
    zero_deg: float = 0.0
    sign: Literal[-1, 1] = 1
    ratio: float = Field(default=1.0, gt=0)
    tolerance_deg: float = Field(default=0.3, gt=0)


class BoardSettings(Strict):
    """A rig's sensor board."""

    driver: str
    port: str
    baudrate: int | None = Field(default=None, gt=0)


class ClampSettings(Strict):
    """What turns the unit in its clamp, where a rig has that: a motorised dividing head."""

    driver: Literal["index"]
    port: str
    baudrate: int | None = Field(default=None, gt=0)


class ReferenceSettings(StandardSettings):
    """What the stage's own angle is worth: its standard uncertainty and how it is shared among poses.

    `distribution`: a maker's limit of ±a is rectangular, with std_deg = a/√3; a certificate's U/k normal.
    `map` is the stage's map that was solved for, a file beside this one; beyond it `std_deg` counts.
    `good`: diagnoses take the stage as free of error, and curves of the angle as the sensor's.
    """

    std_deg: float | None = Field(default=None, gt=0)
    kind: StatedKind = "harmonic"
    distribution: Distribution = "rectangular"
    map: str | None = Field(default=None, min_length=1)
    good: bool = False

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.std_deg is None and self.map is None and not self.good:
            raise ValueError("reference needs `std_deg` (what the stage's angle is worth), or `map` (a file)")
        return self


class FilterSettings(Strict):
    """Noise of the Kalman filter (Nirmal et al. 2016): Q in deg² and (deg/s)² per second, R in deg²."""

    q_angle: float = Field(default=0.001, gt=0)
    q_bias: float = Field(default=0.003, ge=0)
    r_deg2: float = Field(default=0.03, gt=0)


class RigSettings(Strict):
    """One stage and one board; a clamp where there is one. `simulated` takes the place of ports."""

    name: Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[\w.-]+$")]
    limits_deg: tuple[float, float] = (-90.0, 90.0)
    release: ReleasePolicy = "auto"
    remount_limit_deg: float = Field(default=1.0, gt=0)
    """How far remounting may turn a unit, where fewer than three repeats tell."""
    stage: StageSettings | None = None
    imu: BoardSettings | None = None
    clamp: ClampSettings | None = None
    reference: ReferenceSettings | None = None
    periods_deg: Annotated[tuple[Period, ...], Field(max_length=MOST_PERIODS)] = ()
    """Known periods of the axis, such as a worm's or a motor's: diagnoses look for them."""
    thermometer: StandardSettings | None = None
    time_base: StandardSettings | None = None
    overdue: Overdue = "flag"
    filter: FilterSettings = FilterSettings()
    simulated: dict[str, Any] | None = None
    time_scale: float = Field(default=1.0, gt=0)
    """Seconds of its clocks for one on the wall; a simulated rig tells its own."""

    @property
    def devices(self) -> list[StageSettings | BoardSettings | ClampSettings]:
        """What of it hangs on a port."""
        return [part for part in (self.stage, self.imu, self.clamp) if part is not None]

    @model_validator(mode="after")
    def _has_ports_and_ordered_limits(self) -> Self:
        if self.limits_deg[0] >= self.limits_deg[1]:
            raise ValueError("limits_deg must be [lower, upper] with lower < upper")
        if self.simulated is None and (self.stage is None or self.imu is None):
            raise ValueError("a rig needs both `stage` and `imu` (or `simulated`)")
        return self


class CentreSettings(Strict):
    """How agents reach a centre's database, where that is not as the centre itself does."""

    agent_db_host: Annotated[str, Field(pattern=r"^[\w.:-]+$", max_length=253)] | None = None
    agent_db_port: int | None = Field(default=None, ge=1, le=65535)


class Settings(Strict):
    """Everything configured."""

    rig: tuple[RigSettings, ...] = ()
    limit: tuple[LimitSettings, ...] = ()
    """Limits that are kept here; without any, those that people keep in the store."""
    hosts: tuple[Annotated[str, Field(pattern=r"^[\w.-]+$", max_length=253)], ...] = ()
    """Names besides its own address that `serve` answers to, such as the one of a proxy in front of it."""
    interval_days: float = Field(default=365.0, gt=0)
    """After so many days a unit is due to be calibrated again, unless its own history says when."""
    trusted_proxies: tuple[IPvAnyNetwork, ...] = ()
    """Addresses or networks of proxies that say whom they let in; what others say of that is dropped."""
    user_header: Annotated[str, Field(pattern=r"^[A-Za-z0-9-]+$", max_length=64)] = "X-Forwarded-User"
    """The header in which they say it."""
    keep_samples_days: float | None = Field(default=None, gt=0)
    """Raw samples of runs older than this are deleted when the service starts; null keeps them for ever."""

    laboratory: LaboratorySettings = LaboratorySettings()
    centre: CentreSettings = CentreSettings()
    webhook: WebhookSettings | None = None
    """Here alone: no request could have the service speak to an address of its choice."""

    _file: Path | None = PrivateAttr(default=None)

    @property
    def file(self) -> Path | None:
        """The file that all this was read from."""
        return self._file

    def ports(self) -> list[str]:
        """The ports that are configured, without those of simulated rigs, which are not running."""
        real = [rig for rig in self.rig if rig.simulated is None]
        return [part.port for rig in real for part in rig.devices]

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        names = [rig.name for rig in self.rig]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two rigs are named {name!r}")
        limits = [limit.name for limit in self.limit]
        for name in limits:
            if limits.count(name) > 1:
                raise ValueError(f"two limits are named {name!r}")
        return self


DEMO_RIG = RigSettings(
    name="demo",
    limits_deg=(-90.0, 90.0),
    reference=ReferenceSettings(std_deg=0.29, kind="harmonic"),
    simulated={"preset": "demo"},
)
"""What `serve` and `run` use when no rig is configured."""


def load_settings(path: str | None = None) -> Settings:
    """Reads the configuration, or the demo rig's where there is none.

    Args:
        path: the file to read; without it CALRIG_CONFIG, then calrig.toml in the working directory, then
            in the user's configuration folder.

    Raises:
        SettingsError: the file is named but absent, or does not parse, or has a wrong or unknown key.
    """
    file = _find(path)
    if file is None:
        return Settings(rig=(DEMO_RIG,))
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise SettingsError(f"{file}: is not UTF-8 text (byte {error.start})") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{file}: {error}") from error
    try:
        settings = Settings.model_validate(document)
    except ValidationError as error:
        raise SettingsError(f"{file}: {first_problem(error.errors()[0], document)}") from error
    settings = _with_files(settings, file)
    settings._file = file
    return settings if settings.rig else settings.model_copy(update={"rig": (DEMO_RIG,)})


def _with_files(settings: Settings, file: Path) -> Settings:
    """The settings with what lies beside them: certificates' hashes, and whole paths of the laboratory's."""
    place = "laboratory"
    try:
        laboratory = settings.laboratory.read_beside(file.parent)
        rigs = []
        for rig in settings.rig:
            found: dict[str, StandardSettings] = {}
            for key in STANDARDS:
                place = f"rig {rig.name!r}, {key}"
                if (standard := getattr(rig, key)) is not None:
                    found[key] = standard.read_beside(file.parent)
            rigs.append(rig.model_copy(update=found))
    except ValueError as error:
        raise SettingsError(f"{file}: {place}: {error}") from error
    return settings.model_copy(update={"laboratory": laboratory, "rig": tuple(rigs)})


def _find(path: str | None) -> Path | None:
    named = path or os.environ.get("CALRIG_CONFIG")
    if named:
        return Path(named)
    for folder in (Path.cwd(), platformdirs.user_config_path("calrig")):
        if (folder / CONFIG_NAME).is_file():
            return folder / CONFIG_NAME
    return None


def store_url(db: str | None = None) -> str:
    """The store's SQLAlchemy URL: `db` (a path or a URL), else CALRIG_DB, else the user's data folder.

    Raises:
        SettingsError: `db` is empty, as a script's variable may be that was never set.
    """
    if db is not None and not db.strip():
        raise SettingsError("--db is empty: name a file, or leave --db out for the store in your data folder")
    named = db or os.environ.get("CALRIG_DB")
    if not named:
        named = str(platformdirs.user_data_path("calrig", ensure_exists=True) / "calrig.db")
    if _URL.match(named):
        return named
    path = str(Path(os.path.expanduser(named)).resolve())  # noqa: PTH111 (pathlib refuses `~x.db`)
    for reserved in "%?#":  # what a URL would take for something else than a part of the name
        path = path.replace(reserved, f"%{ord(reserved):02X}")
    return f"sqlite:///{path}"


def centre_url_file() -> Path:
    """Where `calrig agent enroll` leaves the URL of the centre's database, and `calrig agent` finds it."""
    return platformdirs.user_config_path("calrig") / "centre.url"


def packed(folder: str) -> Path:
    """Where `web` or `migrations` lie: inside the installed package, or beside it in a checkout."""
    inside = Path(__file__).parent / f"_{folder}"
    return inside if inside.is_dir() else Path(__file__).parent.parent / folder
