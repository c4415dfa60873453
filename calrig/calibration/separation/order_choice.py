"""How far the map's series goes: up to the highest order that a gate on the best of all orders lets in.

Orders up to those of the unit's own error are always in the map. A gate looks at what is left beside the
unit's terms, would leave those orders to the unit, and be the surer of it the less the mounts part the two:
ignorance must not shrink an uncertainty. Of the rest the best is let in if noise alone would make the best of
all as good in less than one case in twenty; a criterion for one order at a time lets in too many.

The series then has all orders up to the highest: beside clampings that part the unit from the stage they cost
its elevation nothing, and what is too small for the gate would bend it all the same.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.poses import DiagnosisError
from calrig.calibration.separation.accelerometer import OF_CUBIC, OF_LINEAR
from calrig.calibration.separation.least_squares import Fit
from calrig.calibration.separation.problem import Problem
from calrig.calibration.separation.stage_map import LARGEST_RAD, basis, resolved_orders
from calrig.estimation.angles import BoolArray, FloatArray, Intp

LEVEL = 0.05
"""Family-wise: the chance that noise alone brings any order into the map."""
DRAWS = 4000
SEED = 0
SPARE_A_TERM = 4
LEAST_SEEN_RAD = np.radians(0.03)
"""Noise of a pose, about which it is known how many terms the angles tell apart."""
FEWEST_SPARE = 4
"""Poses beside those that the parameters take up: the noise is found from them."""
IDENTIFIABLE = 1e-4
"""Share of an order's columns that the model must leave of them; what is left of less is rounding."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What the data carry.

    Attributes:
        orders: of the map.
        selected: those of them that the gate let in.
        unidentifiable: orders that these poses cannot tell from the lowest.
    """

    orders: tuple[float, ...]
    selected: tuple[float, ...]
    unidentifiable: tuple[float, ...]


def of_the_unit(linear: bool) -> int:
    """Highest order that a unit's own error of angle has."""
    return OF_LINEAR if linear else OF_CUBIC


def always(linear: bool, known: Sequence[float]) -> tuple[float, ...]:
    """Orders that the map always has: those that units have as well, and those of gears that are known."""
    return tuple(sorted({float(order) for order in range(1, of_the_unit(linear) + 1)} | set(known)))


def offered(problem: Problem) -> tuple[float, ...]:
    """Orders that the map may have beside those it always has: as many as leave the noise to be seen.

    Raises:
        DiagnosisError: the poses are fewer than the parameters need.
    """
    needed = int(problem.free.sum())
    table = problem.table
    spare = int(table.responses.sum()) - needed
    if spare < FEWEST_SPARE * (table.components.stop - table.components.start):
        raise DiagnosisError(
            f"{len(problem.table)} poses are too few for {needed} parameters of stage, mounts and units: "
            "take more of each mount"
        )
    more = [order for order in resolved_orders(table.dial_deg) if order not in problem.orders]
    dial = np.unique(table.dial_deg)
    always_told = _terms(dial, problem.orders)
    for n in range(len(more), 0, -1):
        orders = tuple(sorted({*problem.orders, *more[:n]}))
        if SPARE_A_TERM * (_terms(dial, orders) - always_told) <= spare:
            return orders
    return problem.orders


def _terms(dial_deg: FloatArray, orders: Sequence[float]) -> int:
    """How many of a map's terms differ at these angles by more than a pose is measured to."""
    columns = basis(dial_deg, np.zeros(len(dial_deg)), orders)
    size = np.linalg.svd(columns, compute_uv=False)
    return int((size * LARGEST_RAD > LEAST_SEEN_RAD).sum())


