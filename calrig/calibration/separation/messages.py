"""Messages of a joint solution: what is not separable or identified, and which mounts would help.

By how much these would help comes from the bound, never from a rule.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.regression.terms import covered
from calrig.calibration.separation.gyro import WholeGyro
from calrig.calibration.separation.lack_of_fit import misfits
from calrig.calibration.separation.least_squares import Fit, fitted
from calrig.calibration.separation.map_report import Mapped, common_variance
from calrig.calibration.separation.solution import HARDLY_NOISE, Solution
from calrig.calibration.separation.stage_map import (
    SAME_DIAL_DEG,
    TURN_DEG,
    WIDEST_GAP_DEG,
    goes_round,
)
from calrig.calibration.separation.unit_results import (
    axes_of,
    mounted_otherwise,
    seats_std_rad,
    unidentified,
)
from calrig.estimation.angles import AXES, FloatArray, robust_std, wrap_deg
from calrig.model.solution import Frame, MountAdvice

SHARE = 0.3
"""Of the largest part of a direction: what has less is not named."""
APART_DEG, APART_NOISES = 0.05, 3.0
"""From where a reading is said not to be the accelerometer's angle."""
LOUD_DEG = 0.3
"""Noise of a dwell of a second is a tenth of that or less in any part on sale."""
CONTRADICTS = 1e-3
"""Chance of quadratic and cubic terms as large in units that have none."""
LEAST_IDENTIFIED = 0.5
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
CLOCK_ERRORS = 3.0
"""Standard errors from which a clock is said to be off."""


def messages_of(
    solution: Solution, on_stage: Mapped, gyros: Sequence[WholeGyro | None], frame: Frame
) -> list[str]:
    """Return the messages on a solution, the most important first."""
    units = range(len(solution.table.units))
    if solution.table.is_whole:
        found = _of_linear(solution)
        for unit, gyro in zip(units, gyros, strict=True):
            found += [*_of_accelerometer(solution, unit, frame), *_of_gyro(solution.table.units[unit], gyro)]
        found += [*_of_regions(solution), *_of_gaps(on_stage)]
        return [*found, *_of_mounts(solution, on_stage), *_of_dial(solution), *_of_unidentifiable(solution)]
    found = [_not_separable(solution, unit) for unit in units if not solution.is_separable(unit)]
    if solution.noise_deg > LOUD_DEG:
        found.append(
            f"the poses lie {solution.noise_deg:.2g}° from the model, as no unit at rest does: are they of "
            "one stage, each of the unit that is named, and were its mounts not touched?"
        )
    if solution.fit.problem.correlation > HARDLY_NOISE:
        found.append(
            f"what the poses leave is correlated by {solution.fit.problem.correlation:.2f} from one to "
            "the next: more as a lack of fit than as noise"
        )
    found += [*_of_misfits(solution), *_of_regions(solution), *_of_gear(solution), *_of_levels(solution)]
    found += [*_of_linear(solution), *_of_mounts(solution, on_stage), *_of_sources(solution)]
    found += [*_of_dial(solution), *_of_gaps(on_stage), *_of_angles(solution, on_stage)]
    found += _of_unidentifiable(solution)
    return [*found, *_of_columns(solution), *_of_readings(solution)]


def _not_separable(solution: Solution, unit: int) -> str:
    known, problem = solution.uncertainties[unit], solution.fit.problem
    of_map = np.arange(problem.first_order, problem.size)
    at = np.concatenate([problem.blocks[unit], of_map[problem.free[of_map]]])
    widths = problem.widths()[at]
    scaled = known.by_parameters[:, at] * widths
    size, turn = np.linalg.eigh(solution.fit.covariance_at(at) / np.outer(widths, widths))
    direction = turn[:, int(np.argmax(size * ((scaled @ turn) ** 2).sum(axis=0)))]
    weights = np.abs(direction)
    named = [problem.title(int(at[k])) for k in np.argsort(-weights) if weights[k] > SHARE * weights.max()]
    return (
        f"unit {solution.table.units[unit]}: its elevation is known to {known.rms_deg:.2g}° only, where one "
        f"pose is measured to {solution.noise_deg:.2g}°: these poses do not separate "
        f"{', '.join(dict.fromkeys(named))}"
    )


