"""What noise gains beside a model, drawn once: a fold's search asks what the search of all poses has drawn.

Three quarters of the poses with the same effects in the model are searched for the same names, and noise of
the same correlation gains as much there. Where that leaves a decision open, the fold draws its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from calrig.calibration.candidates import Candidate
from calrig.calibration.noise_model import NoiseModel
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

FEWEST = 24
"""Draws to be told anything by."""
OTHER_RHO = 0.2
"""By how much the correlation of a fold's noise may be another: the bars for slow effects grow with it."""


class KnownNoise(NamedTuple):
    """Gains (b, L) of the best candidate of each label in noise, whose largest correlation is `rho`."""

    labels: tuple[str, ...]
    gains: FloatArray
    rho: float

    def of(self, labels: Sequence[str], noise: NoiseModel) -> FloatArray | None:
        """(b, l) those of some labels; None where they do not tell what a noise gains there."""
        places = {label: k for k, label in enumerate(self.labels)}
        other = abs(max(float(noise.rho.max()), 0.0) - max(self.rho, 0.0))
        if len(self.gains) < FEWEST or other > OTHER_RHO:
            return None
        if not places.keys() >= set(labels):
            return None
        return self.gains[:, [places[label] for label in labels]]


ModelKey = tuple[tuple[str, ...], frozenset[str]]
"""The columns of its base by name, and the labels of the effects in it."""
Noises = Mapping[ModelKey, KnownNoise]


def model_of(r: Responses, accepted: Sequence[Candidate]) -> ModelKey:
    """What a model has in common with that of more poses."""
    return r.base_names, frozenset(c.label for c in accepted)
