"""What a calibration document says of the axes of accelerometer and gyro, as other programs take it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calrig.calibration.regression import MG
from calrig.calibration.results import effects_at_rest, effects_on_reading_deg, felt_elevation_deg
from calrig.estimation.angles import FloatArray

LONGEST_LINE = 160
HELD = frozenset({"accelerometer_offset", "axis_mismatch", "temperature_offset"})
"""Effects that an offset, a scale or a matrix holds."""
CURVES = frozenset({"axis_nonlinearity", "nonlinearity"})
"""Effects whose best straight line these hold; any other stays out of such a format, and it is said."""
STEEPEST_DEG = 80.0
"""Beyond it an angle says next to nothing of y; as in the effect `nonlinearity`."""
GRID = 721


class NotHeldError(ValueError):
    """A format cannot hold what the document says without saying something else; the message is why."""


@dataclass(frozen=True, slots=True, eq=False)
class Accelerometer:
    """true = matrix·(raw − bias − per_c·(T − reference_c)), in g along the sensor's own axes.

    Attributes:
        bias_g: (3,), NaN for an axis that nothing is known of.
        matrix: (3, 3); the identity's row and column for such an axis.
        per_c_g: (3,) what the bias follows the temperature by, g/°C; 0 where it does not.
        reference_c: None where no axis follows it.
        is_whole: all nine numbers of the matrix are measured.
        left_out: effects of the document that are not in these, and bias and scale where there are any.
        curve_left_mg: (3,) RMS of what the best straight line leaves of the axes' curves; 0 without any.
        curve_left_deg: RMS error of an elevation about x from that, over the calibrated range.
        expanded_deg, coverage_factor: the document's uncertainty of an elevation; None where it is unknown.
    """

    bias_g: FloatArray
    matrix: FloatArray
    per_c_g: FloatArray
    reference_c: float | None
    is_whole: bool
    left_out: tuple[str, ...]
    curve_left_mg: FloatArray = field(default_factory=lambda: np.zeros(3))
    curve_left_deg: float = 0.0
    expanded_deg: float | None = None
    coverage_factor: float | None = None

    @property
    def uncertainty_says(self) -> list[str]:
        """How uncertain an elevation from these numbers is, what the straight lines leave included."""
        left = ""
        if self.curve_left_mg.any():
            left = f"; what straight lines leave of curves is {self.curve_left_deg:.2g} degrees RMS of it"
        if self.expanded_deg is None or self.coverage_factor is None:
            return [*self._curve_says, f"uncertainty of an elevation: not known{left}"]
        u_deg = math.hypot(self.expanded_deg / self.coverage_factor, self.curve_left_deg)
        return [
            *self._curve_says,
            f"elevation about x, without what is left out: U = {self.coverage_factor * u_deg:.2g} degrees "
            f"(k = {self.coverage_factor:.3g}){left}",
        ]

    @property
    def _curve_says(self) -> list[str]:
        if not self.curve_left_mg.any():
            return []
        left = ", ".join(
            f"{axis} {mg:.2g} mg" for axis, mg in zip("xyz", self.curve_left_mg, strict=True) if mg
        )
        over = "all directions" if self.is_whole else "the calibrated elevations"
        return [f"curves of the axes: best straight line over {over}; RMS of what it leaves: {left}"]

    @property
    def known(self) -> list[int]:
        """Axes of which something is known."""
        return np.flatnonzero(~np.isnan(self.bias_g)).tolist()

    def true_g(self, raw_g: FloatArray) -> FloatArray:
        """(3,) of one raw vector at the reference temperature; an axis of which nothing is known stays."""
        return np.asarray(self.matrix @ (raw_g - np.nan_to_num(self.bias_g)))


@dataclass(frozen=True, slots=True, eq=False)
class Gyro:
    """true = matrix·(raw − bias − dps_per_g·acceleration), in deg/s; NaN and None as in `Accelerometer`.

    Attributes:
        bias_dps: (3,).
        matrix: (3, 3); what was not measured is the identity's.
        dps_per_g: (3, 3), 0 where it was not measured.
        is_whole: whether the matrix was measured.
    """

    bias_dps: FloatArray
    matrix: FloatArray
    dps_per_g: FloatArray
    is_whole: bool


def accelerometer_of(document: Mapping[str, Any]) -> Accelerometer | None:
    """Whole where the document has it; else of y and z by its effects; None where these have nothing of them.

    With the axes as in the catalogue, raw_y = gain·(a_y + a_z·sin skew) + y and raw_z = a_z + z: y and z are
    relative to the gain of z, which a planar calibration does not know.
    """
    effects, _ = effects_at_rest(document)
    values = {name: dict(parameters) for name, parameters in effects}
    warm = values.get("temperature_offset", {})
    per_c = MG * np.array([0.0, warm.get("y_mg_per_c", 0.0), warm.get("z_mg_per_c", 0.0)])
    left_out = [name for name in values if name not in HELD | CURVES]
    found = document.get("accelerometer")
    if found:
        bias, matrix = np.array(found["bias_g"], dtype=float), np.array(found["matrix"], dtype=float)
        left_out += [name for name in values if name == "nonlinearity"]
    elif values.keys() & (HELD | CURVES):
        offset, mismatch = values.get("accelerometer_offset", {}), values.get("axis_mismatch", {})
        at_rest = MG * np.array([offset.get("y_mg", 0.0), offset.get("z_mg", 0.0)])
        is_known = offset or mismatch or values.keys() & CURVES
        bias = np.array([np.nan, *(at_rest if is_known else (np.nan, np.nan))])
        gain = 1.0 + mismatch.get("gain_pct", 0.0) / 100.0
        matrix = np.eye(3)
        matrix[1, 1:] = 1.0 / gain, -np.sin(np.radians(mismatch.get("skew_deg", 0.0)))
        line = {"bias_deg": document["bias_deg"] or 0.0, "scale": (document["scale"] or 1.0) - 1.0}
        left_out += [name for name, value in line.items() if value]
    else:
        return None
    over_range = _over_range(document, values)
    along_g, curve_g = _all_directions(document, values) if found else over_range
    offset_g, slope = _best_line(along_g, curve_g)
    gains = np.diag(np.linalg.inv(matrix))
    left_g = curve_g - offset_g - slope * along_g
    along_g, curve_g = over_range
    turned = (curve_g - offset_g - slope * along_g)[:, 1:] * along_g[:, :0:-1] @ (1.0, -1.0)
    # raw = bias + gain·u + curve(u) with true = S⁻¹·u: the line adds to bias and gain of each axis
    matrix = matrix @ np.diag(gains / (gains + slope))
    return Accelerometer(
        bias + offset_g,
        matrix,
        per_c,
        warm.get("reference_c"),
        bool(found),
        tuple(left_out),
        np.sqrt((left_g**2).mean(axis=0)) / MG,
        math.degrees(math.sqrt(float(np.mean(turned**2)))),
        document.get("expanded_uncertainty_deg"),
        document.get("coverage_factor"),
    )


Curves = tuple[FloatArray, FloatArray]
"""(n, 3) accelerations u along the axes, and what the axes' curves add there, both in g."""


