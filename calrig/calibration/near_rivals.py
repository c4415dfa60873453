"""Rivals that came near an effect in all poses: a fold, which repeats the search, asks of no others again.

Only where an effect that has entered is held against its rivals once more: what enters is judged, and named,
among all candidates.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import permutations

from calrig.calibration.candidates import Candidate
from calrig.calibration.ranking import Found

HOPELESS = 80.0
"""Of the criterion, behind an effect in all poses: with a quarter of them left out it is some 60 behind."""
Rivals = Mapping[str, Collection[str]]
"""Labels by that of the effect."""


def near_rivals(found: Sequence[Found]) -> Rivals:
    """Of each effect found, the labels that are not hopeless against it.

    Among them all others that were found, alone and two as one: it may stand in for them until they enter.
    """
    labels = [f.candidate.label for f in found]
    every = {*labels, *(" + ".join(two) for two in permutations(labels, 2))}
    return {
        f.candidate.label: every.union(label for label, behind in f.considered if behind < HOPELESS)
        for f in found
    }


def near_among(candidates: Sequence[Candidate], one: Found, rivals: Rivals | None) -> Sequence[Candidate]:
    """The candidates that are not known to be hopeless against an effect."""
    near = None if rivals is None else rivals.get(one.candidate.label)
    return candidates if near is None else [c for c in candidates if c.label in near]
