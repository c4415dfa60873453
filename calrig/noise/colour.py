"""The noise of a channel in one word (CONTRACT section 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np

from calrig.noise.allan import AllanCurve
from calrig.noise.allan_theory import KINDS, variance_of
from calrig.noise.coefficients import Coefficients
from calrig.noise.spectral_lines import Line

Colour: TypeAlias = Literal["white", "pink", "brown", "quantisation-limited", "lines", "mixed"]

_WORDS: tuple[Colour, ...] = ("quantisation-limited", "white", "pink", "brown")
"""In the order of `KINDS`."""
_ADF_SLOPES = np.array([-1.0, -0.5, 0.0, 0.5])
_PSD_SLOPES = np.array([2.0, 0.0, -1.0, -2.0])
RULES = 0.75
"""Share of the octaves of τ in which a kind must be the largest for the noise to be called after it."""
NEAR_ADF, NEAR_PSD = 0.2, 0.6
"""How far a measured slope may be from a kind's own."""


def colour_of(
    curve: AllanCurve, coefficients: Coefficients, psd_slope: float | None, lines: Sequence[Line]
) -> Colour | None:
    """What to call the noise; None where there is none, or nothing to tell it by.

    - A log with a line is `lines`, `mixed` if what is under the line is not white.
    - `white`, `pink` (flicker), `brown` (random walk) or `quantisation-limited` (quantisation): that kind is
      the largest in three quarters of the octaves of τ, or where no coefficient was found, the only one that
      the slopes allow; and neither slope is far from its own: that of the Allan deviation up to 1 s from
      −1/2, 0, 1/2 or −1, that of the spectrum from 0, −1, −2 or 2.
    - `mixed` is the rest. A ramp is no noise and has no colour.
    """
    if not (curve.deviation > 0.0).any():
        return None
    ruling = _ruling(curve, coefficients)
    if lines:
        return "lines" if ruling in {None, "white"} else "mixed"
    fitting = _fitting(curve.adf_slope, psd_slope)
    if ruling is not None:
        return ruling if ruling in fitting else "mixed"
    if curve.adf_slope is None and psd_slope is None:
        return None
    return fitting[0] if len(fitting) == 1 else "mixed"


def _ruling(curve: AllanCurve, coefficients: Coefficients) -> Colour | None:
    """The kind that is the largest in most octaves; `mixed` where none is, None without coefficients."""
    found = [getattr(coefficients, kind) for kind in KINDS]
    if not any(found):
        return None
    squares = np.array([one.value**2 if one else 0.0 for one in found])
    octaves = np.arange(0.0, np.log2(curve.tau_s[-1] / curve.tau_s[0]) + 1e-9)
    largest = np.argmax(variance_of(curve.tau_s[0] * 2.0**octaves) * squares, axis=1)
    share = np.bincount(largest, minlength=len(KINDS)) / len(largest)
    return _WORDS[int(np.argmax(share))] if share.max() >= RULES else "mixed"


def _fitting(adf_slope: float | None, psd_slope: float | None) -> list[Colour]:
    """The words whose slopes are near those measured."""
    near = np.ones(len(_WORDS), dtype=np.bool_)
    if adf_slope is not None:
        near &= np.abs(adf_slope - _ADF_SLOPES) <= NEAR_ADF
    if psd_slope is not None:
        near &= np.abs(psd_slope - _PSD_SLOPES) <= NEAR_PSD
    return [word for word, fits in zip(_WORDS, near, strict=True) if fits]