def _all_directions(document: Mapping[str, Any], values: Mapping[str, Mapping[str, float]]) -> Curves:
    """Return the curves of a whole accelerometer, which is calibrated uniformly over the sphere.

    Each u is then uniform between −1 g and 1 g (Archimedes).
    """
    along_g = np.linspace(-1.0, 1.0, GRID)[:, None] * np.ones(3)
    return along_g, _polynomial_g(_terms(document, values), along_g)


def _over_range(document: Mapping[str, Any], values: Mapping[str, Mapping[str, float]]) -> Curves:
    """Return the curves over the calibrated elevations about x, at which the sensor is at bias + scale·θ."""
    low_deg, high_deg = document.get("range_deg") or (-180.0, 180.0)
    theta_deg = np.linspace(low_deg, high_deg, GRID)
    felt_deg = felt_elevation_deg(theta_deg, document.get("bias_deg") or 0.0, document.get("scale"))
    s, c = np.sin(np.radians(felt_deg)), np.cos(np.radians(felt_deg))
    skew = math.sin(math.radians(values.get("axis_nonlinearity", {}).get("skew_deg", 0.0)))
    along_g = np.column_stack([np.zeros(GRID), s + skew * c, c])
    curve_g = _polynomial_g(_terms(document, values), along_g)
    if "nonlinearity" in values and not document.get("accelerometer"):
        turned_deg = effects_on_reading_deg(
            [("nonlinearity", values["nonlinearity"])], theta_deg, felt_deg=felt_deg
        )
        steep = np.cos(np.radians(np.clip(felt_deg, -STEEPEST_DEG, STEEPEST_DEG)))
        curve_g[:, 1] += np.radians(turned_deg) / steep
    return along_g, curve_g


