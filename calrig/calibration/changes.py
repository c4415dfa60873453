"""What changed between two runs of a unit: the diagnosis of both together, less what was the same in both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from calrig.calibration.diagnosis import BOOTSTRAPS, diagnose, document
from calrig.calibration.pose import Pose


@dataclass(frozen=True, slots=True)
class Changes:
    """What differs between two runs.

    Attributes:
        effects: CONTRACT section 5's, those with `changed`; none where the runs do not differ.
        before_rms_deg, after_rms_deg: of the poses of both, with one bias and scale, and with all effects.
    """

    effects: tuple[dict[str, Any], ...]
    before_rms_deg: float
    after_rms_deg: float


def changes(
    before: Sequence[Pose],
    after: Sequence[Pose],
    run_ids: tuple[str, str],
    *,
    seed: int = 0,
    bootstraps: int = BOOTSTRAPS,
) -> Changes:
    """Traces what differs between two runs to effects.

    Args:
        before: poses of the earlier run, in the order measured, none excluded.
        after: of the later run.
        run_ids: of both.
        seed: of the bootstrap.
        bootstraps: of each step of the search.

    Raises:
        DiagnosisError: the poses cannot be diagnosed; the message says why.
    """
    found = document(
        diagnose([before, after], run_ids, seed=seed, bootstraps=bootstraps, cross_fit=False), run_ids
    )
    effects = tuple(effect for effect in found["effects"] if effect["changed"] is not None)
    return Changes(effects, found["base"]["fit_rms_deg"], found["final"]["fit_rms_deg"])
