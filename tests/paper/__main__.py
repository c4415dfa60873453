"""Writes calrig/docs/validation/paper.md and its picture: `python -m tests.paper`; a minute."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from calrig.figures.files import writer_of
from calrig.figures.filters import KALMAN, SMOOTHERS, on_a_move
from calrig.figures.noise import allan_deviation, distribution, spectrum
from calrig.figures.runs import residual
from calrig.noise.analysis import Noise, analyse
from calrig.noise.filters import FilterStudy, study_filters

from . import known, moving, stage, static

DOCS = Path(__file__).parents[2] / "calrig" / "docs"
STAGES = 100
COLOURS = 64
"""Of the picture: a third of the bytes."""
PAGE = Path(__file__).with_name("page.md")


def main() -> None:
    """Measures all of it and writes the page."""
    at_rest, log = static.simulated(), static.public()
    logged = None if log is None else analyse(log.channels, log.time_s)
    filtered = None if log is None else study_filters(log.channels, log.time_s)
    studies = {rate_hz: moving.study(rate_hz) for rate_hz in moving.RATES_HZ}
    raw_deg, fused_deg = moving.slow_reading()
    fine = stage.runs(STAGES)
    page = PAGE.read_text(encoding="utf-8").format(
        rate_hz=static.RATE_HZ,
        static=static.table(at_rest, logged),
        quiet=static.quieter(logged),
        known=known.table(),
        together=known.simulated(),
        jitter=moving.jitter_table(studies, filtered),
        others=moving.other_jitters(studies[min(studies)]),
        moves=moving.moves_table(studies[static.RATE_HZ]),
        slow_raw=raw_deg,
        slow_fused=fused_deg,
        ratio=fused_deg / raw_deg,
        stages=STAGES,
        stage=stage.table(fine, stage.runs(STAGES, resolution_deg=stage.RESOLUTION_DEG)),
    )
    (DOCS / "validation" / "paper.md").write_text(page, encoding="utf-8")
    _draw(at_rest, studies[static.RATE_HZ], stage.typical(fine))


def _draw(at_rest: Noise, study: FilterStudy, run: stage.Calibrated) -> None:
    gyro, accel = (
        [one for name, one in at_rest.channels.items() if name.startswith(s)] for s in ("gyro", "accel")
    )
    rows = [
        [("Allan deviation, gyro", allan_deviation(gyro)), ("Power spectral density, gyro", spectrum(gyro))],
        [
            ("Allan deviation, accelerometer", allan_deviation(accel)),
            ("Power spectral density, accelerometer", spectrum(accel)),
        ],
        [("Distribution and fitted Gaussian", distribution(one)) for one in (gyro[0], accel[1])],
        [
            ("Smoothing filters on a move", on_a_move(study.comparison, SMOOTHERS)),
            ("Kalman filters on a move", on_a_move(study.comparison, KALMAN)),
        ],
        [("Readings less the stage's angle, one run of four sweeps", residual(run.poses))],
    ]
    file = DOCS / "paper.png"
    writer_of(file)("A simulated sensor of the paper's noise", rows)
    Image.open(file).convert("RGB").quantize(COLOURS).save(file, optimize=True)


if __name__ == "__main__":
    main()
