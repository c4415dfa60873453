"""The uncertainty budget of a certificate, by JCGM 100:2008.

The calibration document is the authority: its combined uncertainty, k and U are taken from it, and only split
into contributions here. They are computed by `calrig.calibration.uncertainty.budget`.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from calrig.calibration.uncertainty import coverage_factor
from calrig.export.certificate.content import Budget, Contribution, by_itself
from calrig.model.result import Reference

KINDS = {
    "setting": "made anew with every setting",
    "harmonic": "a smooth error of the turn, common to all poses",
    "common": "one error common to all poses",
    "map": "by its map, whose error is one smooth curve common to all poses",
}
_INFINITE = 1e6
"""Degrees of freedom that count as infinitely many."""
_SAME_FACTOR = 1e-9
"""Two ways to the same k agree to this; k by convolution differs by more wherever both parts count."""


def budget_of(document: Mapping[str, Any], reference: Reference | None, freedom: int | None) -> Budget:
    """The budget of a calibration document.

    `reference` is None where the rig said nothing of its stage, or the stage's map did; `freedom`, of the
    scatter about the line, where it is not known.
    """
    parts = [*_of_poses(document, freedom), *_of_reference(document, reference)]
    worth = document["uncertainty"]
    known = (worth["type_a_deg"], worth["type_b_deg"])
    combined_deg = None if None in known else math.hypot(*known)
    variance = sum(signed for _, signed in parts)
    lines = tuple(replace(line, share=signed / variance if variance else 0.0) for line, signed in parts)
    effective = _effective_freedom(worth["type_a_deg"], combined_deg, freedom)
    return Budget(
        contributions=lines,
        combined_deg=combined_deg,
        effective_freedom=effective,
        coverage_factor=document["coverage_factor"],
        coverage=document["coverage"],
        expanded_deg=document["expanded_uncertainty_deg"],
        method=tuple(_method(document, reference, effective)),
        not_contained=tuple(_not_contained(document)),
    )


_Part = tuple[Contribution, float]
"""A line without its share, and what it adds to the variance, deg²."""


def _of_poses(document: Mapping[str, Any], freedom: int | None) -> list[_Part]:
    """Type A, taken apart: u²(θ) = (s² + var(b) + 2θ·cov(b, m) + θ²·var(m))/m², its mean over the range.

    With effects, bias, scale and effects are one curve: their errors cancel for the most part.
    """
    type_a_deg, covariance = document["uncertainty"]["type_a_deg"], document["covariance"]
    if type_a_deg is None:
        return []
    if covariance is None or "elevation_std_deg" in document:
        noise = Contribution("s", "Noise of a reading", "A", "normal", freedom, type_a_deg, "°", 1.0, "°/°")
        return [(noise, noise.contribution_deg**2)]
    low, high = document["range_deg"]
    mean_deg, square_deg2 = (low + high) / 2.0, (low * low + low * high + high * high) / 3.0
    own, gain = covariance, abs(document["scale"])
    t = "normal" if freedom is None else "Student's t"
    read = "Scatter of a reading about the calibration"
    if (joint := document.get("joint_covariance")) is not None:
        noise = Contribution(
            "r", read, "A", t, freedom, joint["scatter_deg"], "°", 1.0 / abs(joint["slope"]), "°/°"
        )
        curve_deg = math.sqrt(max(type_a_deg**2 - noise.contribution_deg**2, 0.0))
        title = "Bias, scale and effects, from the fit"
        curve = Contribution("c", title, "A", t, freedom, curve_deg, "°", -1.0, "°/°")
        return [(line, line.contribution_deg**2) for line in (noise, curve)]
    of_line = own[0][0] + 2.0 * mean_deg * own[0][1] + square_deg2 * own[1][1]
    scatter_deg = math.sqrt(max((type_a_deg * gain) ** 2 - of_line, 0.0))
    of_scale_deg = -math.sqrt(square_deg2) / gain
    lines = [
        Contribution("r", read, "A", t, freedom, scatter_deg, "°", 1 / gain, "°/°"),
        Contribution("b", "Bias, from the fit", "A", t, freedom, own[0][0] ** 0.5, "°", -1 / gain, "°/°"),
        Contribution("m", "Scale, from the fit", "A", t, freedom, own[1][1] ** 0.5, "", of_scale_deg, "°"),
    ]
    parts = [(line, line.contribution_deg**2) for line in lines]
    shared = 2.0 * mean_deg * own[0][1] / gain**2
    if shared:
        title = "Correlation of bias and scale"
        parts.append((Contribution("b, m", title, "A", t, freedom, 0.0, "", 0.0, ""), shared))
    return parts


def _of_reference(document: Mapping[str, Any], reference: Reference | None) -> list[_Part]:
    """Type B: what the stage's own angle is worth to a calibrated elevation."""
    of_stage_deg = document["uncertainty"]["reference_deg"]
    if of_stage_deg is None:
        return []
    if reference is None:
        solved = "elevation_std_deg" in document
        title = "Stage, mounts and sensor, from their joint solution" if solved else "Stage, by its map"
        line = Contribution("θ", title, "B", "normal", math.inf, of_stage_deg, "°", 1.0, "°/°")
    else:
        line = Contribution(
            "θ",
            f"Angle of the stage: {KINDS[reference.kind]}",
            "B",
            reference.combined_distribution,
            math.inf,
            reference.std_deg,
            "°",
            of_stage_deg / reference.std_deg,
            "°/°",
        )
    return [(line, line.contribution_deg**2)]


