"""Generated files through the commands and the HTTP API, and what every answer must keep.

Each file has any subset of the columns that have a meaning and of one's own, over any arc, spacing, direction
and number of rows, with or without an effect.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx
import numpy as np

from calrig.calibration.diagnosis import held_out, tracing
from calrig.calibration.regression.terms import LEAST_TURN_DEG
from tests.command_line import CliRunner, app

COMMANDS = ("diagnose", "import", "solve", "gravity", "apply", "api")
SHARES = (0.80, 0.04, 0.05, 0.05, 0.05, 0.01)
ROWS = (3, 4, 5, 6, 7, 8, 9, 10, 12, 15, 20, 30, 50, 100, 200, 485, 1000)
ROW_SHARES = np.array([4, 5, 6, 8, 10, 10, 8, 8, 8, 8, 6, 4, 2, 0.7, 0.3, 0.1, 0.1])
SPANS_DEG = (0.0, 0.001, 0.1, 1.0, 5.0, 20.0, 60.0, 120.0, 178.0, 270.0, 359.0, 360.0, 725.0, 2500.0)
OWN_NAMES = (
    "supply_v", "humidity [%]", "Größe", "速度", "a" * 90, "__class__", "x y", "1e5", "target", "azimuth_deg",
    "Reading (raw)", "order", "residual", "time", "=1+1", "the elevation", "motor_turns", "p-value", "%",
)  # fmt: skip
CHANNELS = (
    "pass", "approach", "time_s", "temperature_c", "stage_deg", "reading_std_deg", "reading_stderr_deg",
    "n_samples", "accel_x_g", "accel_y_g", "accel_z_g", "gyro_move_deg", "settle_s", "velocity_dps",
    "gyro_x_dps", "gyro_y_dps", "gyro_z_dps", "gyro_move_x_deg", "host_time_s", "mount_deg", "mount",
    "mount_axis", "unit",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Case:
    """A file and what is asked of it.

    Attributes:
        command: one of `COMMANDS`.
        text: the file.
        options: of `calrig diagnose`.
        theta_deg: (n,) commanded elevations.
    """

    command: str
    text: str
    options: tuple[str, ...]
    theta_deg: np.ndarray

    @property
    def document(self) -> dict[str, Any]:
        """The same options as the body of an API call."""
        pairs = list(itertools.pairwise(self.options))
        periods = [float(value) for name, value in pairs if name == "--period"]
        reference = [value for name, value in pairs if name == "--reference"]
        return {"periods": periods, **({"reference": reference[0]} if reference else {})}


def case(seed: int) -> Case:
    """Return the case of a number."""
    rng = np.random.default_rng([seed, 2])
    command = str(rng.choice(COMMANDS, p=SHARES))
    count = int(rng.choice(ROWS, p=ROW_SHARES / ROW_SHARES.sum()))
    theta = _elevations_deg(rng, count)
    count = len(theta)
    columns = _columns(rng, theta)
    kept = [name for name in CHANNELS if name in columns and rng.random() < rng.choice([0.15, 0.5, 0.9])]
    if rng.random() < 0.5:
        kept = [n for n in kept if not n.startswith("accel")]
    if command == "gravity" or rng.random() < 0.2:
        kept = [*(n for n in kept if not n.startswith("accel_")), *(f"accel_{axis}_g" for axis in "xyz")]
    own = [n for n in columns if n in OWN_NAMES]
    names = ["target_deg", "reading_deg", *kept, *own]
    rng.shuffle(names)
    rows = [[_cell(columns[name][k]) for name in names] for k in range(count)]
    if rng.random() < 0.15:  # cells that are not known
        optional = [k for k, name in enumerate(names) if name not in {"target_deg", "reading_deg"}]
        for row in rows:
            for k in optional:
                row[k] = "" if rng.random() < 0.08 else row[k]
    options: list[str] = []
    if rng.random() < 0.25:
        options += ["--reference", str(rng.choice(["good", "stage"]))]
    for _ in range(int(rng.choice([0, 0, 0, 1, 2]))):
        options += ["--period", f"{rng.choice([0.9, 1.8, 3.6, 7.2, 36.0, 90.0, rng.uniform(0.6, 359.0)]):g}"]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    return Case(command, text.getvalue(), tuple(options), theta)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


def _elevations_deg(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return (n,) commanded elevations in the order visited, about as many as asked for."""
    span = float(rng.choice(SPANS_DEG))
    low = float(rng.choice([-span / 2.0, 0.0, -180.0, 10.0, 300.0]))
    places = max(1, count // int(rng.choice([1, 1, 1, 2, 3, 8])))
    kind = rng.integers(6)
    if kind == 0:
        theta = rng.uniform(low, low + span, places)
    elif kind == 1:  # a step that is a whole number of something
        theta = low + float(rng.choice([0.001, 0.1, 0.45, 0.9, 1.8, 5.0, 15.0, 45.0, 90.0])) * np.arange(
            places
        )
    elif kind == 2:  # a few that lie close, and others far away
        theta = low + span * np.sort(rng.beta(0.2, 0.2, places))
    else:
        theta = np.linspace(low, low + span, places)
    if kind == 5:
        theta = theta + rng.normal(0.0, 1e-3 + span / 300.0, places)
    order = rng.integers(7)
    if order == 0:
        theta = theta[::-1]
    elif order == 1:
        theta = rng.permutation(theta)
    elif order == 2:
        theta = np.concatenate([theta[::2], theta[::-2]])
    theta = np.resize(np.concatenate([theta, theta[::-1]]) if order in {3, 4} else theta, count)
    if rng.random() < 0.1:
        theta = np.repeat(theta, 2)[: max(3, count)]
    return np.round(theta, int(rng.choice([1, 3, 9])))


def _columns(rng: np.random.Generator, theta: np.ndarray) -> dict[str, Any]:
    """Return (n,) each, all columns that a file may have."""
    n = len(theta)
    when = float(rng.choice([0.01, 1.0, 3.3, 600.0])) * np.arange(n)
    if rng.random() < 0.2:
        when = rng.permutation(when)
    if rng.random() < 0.1:
        when = when // 3.0
    noise = float(rng.choice([0.0, 1e-6, 0.003, 0.03, 0.3, 5.0]))
    move = np.diff(theta, prepend=theta[0])
    approach = np.where(move > 0.0, 1, np.where(move < 0.0, -1, rng.choice([0, 1])))
    warm = 20.0 + rng.choice([0.0, 5.0, 60.0]) * rng.choice([when / (np.ptp(when) or 1.0), rng.random(n)])
    own = {
        str(name): rng.choice([rng.standard_normal(n), theta, when, np.ones(n), move, np.round(theta / 9.0)])
        * 10.0 ** rng.integers(-6, 7)
        for name in rng.choice(OWN_NAMES, size=int(rng.choice([0, 0, 1, 3])), replace=False)
    }
    size = noise * 10.0 ** rng.uniform(-0.5, 2.5) or 10.0 ** rng.uniform(-3.0, 1.0)
    error = np.zeros(n)
    for _ in range(int(rng.choice([0, 0, 1, 1, 2]))):
        error = error + size * _effect(rng, theta, when, approach, warm)
    if own and rng.random() < 0.2:
        values = next(iter(own.values()))
        error = error + size * values / (np.abs(values).max() or 1.0)
    reading = rng.choice([0.0, 0.4, -30.0]) + rng.choice([1.0, 1.0, 1.0, 1.02, -1.0, 0.5]) * theta + error
    reading = reading + noise * rng.standard_normal(n)
    tilt = np.radians(theta + rng.choice([0.0, 0.7]) + (error if rng.random() < 0.5 else 0.0))
    scatter = rng.choice([0.0, 1e-4, 1e-2]) * rng.standard_normal((3, n))
    gain = rng.choice([1.0, 1.0, 1.01, 0.0])
    if rng.random() < 0.4:
        reading = (reading + 180.0) % 360.0 - 180.0 if rng.random() < 0.6 else reading % 360.0
    constant = rng.random() < 0.05
    return {
        "target_deg": theta,
        "reading_deg": np.full(n, 1.0) if constant else np.round(reading, int(rng.choice([2, 4, 12]))),
        "pass": np.cumsum(np.diff(approach, prepend=approach[0]) != 0)
        if rng.random() < 0.8
        else np.arange(n),
        "approach": approach if rng.random() < 0.8 else np.zeros(n, dtype=int),
        "time_s": when,
        "temperature_c": warm,
        "stage_deg": theta + noise * rng.choice([0.0, 0.3, 300.0]) * rng.standard_normal(n),
        "reading_std_deg": np.full(n, noise),
        "reading_stderr_deg": np.full(n, noise / 3.0),
        "n_samples": np.full(n, int(rng.choice([0, 1, 400]))),
        "accel_x_g": scatter[0],
        "accel_y_g": gain * np.sin(tilt) + scatter[1],
        "accel_z_g": np.cos(tilt) + scatter[2],
        "gyro_move_deg": move * rng.choice([1.0, 1.01, 0.0]) + 0.01 * rng.standard_normal(n),
        "settle_s": rng.choice([np.full(n, 1.0), np.zeros(n), rng.uniform(0.1, 3.0, n)]),
        "velocity_dps": rng.choice(
            [np.sign(move) * 5.0, move / 3.3, np.full(n, 5.0), rng.normal(0.0, 9.0, n)]
        ),
        "gyro_x_dps": 0.1 * rng.standard_normal(n),
        "gyro_y_dps": np.full(n, 0.02),
        "gyro_z_dps": 0.1 * rng.standard_normal(n),
        "gyro_move_x_deg": move,
        "host_time_s": 1.7e9 + when,
        "mount_deg": rng.choice([np.zeros(n), np.full(n, 90.0), 90.0 * (np.arange(n) % 2)]),
        "mount": ["a"] * n if rng.random() < 0.5 else [f"m{k // 4}" for k in range(n)],
        "mount_axis": ["x"] * n if rng.random() < 0.93 else [str(rng.choice(["-x", "y"]))] * n,
        "unit": ["AS-1"] * n if rng.random() < 0.95 else [f"AS-{k % 2}" for k in range(n)],
        **own,
    }


def _effect(
    rng: np.random.Generator, theta: np.ndarray, when: np.ndarray, approach: np.ndarray, warm: np.ndarray
) -> np.ndarray:
    """Return (n,) what a cause of size 1 adds to the readings."""
    period = float(rng.choice([360.0, 180.0, 90.0, 7.2, 3.6, 1.8, rng.uniform(0.5, 200.0)]))
    arc = np.ptp(theta) or 1.0
    kinds: list[Callable[[], np.ndarray]] = [
        lambda: np.sin(2.0 * np.pi * theta / period + rng.uniform(0.0, 6.0)),
        lambda: approach / 2.0,
        lambda: (when > np.median(when)).astype(float),
        lambda: ((theta - theta.min()) / arc) ** 2,
        lambda: when / (np.ptp(when) or 1.0),
        lambda: warm - 20.0,
        lambda: 0.05 * np.diff(theta, prepend=theta[0]),
        lambda: approach * (theta - theta.min()) / arc,
        lambda: 30.0 * (np.arange(len(theta)) == rng.integers(len(theta))),
        lambda: np.cumsum(rng.standard_normal(len(theta))) / 3.0,
    ]
    return kinds[rng.integers(len(kinds))]()


REFUSED, FAILED = "refused", "failed"


class Bench:
    """Runs cases in this process, in a folder of its own.

    Args:
        folder: for files and a store.
        client: of a running service; None where there is none.
        bootstraps: of each step of a search.
    """

    def __init__(self, folder: Path, client: httpx.Client | None = None, bootstraps: int = 99) -> None:
        self._folder, self._client, self._bootstraps = folder, client, bootstraps

    def outcome(self, one: Case) -> str:
        """Return how a case ended: a verdict, `done`, or `refused`.

        Raises:
            AssertionError: something that every answer must keep is not kept.
        """
        file = self._folder / "table.csv"
        file.write_text(one.text, encoding="utf-8")
        with (
            patch.dict(tracing.diagnose.__kwdefaults__ or {}, bootstraps=self._bootstraps),
            patch.object(held_out, "BOOTSTRAPS", min(self._bootstraps, held_out.BOOTSTRAPS)),
        ):
            return str(getattr(self, f"_{one.command}")(one, file))

    def _run(self, *arguments: object) -> tuple[str, str]:
        """Run a command; `refused` and its reason, or `done` and its output."""
        result = CliRunner().invoke(app, [str(word) for word in arguments], catch_exceptions=False)
        if result.exit_code:
            reason = result.stderr.splitlines()[-1]
            assert result.exit_code in {1, 2} and reason.startswith("calrig"), (
                result.exit_code,
                result.stderr,
            )
            assert "Traceback" not in result.stderr
            return REFUSED, reason
        return "done", result.stdout

    def _diagnose(self, one: Case, file: Path) -> str:
        plot = ["--plot", self._folder / "plot.svg"] if len(one.text) % 20 == 0 else []
        ended, told = self._run("diagnose", file, "--json", *one.options, *plot)
        return ended if ended == REFUSED else _checked(json.loads(told), one)

    def _import(self, one: Case, file: Path) -> str:
        db = self._folder / "calrig.db"
        ended, told = self._run("import", file, "--unit", "AS-1", "--db", db)
        if ended == REFUSED:
            return ended
        ended, told = self._run("diagnose", told.split()[0], "--db", db, "--json", *one.options)
        return ended if ended == REFUSED else _checked(json.loads(told), one)

    def _solve(self, one: Case, file: Path) -> str:
        ended, told = self._run("solve", file, "--unit", "AS-1", "--json", "--out", self._folder / "solved")
        if ended != REFUSED:
            _refuse_not_finite(json.loads(told))
        return ended

    def _gravity(self, one: Case, file: Path) -> str:
        ended, told = self._run("gravity", file, "--json")
        if ended == REFUSED:
            return ended
        found = json.loads(told)
        _refuse_not_finite(found)
        base, final = found["base"], found["final"]
        assert final["held_out_rms_mg"] <= base["held_out_rms_mg"] * (1.0 + 1e-9), (base, final)
        return str(found["verdict"])

    def _apply(self, one: Case, file: Path) -> str:
        db = self._folder / "calrig.db"
        ended, told = self._run("import", file, "--unit", "AS-1", "--db", db)
        if ended == REFUSED:
            return ended
        ended, document = self._run("export", told.split()[0], "--db", db)
        if ended == REFUSED:
            return ended
        (self._folder / "calibration.json").write_text(document, encoding="utf-8")
        low, high = json.loads(document)["range_deg"]
        ended, told = self._run("apply", self._folder / "calibration.json", file)
        if ended != REFUSED:
            rows = list(csv.DictReader(io.StringIO(told)))
            values = [float(row["elevation_deg"]) for row in rows if row["elevation_deg"]]
            assert all(map(math.isfinite, values))
            middle = (low + high) / 2.0
            assert all(abs(value - middle) <= max(180.0, high - low) + 1e-6 for value in values), (low, high)
        return ended

    def _api(self, one: Case, file: Path) -> str:
        assert self._client is not None
        sent = {"file": ("table.csv", one.text.encode())}
        made = self._client.post("/api/imports", files=sent, data={"unit": "AS-1"})
        if made.status_code == 422:
            return REFUSED
        run = made.raise_for_status().json()
        found = self._client.post(f"/api/runs/{run['id']}/diagnosis", json=one.document)
        if found.status_code in {409, 422}:
            return REFUSED
        return _checked(found.raise_for_status().json(), one)


def _checked(found: dict[str, Any], one: Case) -> str:
    """Return a diagnosis's verdict once it keeps what every diagnosis must."""
    _refuse_not_finite(found)
    base, final = found["base"], found["final"]
    if base["held_out_rms_deg"] is not None:
        assert final["held_out_rms_deg"] <= base["held_out_rms_deg"] * (1.0 + 1e-9), (base, final)
    assert found["noise"]["std_deg"] >= 0.0, found["noise"]
    for effect in found["effects"]:
        _refuse_small(effect)
        _refuse_no_period(effect, one.theta_deg, found["known_periods_deg"])
    if "accel_y_g" not in one.text or "accel_z_g" not in one.text:
        assert "accelerometer" not in json.dumps(found["warnings"]), found["warnings"]
        for effect in found["effects"] if np.ptp(one.theta_deg) < LEAST_TURN_DEG else ():
            rivals = {effect["name"], *effect["confusable_with"]}
            assert "accelerometer_offset" not in rivals, rivals
    return str(found["verdict"])


def _refuse_not_finite(document: Any) -> None:
    assert all(map(math.isfinite, _numbers(document))), document


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        value = value.values()
    if isinstance(value, int | float):
        yield value
    elif value is not None and not isinstance(value, str):
        for one in value:
            yield from _numbers(one)


NO_SIZES = {"phase_deg", "period_deg", "reference_c", "at_s", "lag_s", "period", "at"}


def _refuse_small(effect: dict[str, Any]) -> None:
    """Refuse an effect that states one size, which is below two of its standard errors."""
    sizes = {k: v for k, v in effect["parameters"].items() if k not in NO_SIZES and isinstance(v, dict)}
    known = [size for size in sizes.values() if size["value"] is not None and size["std"] is not None]
    if len(known) == 1:
        assert abs(known[0]["value"]) >= 2.0 * known[0]["std"] * (1.0 - 1e-9), effect


def _refuse_no_period(effect: dict[str, Any], theta_deg: np.ndarray, known_deg: Sequence[float]) -> None:
    """Refuse a period that the elevations cannot carry, unless somebody stated it."""
    period = (effect["parameters"].get("period_deg") or {}).get("value")
    if period is None or any(abs(period * k / one - 1.0) < 1e-6 for one in known_deg for k in range(1, 9)):
        return
    span = float(np.ptp(theta_deg))
    assert period <= max(360.0, span) * (1.0 + 1e-9), effect
    steps = np.diff(np.unique(theta_deg))
    if len(steps) > 1 and np.ptp(steps) <= 1e-6 * steps.mean():
        assert abs(1.0 / period - 0.5 / steps.mean()) >= (1.0 - 1e-6) / span, (effect, steps.mean())
