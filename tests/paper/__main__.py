"""Writes calrig/docs/paper.md and its picture: `python -m tests.paper`; half a minute."""

from __future__ import annotations

from pathlib import Path

from calrig.figures.files import writer_of
from calrig.figures.filters import KALMAN, SMOOTHERS, on_a_move
from calrig.figures.noise import allan_deviation, spectrum
from calrig.noise.analysis import Noise
from calrig.noise.filters import FilterStudy

from . import known, moving, stage, static

DOCS = Path(__file__).parents[2] / "calrig" / "docs"
STAGES = 100
PAGE = Path(__file__).with_name("page.md")


def main() -> None:
    """Measures all of it and writes the page."""
    at_rest, logged = static.simulated(), static.public()
    studies = {rate_hz: moving.study(rate_hz) for rate_hz in moving.RATES_HZ}
    raw_deg, fused_deg = moving.slow_reading()
    page = PAGE.read_text(encoding="utf-8").format(
        rate_hz=static.RATE_HZ,
        static=static.table(at_rest, logged),
        quiet=static.quieter(logged),
        known=known.table(),
        jitter=moving.jitter_table(studies),
        moves=moving.moves_table(studies[static.RATE_HZ]),
        slow_raw=raw_deg,
        slow_fused=fused_deg,
        ratio=fused_deg / raw_deg,
        stages=STAGES,
        stage=stage.table(stage.runs(STAGES)),
    )
    (DOCS / "paper.md").write_text(page, encoding="utf-8")
    _draw(at_rest, studies[static.RATE_HZ])


def _draw(at_rest: Noise, study: FilterStudy) -> None:
    gyro = [at_rest.channels[f"gyro_{axis}_dps"] for axis in "xyz"]
    rows = [
        [("Allan deviation, gyro", allan_deviation(gyro)), ("Power spectral density, gyro", spectrum(gyro))],
        [
            ("Smoothing filters on a move", on_a_move(study.comparison, SMOOTHERS)),
            ("Kalman filters on a move", on_a_move(study.comparison, KALMAN)),
        ],
    ]
    writer_of(DOCS / "paper.png")("A simulated sensor of the paper's noise", rows)


if __name__ == "__main__":
    main()