def _of_accelerometer(solution: Solution, unit: int, frame: Frame) -> list[str]:
    """Report which parameters of a unit the poses do not identify, and how well its seats repeat."""
    fit, serial, axes = solution.fit, solution.table.units[unit], axes_of(solution.fit, unit)
    missing = [axis for axis in AXES if axis not in axes]
    if names := unidentified(fit, unit):
        identified, asked = fit.identified()
        remedy = (
            f": clamp it with its {' and its '.join(missing)} along the stage's axis too" if missing else ""
        )
        return [
            f"unit {serial}: these poses do not tell {', '.join(names)} ({identified} of {asked} parameters "
            f"are told, by singular values), so there is no matrix of it{remedy}"
        ]
    if frame == "faces" and len(axes) == len(AXES):
        seat_deg = float(np.degrees(seats_std_rad(fit, unit)))
        return [
            f"unit {serial}: the faces were off by {seat_deg:.2g}° from being square, root mean square: the "
            "frame of the matrix is as good as that, its other six numbers are better"
        ]
    return []


def _of_gyro(serial: str, gyro: WholeGyro | None) -> list[str]:
    if gyro is None:
        return []
    found = []
    if gyro.turns is None:
        found.append(
            f"unit {serial}: no gyro matrix: it needs gyro_move_x_deg, gyro_move_y_deg and gyro_move_z_deg "
            "of moves in mounts with x, y and z along the stage's axis"
        )
    else:
        if not gyro.turns.closed:
            found.append(
                f"unit {serial}: no full turns: the gyro's scale rests on the stage's map; turns of 360° "
                "between dwells do not"
            )
        if gyro.turns.one_way:
            found.append(
                f"unit {serial}: turned one way only: Earth's rate and gravity's influence stay in the "
                "gyro's matrix and its uncertainty; turn both ways"
            )
    if gyro.clock is not None and abs(gyro.clock.error) > CLOCK_ERRORS * gyro.clock.std:
        way = "fast" if gyro.clock.error > 0.0 else "slow"
        found.append(
            f"unit {serial}: the board's clock is {way} by {1e6 * abs(gyro.clock.error):.0f} ppm ± "
            f"{1e6 * gyro.clock.std:.0f} ppm of the host's; the gyro's matrix is for the board's seconds"
        )
    if gyro.dwells is not None and not gyro.dwells.is_identified:
        found.append(f"unit {serial}: these attitudes do not tell what gravity does to the gyro")
    return found


def _of_misfits(solution: Solution) -> list[str]:
    """Report mounts that the others do not predict as well as noise allows."""
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
        + _allowed(solution)
    ]


def _allowed(solution: Solution) -> str:
    """State what the standard errors allow for between mounts; the unit's offsets are its first mount's."""
    spread = solution.fit.problem.spread
    parts = [
        f"{size:.2g} {what}"
        for size, what in (
            (1e3 * spread.offset_g, "mg in the offsets of a mount (the unit's are those of its first mount)"),
            (1e3 * spread.askew, "mrad in its gains and skew, as of a seat askew"),
            (float(np.degrees(spread.map_rad)), "° in each coefficient of its map"),
        )
        if size > 0.0
    ]
    return (
        f"the standard errors allow for {', '.join(parts)}" if parts else "no standard error allows for that"
    )


def _of_gear(solution: Solution) -> list[str]:
    gear = solution.gear
    if gear is None:
        return []
    return [
        f"what the poses leave repeats every {gear.period_deg:.2g}° of the dial, by {gear.amplitude_deg:.2g}°"
        f" (by noise alone in {gear.p_value:.1g} of cases): if that is a gear, state its period (--period); "
        "until then the map's standard errors hold its amplitude"
    ]


