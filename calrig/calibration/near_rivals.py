"""Rivals that came near an effect in all poses: a fold, which repeats the search, asks of no others again.

Only where an effect that has entered is held against its rivals once more: what enters is judged, and named,
among all candidates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calrig.calibration.candidates import Candidate
from calrig.calibration.ranking import Found

HOPELESS = 80.0
"""Of the criterion, behind an effect in all poses: with a quarter of them left out it is some 60 behind."""
Rivals = Mapping[str, frozenset[str]]
"""Labels by that of the effect."""


def near_rivals(found: Sequence[Found]) -> Rivals:
    """Of each effect found, the labels that are not hopeless against it."""
    return {
        f.candidate.label: frozenset(label for label, behind in f.considered if behind < HOPELESS)
        for f in found
    }


def near_among(candidates: Sequence[Candidate], one: Found, rivals: Rivals | None) -> Sequence[Candidate]:
    """The candidates that are not known to be hopeless against an effect, its own among them."""
    label = one.candidate.label
    if rivals is None or label not in rivals:
        return candidates
    return [c for c in candidates if c.label == label or c.label in rivals[label]]
