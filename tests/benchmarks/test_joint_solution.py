"""A joint solution of many units, beside SciPy's least squares on the same vectors with a sparse Jacobian."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_array

sys.path.insert(0, str(Path(__file__).parents[1]))

from studies.joint.rig import Bench, Design, drawn_stage, drawn_unit

from calrig.calibration.separation.least_squares import fitted
from calrig.calibration.separation.pose_table import table_of
from calrig.calibration.separation.problem import Problem
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve

ORDERS = tuple(float(order) for order in range(1, 13))


def many(n_units: int, mounts_deg: tuple[float, ...], n: int):
    """Poses of units that were each clamped at the same angles of one stage."""
    rng = np.random.default_rng(0)
    units = tuple(drawn_unit(rng) for _ in range(n_units))
    visits = [
        replace(visit, unit=unit, name=f"{visit.name}-{unit}")
        for unit in range(n_units)
        for visit in Design(mounts_deg, n=n).visits(rng)
    ]
    return Bench(units, drawn_stage(rng, 12, gap_deg=0.05), tuple(visits)).measured(rng)


def took_s(work):
    """Processor time, and what it made."""
    began = time.process_time()
    made = work()
    return time.process_time() - began, made


def test_a_hundred_units_at_four_angles_are_solved():
    """As `calrig solve`, document and all: aim 10 s of processor time and 500 MB."""
    lots = many(100, (0.0, 90.0, 180.0, 270.0), 52)
    spent_s, document = took_s(lambda: solution_document(solve(lots)))
    most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    sys.stdout.write(f"\n100 units × 4 × 52 poses: {spent_s:.1f} s, {most_mb:.0f} MB\n")
    assert document["separable"]
    assert spent_s < 10.0
    assert most_mb < 500.0


def test_it_is_faster_than_a_general_sparse_least_squares():
    table, _ = table_of(many(20, (0.0, 120.0, 240.0), 36))
    problem = Problem(table, ORDERS)
    ours_s, fit = took_s(lambda: fitted(problem, np.ones(len(table))))
    theirs_s, found = took_s(lambda: by_scipy(problem))
    sys.stdout.write(
        f"\n20 units × 3 × 36 poses: {ours_s:.2f} s, SciPy {theirs_s:.2f} s: {theirs_s / ours_s:.0f} times\n"
    )
    own = np.arange(problem.first_mount)[problem.free[: problem.first_mount]]
    apart = np.abs(found[own] - fit.parameters[own]) / np.sqrt(np.diag(fit.covariance_at(own)))
    assert apart.max() < 0.05, "the same solution"
    assert ours_s < theirs_s


def by_scipy(problem: Problem):
    """(p,) the parameters; the Jacobian is the model's own, the start that of the iteration."""
    free = np.flatnonzero(problem.free)
    start = np.where(problem.free, problem.start(), 0.0)
    places = np.array(
        [[*problem.own[k], *range(problem.first_order, problem.size)] for k in problem.table.mount]
    )

    def whole(some):
        parameters = start.copy()
        parameters[free] = some
        return parameters

    def jacobian(some):
        derivatives = problem.normal(whole(some), np.ones(len(problem.table))).derivatives
        n, _, width = derivatives.shape
        rows = np.repeat(np.arange(2 * n), width)
        columns = np.repeat(places, 2, axis=0).ravel()
        shape = (2 * n, problem.size)
        return -csr_array((derivatives.reshape(-1), (rows, columns)), shape=shape)[:, free]

    def residuals(some):
        return (problem.table.vector_g - problem.expected(whole(some)).vector_g)[:, 1:].ravel()

    return whole(least_squares(residuals, start[free], jacobian, x_scale="jac", tr_solver="lsmr").x)