def _of_regions(solution: Solution) -> list[str]:
    """Report parts of the dial where neighbouring poses are off together."""
    return [
        f"poses from {region.from_deg:.4g}° to {region.to_deg:.4g}° of the dial are off together, by up to "
        f"{region.std_deg:.2g}°: check the stage there for a damaged tooth; they were left out, and "
        "the map's standard error there is as large"
        for region in solution.regions
    ]


def _of_gaps(on_stage: Mapped) -> list[str]:
    """Report that the map is null between visited angles."""
    if not on_stage.gaps_deg:
        return []
    return [
        f"the map is not determined between visited angles that are more than {WIDEST_GAP_DEG:g}° apart "
        f"({len(on_stage.gaps_deg)} gaps), and null there: take poses at more angles (jitter)"
    ]


def _of_levels(solution: Solution) -> list[str]:
    """Report a level whose uncertainty is unknown, and clampings that contradict the stated repeatability."""
    found = []
    for serial, level in zip(solution.table.units, solution.levels, strict=True):
        if level is not None and not level.is_known:
            found.append(
                f"unit {serial} was reversed, which has its level at {level.value_deg:+.3f}°, but nothing "
                "says how well face and seat repeat: state it (--seat-std), or remount it both ways round; "
                "until then its level is not known"
            )
        elif level is not None and level.contradicted:
            found.append(
                f"unit {serial}: its clampings scatter more widely than {level.seat_std_deg:g}° as stated of "
                "face and seat: the level is known less well than is said"
            )
    return found


def _of_linear(solution: Solution) -> list[str]:
    """Report that the data contradict linear units."""
    fit, n_units = solution.fit, len(solution.table.units)
    if not fit.problem.linear:
        return []
    bent = fitted(replace(fit.problem, linear=False), fit.weights, fit.parameters)
    who = "units are" if n_units > 1 else "unit is"
    return [f"the {who} stated to be linear, and these poses contradict that"] if is_better(bent, fit) else []


def is_better(bent: Fit, straight: Fit) -> bool:
    """Whether quadratic and cubic terms explain more than noise would: an F test of all of them."""
    from scipy.special import chdtrc

    identified = straight.freedom - bent.freedom
    gain = (straight.freedom * straight.noise**2 - bent.freedom * bent.noise**2) / bent.noise**2
    return bool(identified >= LEAST_IDENTIFIED and chdtrc(identified, max(gain, 0.0)) <= CONTRADICTS)


def _of_mounts(solution: Solution, on_stage: Mapped) -> list[str]:
    """Report mounts that are not at the stated angle; for units in the plane the default is 0°."""
    found, is_whole = [], solution.table.is_whole
    for mount, found_deg in zip(solution.table.mounts, on_stage.mounts_deg, strict=True):
        if is_whole and mount.nominal_deg is None:
            continue
        angle_deg = mount.on_its_turn(float(found_deg))
        if abs(wrap_deg(angle_deg - (mount.nominal_deg or 0.0))) > OFF_DEG:
            stated = (
                "no mount_deg was given"
                if mount.nominal_deg is None
                else f"mount_deg is {mount.nominal_deg:g}"
            )
            about = f" about {mount.axis}" if is_whole else ""
            unit = solution.table.units[mount.unit]
            found.append(f"mount {mount.name} of unit {unit}: {stated}, gravity says {angle_deg:.1f}°{about}")
    return found


