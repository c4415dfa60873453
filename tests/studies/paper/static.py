"""Table 2 and the figures of noise: a sensor at rest for an hour."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from repository import SHARED

from calrig.export.static_csv import StaticLog, read_static
from calrig.noise.analysis import Noise, analyse

from .sensor import RATE_HZ, STANDARD_GRAVITY_MPS2, benches, log_of

DATA = Path(os.environ.get("CALRIG_DATA", SHARED / "data"))
PUBLIC = "mpu6050_static_100hz.csv"
HOUR_S = 3600.0
GAUSSIAN = {True: "yes", False: "no", None: "undecided"}
PAPER = {
    "gyro_x_dps": (-0.47, -0.02, 0.67),
    "gyro_y_dps": (-0.49, 0.02, 0.78),
    "gyro_z_dps": (-0.47, -0.03, 0.12),
    "accel_x_g": (-0.53, 0.01, 0.04),
    "accel_y_g": (-0.48, -0.01, 0.06),
    "accel_z_g": (-0.54, -0.01, 0.07),
}
"""Slope of the Allan deviation, slope of the spectrum, standard deviation (°/s, m/s²)."""


def simulated(seed: int = 1) -> Noise:
    """An hour of the paper's sensor."""
    time_s = np.arange(int(HOUR_S * RATE_HZ)) / RATE_HZ
    return analyse(log_of(benches(RATE_HZ, seed), time_s), time_s)


def public() -> StaticLog | None:
    """The public static log of an MPU-6050; None where it is not beside the repository."""
    file = DATA / PUBLIC
    if not file.exists():
        return None
    return read_static(file.read_bytes(), accel_range_g=2.0, gyro_range_dps=250.0)


def table(of_paper: Noise, logged: Noise | None) -> str:
    """Table 2 and the same of both logs, in Markdown."""
    rows = [
        "| channel | paper: ADF, PSD, std | simulated, 1 h | public log, 449 s | noise | Gaussian |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, (adf, psd, std) in PAPER.items():
        cells = [f"{adf:+.2f}, {psd:+.2f}, {std:.2f}", _cell(of_paper, name), _cell(logged, name)]
        both = [n.channels[name] for n in (of_paper, logged) if n is not None]
        cells += [
            ", ".join(one.colour for one in both),
            ", ".join(GAUSSIAN[one.distribution.gaussian] for one in both),
        ]
        rows.append(f"| {name.rsplit('_', 1)[0]} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _cell(noise: Noise | None, name: str) -> str:
    if noise is None:
        return "not here"
    one = noise.channels[name]
    psd = "–" if one.psd_slope is None else f"{one.psd_slope.slope:+.2f}"
    adf = "–" if one.allan.adf_slope is None else f"{one.allan.adf_slope:+.2f}"
    return f"{adf}, {psd}, {_std(noise, name):.3f}"


def quieter(logged: Noise | None) -> str:
    """The public log's standard deviations over the paper's, smallest to largest."""
    if logged is None:
        return "not measured here: an unknown share"
    shares = [_std(logged, name) / paper[2] for name, paper in PAPER.items()]
    return f"{100 * min(shares):.0f} to {100 * max(shares):.0f} %"


def _std(noise: Noise, name: str) -> float:
    std = noise.channels[name].distribution.std
    return std * STANDARD_GRAVITY_MPS2 if name.startswith("accel") else std
