"""Uncertainty budget, coverage factor, conformity with limits, its risk, and the verdict (GUM, JCGM 106)."""

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
from calrig.calibration.uncertainty.verdict import IN_WORDS, SAME_EFFECT, make_verdict, verdict_figures