def _of_sources(solution: Solution) -> list[str]:
    """Report files that share a mount by name but differ in its angle by more than noise."""
    fit, table, found = solution.fit, solution.table, []
    angles = fit.left()
    rho = min(fit.problem.correlation, MOST_BELIEVED)
    for k, mount in enumerate(table.mounts):
        of_mount = (table.mount == k) & fit.kept
        own, sources = angles[of_mount], table.source[of_mount]
        means = {int(s): float(own[sources == s].mean()) for s in np.unique(sources)}
        for source, mean in means.items():
            error = fit.noise * np.sqrt((1.0 + rho) / (1.0 - rho) / (sources == source).sum())
            if len(means) > 1 and abs(mean) > MOVED * error:
                found.append(
                    f"mount {mount.name} of unit {table.units[mount.unit]}: in {table.sources[source]} it "
                    f"stands {np.degrees(mean):+.3f}° from where all its poses have it: was it remounted?"
                )
    return found


def _of_dial(solution: Solution) -> list[str]:
    dial = solution.table.dial_deg[solution.fit.kept]
    if goes_round(dial):
        return []
    arc = covered(dial)
    return [
        f"the poses stand on {arc:.0f}° of the dial: the map is known there and nowhere else, and its "
        "orders are a way to write it down, not the axis' own"
    ]


def _of_angles(solution: Solution, on_stage: Mapped) -> list[str]:
    """Report poses at too few dial angles, or with a common misfit there."""
    dial, found = solution.table.dial_deg[solution.fit.kept], []
    n_angles = len(np.unique(np.round(dial / NEAR_DEG)))
    if n_angles <= 2 * len(on_stage.harmonics) + 1:
        found.append(
            f"the poses stand at {n_angles} angles of the dial, as few as the map has terms: what the stage "
            "has beyond these orders they do not show; take poses at more angles (jitter)"
        )
    common_deg = float(np.degrees(np.sqrt(common_variance(solution.fit))))
    if common_deg > 0.0:
        found.append(
            f"poses at one angle of the dial have {common_deg:.2g}° in common that the map's orders do not "
            "explain: the map's standard errors hold that much at each angle"
        )
    return found


def _of_unidentifiable(solution: Solution) -> list[str]:
    """Report orders of the map that the poses cannot distinguish from its others."""
    if not solution.choice.unidentifiable:
        return []
    orders = ", ".join(f"{order:g}" for order in solution.choice.unidentifiable)
    return [f"these angles do not tell orders {orders} of the map from its others: they were left out"]


def _of_columns(solution: Solution) -> list[str]:
    table, found = solution.table, []
    for k, mount in enumerate(table.mounts):
        if not table.has_vector[table.mount == k].any():
            found.append(
                f"mount {mount.name} lacks accel_y_g or accel_z_g: its readings alone count, |a| says nothing"
            )
    if not solution.fit.problem.free[-1]:
        found.append(
            "the poses were not approached from both sides, or no column tells: play is not solved for"
        )
    return found


def _of_readings(solution: Solution) -> list[str]:
    table = solution.table
    if not table.has_vector.any():
        return []
    apart = wrap_deg(np.degrees(table.sense * (table.reading - table.turn())))[
        table.has_vector & solution.fit.kept
    ]
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
"""Factor by which the elevation must be known better for a remounting to be advised."""
WIDER = 1.1
AS_GOOD = 1.1
"""A plan is as good as another within this; the one of fewer mounts, or named first, is then advised."""


def advised(solution: Solution, limits_deg: tuple[float, float] | None = None) -> MountAdvice | None:
    """The plan of mounts for the unit that is known least; None where none would help, or of whole units.

    Without `limits_deg` of the dial no angle is advised beyond those of the poses.
    """
    if solution.table.is_whole:
        return None
    unit = int(np.argmax([known.rms_deg for known in solution.uncertainties]))
    now_deg = solution.uncertainties[unit].rms_deg
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
    return MountAdvice(
        mounts_deg=list(plan),
        elevation_std_deg_now=now_deg,
        elevation_std_deg_then=then_deg,
        says=f"unit {table.units[unit]} clamped at {angles}, each with {len(rows)} poses from "
        f"{dial.min():.4g}° to {dial.max():.4g}° of the dial: the elevation would be known to "
        f"{then_deg:.2g}° in place of {now_deg:.2g}°",
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