def _effective_freedom(
    type_a_deg: float | None, combined_deg: float | None, freedom: int | None
) -> float | None:
    """ν_eff = u⁴/Σ(uᵢ⁴/νᵢ) (G.4.1), of one contribution with finite ν: all of type A is one scatter's."""
    if type_a_deg is None or combined_deg is None or freedom is None or freedom < 1:
        return None
    return math.inf if type_a_deg == 0.0 else freedom * (combined_deg / type_a_deg) ** 4


def _method(
    document: Mapping[str, Any], reference: Reference | None, effective: float | None
) -> Iterator[str]:
    if document["expanded_uncertainty_deg"] is None:
        why = "the poses are too few to tell their scatter"
        if document["uncertainty"]["type_b_deg"] is None:
            why = "what the angle of the stage is worth was not stated"
        yield f"The expanded uncertainty is not stated: {why}."
        return
    yield (
        "Contributions combine by the law of propagation (JCGM 100:2008, 5.1.2 and 5.2.2) to one figure for "
        "the range, the mean of u² over it (F.2.4.5). Everything of type A comes from one scatter."
    )
    probability = f"{100 * document['coverage']:g} %"
    nu = "not stated"
    if effective is not None:
        nu = "infinite" if math.isinf(effective) else str(math.floor(effective))
    by_t = None
    if effective is not None:
        by_t = coverage_factor(1.0, min(effective, _INFINITE), 0.0, "normal", document["coverage"])
    if reference is None or reference.kind == "setting" or reference.distribution == "normal":
        if by_t is None or math.isclose(document["coverage_factor"], by_t, rel_tol=_SAME_FACTOR):
            yield (  # documents of earlier programs
                f"k for {probability} is that of Student's t for the effective degrees of freedom by Welch "
                f"and Satterthwaite (G.4), {nu}."
            )
            return
        yield (
            f"k for {probability} is that of the sum of Student's t (type A) and a normal distribution "
            "(type B), convolved (JCGM 101:2008)."
        )
        yield _by_welch(nu, by_t)
        return
    yield (
        f"k for {probability} is that of the sum of Student's t (type A) and a rectangular distribution "
        "(type B), convolved (JCGM 101:2008). A rectangular contribution exceeds its limits nowhere, and "
        "Student's t would overstate it (JCGM 100:2008, G.1.3)."
    )
    if by_t is not None:
        yield _by_welch(nu, by_t)


def _by_welch(nu: str, factor: float) -> str:
    return (
        f"The effective degrees of freedom by Welch and Satterthwaite (G.4) are {nu}; Student's t of as many "
        f"would give k = {factor:.2f}."
    )


def _not_contained(document: Mapping[str, Any]) -> Iterator[str]:
    low, high = (f"{end:g}°".replace("-", "−") for end in document["range_deg"])
    if not document["level_known"]:
        yield (
            f"Level: not known. The calibrated elevation is relative to its mean over {low} to {high}; how "
            "the unit was clamped shifts all of it by one angle, which is not contained."
        )
    elif document["level_std_deg"] is not None:
        yield f"Level: known to a standard uncertainty of {by_itself(document['level_std_deg'])}°."
    if document["temperature_c"] is None:
        yield "Temperature: not measured, and contained only as far as the poses scatter by it."
    else:
        yield "Temperature: contained as far as it varied between the poses, and not beyond that range."
    yield "Resolution of the reading: contained in its scatter."
    yield "Drift after the calibration, shock, and mounting by the user: not contained."
