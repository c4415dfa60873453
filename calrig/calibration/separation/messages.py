"""What a person should know of a joint solution: what is not separable, and why.

Which mounts would help, and by how much: from the bound, never from a rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.separation.lack_of_fit import misfits
from calrig.calibration.separation.least_squares import fitted, unstated_gear
from calrig.calibration.separation.level import mounted_otherwise
from calrig.calibration.separation.map_report import Mapped, common_variance
from calrig.calibration.separation.order_choice import Choice
from calrig.calibration.separation.problem import Problem
from calrig.calibration.separation.solution import Solution
from calrig.calibration.separation.stage_map import (
    SAME_DIAL_DEG,
    TURN_DEG,
    Linearised,
    goes_round,
    widest_gap_deg,
)
from calrig.calibration.separation.unit_model import NAMES
from calrig.estimation.angles import FloatArray, robust_std, wrap_deg

SHARE = 0.3
"""Of the largest part of a direction: what has less is not named."""
APART_DEG, APART_NOISES = 0.05, 3.0
"""From where a reading is said not to be the accelerometer's angle."""
LOUD_DEG = 0.3
"""Noise of a dwell of a second is a tenth of that or less in any part on sale."""
HARDLY_NOISE = 0.85
"""Correlation from pose to pose, seconds apart, beyond which something moved."""
CONTRADICTS = 1e-3
"""Chance of quadratic and cubic terms as large in units that have none."""
LEAST_TOLD = 0.5
"""Of those terms, that the poses must tell for a test of them."""
NEAR_DEG = 0.25
"""Poses nearer to one another than this stand at one angle of the dial."""
OFF_DEG = 5.0
"""From where a mount was said to be to where gravity has it; a plan is held to the same."""
CAUSES = {
    "map": "the stage had another map there",
    "time": "its angle moved while it was measured, as in a clamp that gives",
    "unit": "it were of another unit, or the unit had changed",
}
MOVED = 5.0
"""Standard errors of a mean."""
MOST_BELIEVED = 0.6
"""Of a correlation between poses, beside a step: the step itself looks like more."""
TITLES = {
    "common_gain": "common gain",
    "gain": "gain",
    "skew": "skew",
    "y": "y offset",
    "z": "z offset",
    "y2": "quadratic term of y",
    "y3": "cubic term of y",
    "z2": "quadratic term of z",
    "z3": "cubic term of z",
    "y_per_c": "y offset's temperature",
    "z_per_c": "z offset's temperature",
}


def sentences(solution: Solution, on_stage: Mapped) -> list[str]:
    """All that is to be said, the weightiest first."""
    units = range(len(solution.table.units))
    said = [_not_separable(solution, unit) for unit in units if not solution.is_separable(unit)]
    if solution.noise_deg > LOUD_DEG:
        said.append(
            f"the poses lie {solution.noise_deg:.2g}° from the model, as no unit at rest does: are they of "
            "one stage, each of the unit that is named, and were its mounts not touched?"
        )
    if solution.fit.problem.correlation > HARDLY_NOISE:
        said.append(
            f"what the poses leave is correlated by {solution.fit.problem.correlation:.2f} from one to "
            "the next: more as a lack of fit than as noise"
        )
    said += [*_of_misfits(solution), *_of_gear(solution), *_of_levels(solution)]
    said += [*_of_linear(solution), *_of_mounts(solution, on_stage), *_of_sources(solution)]
    return [*said, *_of_dial(solution, on_stage), *_of_columns(solution), *_of_readings(solution)]


def _not_separable(solution: Solution, unit: int) -> str:
    worth, problem = solution.worths[unit], solution.fit.problem
    at = np.concatenate([problem.blocks[unit], problem.border])
    widths = problem.widths()[at]
    scaled = worth.by_parameters[:, at] * widths
    size, turn = np.linalg.eigh(solution.fit.covariance_at(at) / np.outer(widths, widths))
    direction = turn[:, int(np.argmax(size * ((scaled @ turn) ** 2).sum(axis=0)))]
    weights = np.abs(direction)
    named = [_title(problem, int(at[k])) for k in np.argsort(-weights) if weights[k] > SHARE * weights.max()]
    return (
        f"unit {solution.table.units[unit]}: its elevation is known to {worth.rms_deg:.2g}° only, where one "
        f"pose is measured to {solution.noise_deg:.2g}°: these poses do not separate "
        f"{', '.join(dict.fromkeys(named))}"
    )


def _of_misfits(solution: Solution) -> list[str]:
    """Mounts that the others do not predict as well as noise allows."""
    found = misfits(solution.mount_tests)
    if not found:
        return []
    table = solution.table
    mounts = [table.mounts[test.mount] for test in found]
    named = " or ".join(f"mount {mount.name} of unit {table.units[mount.unit]}" for mount in mounts)
    causes = " or ".join(dict.fromkeys(CAUSES[test.cause] for test in found))
    p_value = min(test.p_value for test in found)
    return [
        f"{named} does not fit the others (by noise alone in {p_value:.1g} of cases), most as if {causes}: "
        "no standard error here allows for that"
    ]