def _terms(document: Mapping[str, Any], values: Mapping[str, Mapping[str, float]]) -> FloatArray:
    """Return (3, 3) terms of second, third and fourth order of the axes, g."""
    bent, found = values.get("axis_nonlinearity", {}), document.get("accelerometer")
    axes = MG * np.array(
        [[0.0, bent.get(f"y_mg_per_{k}", 0.0), bent.get(f"z_mg_per_{k}", 0.0)] for k in ORDERS]
    )
    return np.vstack([curvature_of(found), axes[2:]]) if found and is_curved(found) else axes


def _best_line(along_g: FloatArray, curve_g: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares line of each axis' curve: (3,) offset in g, and slope."""
    about = along_g - along_g.mean(axis=0)
    power = (about**2).sum(axis=0)
    slope = np.divide((about * curve_g).sum(axis=0), power, out=np.zeros(3), where=power > 0.0)
    return curve_g.mean(axis=0) - slope * along_g.mean(axis=0), slope


ORDERS = ("g2", "g3", "g4")


def _polynomial_g(terms: FloatArray, along_g: FloatArray) -> FloatArray:
    """Return (n, 3) what terms of second, third and fourth order (3, 3) add to the axes."""
    return np.asarray(sum(term * along_g**power for power, term in enumerate(terms, 2)), dtype=np.float64)


def curvature_of(accelerometer: Mapping[str, Any]) -> FloatArray:
    """Return (2, 3) quadratic (g/g²) and cubic (g/g³) terms of the axes."""
    terms = [accelerometer.get(name) or np.zeros(3) for name in ("quadratic_g_per_g2", "cubic_g_per_g3")]
    return np.array(terms, dtype=float)


def is_curved(accelerometer: Mapping[str, Any]) -> bool:
    """Return whether it has quadratic or cubic terms other than 0."""
    return bool(curvature_of(accelerometer).any())


def gyro_of(document: Mapping[str, Any]) -> Gyro:
    """What the document has of it; a scale alone is that about x."""
    given = document.get("gyro") or {}
    bias = np.array([np.nan if b is None else b for b in given.get("bias_dps") or [None] * 3], dtype=float)
    measured = np.array(given.get("matrix") or [[None] * 3] * 3, dtype=float)
    matrix = np.where(np.isnan(measured), np.eye(3), measured)
    if given.get("matrix") is None and given.get("scale") is not None:
        matrix[0, 0] = given["scale"]
    per_g = np.array(given.get("dps_per_g") or np.zeros((3, 3)), dtype=float)
    return Gyro(bias, matrix, np.nan_to_num(per_g), not np.isnan(measured).any())


def require_whole(document: Mapping[str, Any], format_: str) -> Accelerometer:
    """The accelerometer, all of it.

    Raises:
        NotHeldError: it is of one axis alone.
    """
    found = accelerometer_of(document)
    if found is None or not found.is_whole:
        raise NotHeldError(
            f"{format_} holds the whole accelerometer, and this calibration is of one axis: clamp the unit "
            "with its x, y and z along the stage's axis (`mount_axis`) and solve the runs together"
        )
    return found


def origin_of(document: Mapping[str, Any]) -> list[str]:
    """Which document this is, for a comment."""
    revision = "not issued" if document.get("revision") is None else f"revision {document['revision']}"
    when = document.get("calibrated_at") or "at a time not known"
    return [
        f"calrig: unit {document['unit']}, {revision}, calibrated {when}",
        f"of the document with SHA-256 {document.get('sha256')}",
    ]


def comments(lines: Sequence[str]) -> list[str]:
    """Lines of comment behind `#`, in which no text from outside breaks a line or is not ASCII."""
    printable = ("".join(c if " " <= c <= "~" else "_" for c in line)[:LONGEST_LINE] for line in lines)
    return [f"# {line}".rstrip() for line in printable]


def vector(values: FloatArray) -> str:
    """`[1.5, 0, -9.80665]`, to ten digits."""
    return f"[{', '.join(f'{value:.10g}' for value in values)}]"