def chosen(rich: Fit, known_orders: Collection[float] = ()) -> Choice:
    """Forward selection on the normal equations of a fit that has every order in it.

    `known_orders` of gears whose periods are known are in the map whatever the gate says.
    """
    problem, beside = rich.problem, _beside_units(rich)
    own = of_the_unit(problem.linear)
    open_yet = {
        order: 2 * k + np.arange(2)
        for k, order in enumerate(problem.orders)
        if order > own and order not in known_orders
    }
    model = problem.free[problem.map_at].copy()
    for at in open_yet.values():
        model[at] = False
    unidentifiable = [
        order for order, at in open_yet.items() if not beside.identifies(at, beside.taken(model, at)[1])
    ]
    rng = np.random.default_rng(SEED)
    selected: list[float] = []
    while open_yet and (best := _best(rich, beside, model, open_yet, rng)) is not None:
        model[open_yet.pop(best)] = True
        selected.append(best)
    highest = max([own, *selected])
    orders = tuple(order for order in problem.orders if order <= highest or order in known_orders)
    return Choice(
        orders, tuple(sorted(selected)), tuple(order for order in unidentifiable if order not in orders)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _OfMap:
    """The normal equations of the map, once units and mounts have taken what they can.

    Attributes:
        gradient, matrix: (q,) and (q, q); `prior` (q,) what is known of each before the data.
        whole: (q,) the diagonal with units and mounts held fast.
    """

    gradient: FloatArray
    matrix: FloatArray
    prior: FloatArray
    whole: FloatArray

    def taken(self, model: BoolArray, at: Intp) -> tuple[FloatArray, FloatArray]:
        """Gradient (k,) and matrix (k, k) of some of the map once the model's others have taken theirs."""
        inside = self.matrix[np.ix_(model, model)] + np.diag(self.prior[model])
        across = self.matrix[np.ix_(model, at)]
        taken = np.linalg.solve(inside, np.column_stack([across, self.gradient[model]]))
        left = self.matrix[np.ix_(at, at)] - across.T @ taken[:, :-1]
        return self.gradient[at] - across.T @ taken[:, -1], 0.5 * (left + left.T)

    def identifies(self, at: Intp, left: FloatArray) -> bool:
        """Whether the model leaves enough (k, k) of an order's columns."""
        return bool(np.linalg.eigvalsh(left)[0] > IDENTIFIABLE * self.whole[at].mean())


def _beside_units(rich: Fit) -> _OfMap:
    """The linear problem about the rich fit, whose solution with all parameters is the fit itself."""
    problem, normal = rich.problem, rich.normal
    centre = np.where(problem.free, problem.start(), 0.0)
    response = normal.gradient + normal.matrix.times(rich.parameters - centre)
    prior = rich.noise**2 * problem.widths() ** -2.0
    border = normal.matrix.border
    gradient, matrix = response[border], normal.matrix.middle.copy()
    whole = np.diag(matrix).copy()
    known = normal.matrix.plus(prior)
    for at, inside, across in zip(known.blocks, known.inside, known.across, strict=True):
        taken = np.linalg.solve(inside, np.column_stack([across, response[at]]))
        matrix -= across.T @ taken[:, :-1]
        gradient -= across.T @ taken[:, -1]
    return _OfMap(gradient, matrix, prior[border], whole)


def _best(
    rich: Fit, beside: _OfMap, model: BoolArray, orders: dict[float, Intp], rng: np.random.Generator
) -> float | None:
    """The order that explains most, if that is more than noise would explain by the best of them."""
    gradient, matrix = beside.taken(model, np.concatenate(list(orders.values())))
    size, turn = np.linalg.eigh(matrix)
    root = turn * np.sqrt(np.maximum(size, 0.0))
    drawn = rng.standard_normal((DRAWS, len(gradient))) @ root.T
    best, most, by_chance = None, 0.0, np.zeros(DRAWS)
    for place, (order, at) in enumerate(orders.items()):
        own = slice(2 * place, 2 * place + 2)
        if not beside.identifies(at, matrix[own, own]):
            continue
        inverse = np.linalg.inv(matrix[own, own])
        by_chance = np.maximum(by_chance, ((drawn[:, own] @ inverse) * drawn[:, own]).sum(axis=1))
        gain = float(gradient[own] @ inverse @ gradient[own]) / rich.noise**2
        if gain > most:
            best, most = order, gain
    noise = rng.chisquare(rich.freedom, DRAWS) / rich.freedom
    exceeded = int((by_chance / noise >= most).sum())
    return best if (exceeded + 1) / (DRAWS + 1) <= LEVEL else None