def _of_gear(solution: Solution) -> list[str]:
    gear = unstated_gear(solution.fit)
    if gear is None:
        return []
    return [
        f"what the poses leave repeats every {gear.period_deg:.2g}° of the dial, by {gear.amplitude_deg:.2g}°"
        f" (by noise alone in {gear.p_value:.1g} of cases): if that is a gear, state its period (--period)"
    ]


def _of_levels(solution: Solution) -> list[str]:
    """What is missing of the level of a unit that was reversed, and what the clampings contradict."""
    said = []
    for serial, level in zip(solution.table.units, solution.levels, strict=True):
        if level is not None and not level.is_known:
            said.append(
                f"unit {serial} was reversed, which has its level at {level.value_deg:+.3f}°, but nothing "
                "says how well face and seat repeat: state it (--seat-std), or clamp it anew both ways; "
                "until then its level is not known"
            )
        elif level is not None and level.contradicted:
            said.append(
                f"unit {serial}: its clampings scatter more widely than {level.seat_std_deg:g}° as stated of "
                "face and seat: the level is known less well than is said"
            )
    return said


def _title(problem: Problem, place: int) -> str:
    if place < problem.first_mount:
        return TITLES[NAMES[place % len(NAMES)]]
    if place < problem.first_order:
        return f"mount {problem.table.mounts[place - problem.first_mount].name}"
    return problem.title_on_map(place)


def _of_linear(solution: Solution) -> list[str]:
    """Whether the data contradict that the units are linear."""
    fit, n_units = solution.fit, len(solution.table.units)
    if not fit.problem.linear:
        return []
    bent = fitted(replace(fit.problem, linear=False), fit.weights, fit.parameters)
    who = "units are" if n_units > 1 else "unit is"
    return [f"the {who} stated to be linear, and these poses contradict that"] if is_better(bent, fit) else []


def is_better(bent: Linearised, straight: Linearised) -> bool:
    """Whether quadratic and cubic terms explain more than noise would: an F test of all of them."""
    from scipy.special import chdtrc

    told = straight.freedom - bent.freedom
    gain = (straight.freedom * straight.noise**2 - bent.freedom * bent.noise**2) / bent.noise**2
    return bool(told >= LEAST_TOLD and chdtrc(told, max(gain, 0.0)) <= CONTRADICTS)


def _of_mounts(solution: Solution, on_stage: Mapped) -> list[str]:
    """Mounts that stand elsewhere than somebody said."""
    said = []
    for mount, found_deg in zip(solution.table.mounts, on_stage.mounts_deg, strict=True):
        angle_deg = mount.on_its_turn(mount.sense * float(found_deg))
        if abs(wrap_deg(angle_deg - (mount.nominal_deg or 0.0))) > OFF_DEG:
            stated = (
                "no mount_deg was given"
                if mount.nominal_deg is None
                else f"mount_deg is {mount.nominal_deg:g}"
            )
            unit = solution.table.units[mount.unit]
            said.append(f"mount {mount.name} of unit {unit}: {stated}, gravity says {angle_deg:.1f}°")
    return said


def _of_sources(solution: Solution) -> list[str]:
    """Files that share a mount by name, and not to within the noise by angle."""
    fit, table, said = solution.fit, solution.table, []
    angles = fit.left()
    rho = min(fit.problem.correlation, MOST_BELIEVED)
    for k, mount in enumerate(table.mounts):
        of_mount = (table.mount == k) & fit.kept
        own, sources = angles[of_mount], table.source[of_mount]
        means = {int(s): float(own[sources == s].mean()) for s in np.unique(sources)}
        for source, mean in means.items():
            error = fit.noise * np.sqrt((1.0 + rho) / (1.0 - rho) / (sources == source).sum())
            if len(means) > 1 and abs(mean) > MOVED * error:
                said.append(
                    f"mount {mount.name} of unit {table.units[mount.unit]}: in {table.sources[source]} it "
                    f"stands {np.degrees(mean):+.3f}° from where all its poses have it: was it clamped anew?"
                )
    return said


def _of_dial(solution: Solution, on_stage: Mapped) -> list[str]:
    dial = solution.table.dial_deg[solution.fit.kept]
    said = []
    if not goes_round(dial):
        arc = TURN_DEG - widest_gap_deg(dial)
        said.append(
            f"the poses stand on {arc:.0f}° of the dial: the map is known there and nowhere else, and its "
            "orders are a way to write it down, not the axis' own"
        )
    n_angles = len(np.unique(np.round(dial / NEAR_DEG)))
    if n_angles <= 2 * len(on_stage.harmonics) + 1:
        said.append(
            f"the poses stand at {n_angles} angles of the dial, as few as the map has terms: what the stage "
            "has beyond these orders they do not show; take poses at more angles (jitter)"
        )
    common_deg = float(np.degrees(np.sqrt(common_variance(solution.fit))))
    if common_deg > 0.0:
        said.append(
            f"poses at one angle of the dial have {common_deg:.2g}° in common that the map's orders do not "
            "explain: the map's standard errors hold that much at each angle"
        )
    return [*said, *of_untold_orders(solution.choice)]


