"""Uncertainty budget, coverage factor, conformity with limits, its risk, and the verdict (GUM, JCGM 106)."""

from __future__ import annotations

from calrig.calibration.uncertainty.budget import places_deg, reference_figures, uncertainty
from calrig.calibration.uncertainty.conformity import (
    answer_of,
    cannot_pass,
    deg,
    limit_for,
    percent,
    significant,
)
from calrig.calibration.uncertainty.coverage import COVERAGE, coverage_factor
from calrig.calibration.uncertainty.doubts import (
    REMOUNT_LIMIT_DEG,
    Line,
    clamping_doubts,
    displacement_doubts,
    pose_doubts,
    position_doubts,
    remount_doubts,
    repeat_doubts,
    residual_doubts,
    to_dicts,
)
from calrig.calibration.uncertainty.sequential_stopping import (
    AS_PLANNED,
    Ending,
    has_the_line,
    turned_both_ways,
)
from calrig.calibration.uncertainty.verdict import (
    IN_WORDS,
    SAME_EFFECT,
    between_runs,
    make_verdict,
    verdict_figures,
)

__all__ = [
    "AS_PLANNED",
    "COVERAGE",
    "IN_WORDS",
    "REMOUNT_LIMIT_DEG",
    "SAME_EFFECT",
    "Ending",
    "Line",
    "answer_of",
    "between_runs",
    "cannot_pass",
    "clamping_doubts",
    "coverage_factor",
    "deg",
    "displacement_doubts",
    "has_the_line",
    "limit_for",
    "make_verdict",
    "percent",
    "places_deg",
    "pose_doubts",
    "position_doubts",
    "reference_figures",
    "remount_doubts",
    "repeat_doubts",
    "residual_doubts",
    "significant",
    "to_dicts",
    "turned_both_ways",
    "uncertainty",
    "verdict_figures",
]