def of_untold_orders(choice: Choice) -> list[str]:
    """Orders of the map that the poses cannot tell from its others."""
    if not choice.untold:
        return []
    orders = ", ".join(f"{order:g}" for order in choice.untold)
    return [f"these angles do not tell orders {orders} of the map from its others: they were left out"]


def _of_columns(solution: Solution) -> list[str]:
    table, said = solution.table, []
    for k, mount in enumerate(table.mounts):
        if not table.has_vector[table.mount == k].any():
            said.append(
                f"mount {mount.name} lacks accel_y_g or accel_z_g: its readings alone count, |a| says nothing"
            )
    if not solution.fit.problem.free[-1]:
        said.append(
            "the poses were not approached from both sides, or no column tells: play is not solved for"
        )
    return said


def _of_readings(solution: Solution) -> list[str]:
    table = solution.table
    if not table.has_vector.any():
        return []
    apart = wrap_deg(np.degrees(table.reading - table.angle()))[table.has_vector & solution.fit.kept]
    spread_deg = robust_std(apart)
    if spread_deg < max(APART_DEG, APART_NOISES * solution.noise_deg):
        return []
    return [
        f"readings and the accelerometer's angles differ by {spread_deg:.2g}° from pose to pose: what was "
        "solved for is the accelerometer"
    ]


SEVENTH_DEG = 360.0 / 7.0
PLANS_DEG = (
    (0.0, 90.0),
    (0.0, 120.0, 240.0),
    (0.0, 90.0, 225.0),
    (0.0, SEVENTH_DEG, 3.0 * SEVENTH_DEG),
)
"""From the fewest mounts on: 0/90° parts all orders but 4, 8, …; 0/120/240° all but 3, 6, …; 0/90/225° all
but 8, 16, …; sevenths all but 7, 14, ….
"""
WORTH_IT = 1.5
"""By how much the elevation must be known better for a unit to be clamped anew."""
WIDER = 1.1
AS_GOOD = 1.1
"""A plan is as good as another within this; the one of fewer mounts, or named first, is then advised."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Mounts that would help, and the elevation's standard error now and then, degrees."""

    mounts_deg: tuple[float, ...]
    now_deg: float
    then_deg: float
    says: str


def advised(solution: Solution, limits_deg: tuple[float, float] | None = None) -> Advice | None:
    """The plan of mounts to take the unit to that is known least; None where none would help.

    Args:
        solution: of what was taken so far.
        limits_deg: of the dial; without them no angle is advised beyond those of the poses.
    """
    unit = int(np.argmax([worth.rms_deg for worth in solution.worths]))
    now_deg = solution.worths[unit].rms_deg
    table = solution.table
    own = np.flatnonzero((table.unit == unit) & solution.fit.kept)
    rows = own[table.mount[own] == np.bincount(table.mount[own]).argmax()]
    dials = [table.dial_deg[rows], *_over(table.dial_deg[rows], limits_deg)]
    then = [
        (mounted_otherwise(solution.fit, unit, rows, plan, dial).rms_deg, plan, dial)
        for plan in PLANS_DEG
        for dial in dials
    ]
    least = min(std for std, _, _ in then)
    then_deg, plan, dial = next(one for one in then if one[0] <= AS_GOOD * least)
    if now_deg < WORTH_IT * then_deg:
        return None
    angles = ", ".join(f"{angle:.4g}°" for angle in plan)
    return Advice(
        plan,
        now_deg,
        then_deg,
        f"unit {table.units[unit]} clamped at {angles}, each with {len(rows)} poses from {dial.min():.4g}° "
        f"to {dial.max():.4g}° of the dial: the elevation would be known to {then_deg:.2g}° in place of "
        f"{now_deg:.2g}°",
    )


def _over(dial_deg: FloatArray, limits_deg: tuple[float, float] | None) -> list[FloatArray]:
    """The dial angles spread over what the stage is allowed, where that is wider; a turn at most."""
    if limits_deg is None:
        return []
    low, high = limits_deg
    if high - low > TURN_DEG:
        low, high = 0.5 * (low + high - TURN_DEG), 0.5 * (low + high + TURN_DEG)
    if high - low < WIDER * np.ptp(dial_deg):
        return []
    return [low + (dial_deg - dial_deg.min()) * (high - low) / max(float(np.ptp(dial_deg)), SAME_DIAL_DEG)]
