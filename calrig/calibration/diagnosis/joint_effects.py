"""Fit the effects accepted from several runs as one model, over the poses of all of these runs.

The parameters of the effects and the scale are shared. Each run has a level of its own, because the day and
the clamping differ. So an offset of one run and the constant part of a temperature term of another run are
fitted together and not counted twice. The scatter of the levels beyond their standard errors is the variance
between runs (method of moments: DerSimonian & Laird, Controlled Clinical Trials 7, 1986).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    documented_forms,
    own_columns,
    replaced,
)
from calrig.calibration.diagnosis.held_out import FOLDS, folds_of
from calrig.calibration.diagnosis.report import covariance_of, likeliest_forms
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.effects import EFFECTS, UNNAMED, effect_of
from calrig.calibration.line import residuals_deg, rms
from calrig.calibration.poses import DiagnosisError, Pose, complete
from calrig.calibration.regression.effect import ELEVATION, ApplyError, Circumstances
from calrig.calibration.regression.request import DiagnosisRequest
from calrig.calibration.regression.responses import Responses, responses_of
from calrig.calibration.regression.run_changes import with_free_levels
from calrig.calibration.results.correction import (
    AppliedEffect,
    effects_on_reading_deg,
    elevation_errors_deg,
    felt_elevation_deg,
    fit_line_with_effects,
    numbers_of,
    own_effect,
)
from calrig.calibration.results.pose_errors import angles_deg, circumstances
from calrig.estimation.angles import FloatArray

Parameters = dict[str, dict[str, float | None] | None]
LEVEL = "reading.level"
DEALS = 5
"""Of the poses into folds: of a run of a dozen poses one deal says more of chance than of the model."""
SMALL, SINGULAR = 1e-3, 1e-12
"""Of a standard error: a step for derivatives. Of a variance: what makes values of one curve independent."""
MOST_GROWTH = 1.05
"""Of a run's error on held-out poses: what one more run's effects may make of it."""


@dataclass(frozen=True, slots=True)
class RunOfEffects:
    """A run as effects are fitted to it.

    Attributes:
        poses: those that count, in the order measured.
        others: effects that its diagnosis has and that are not among the unit's (backlash, a drift): they are
            fitted in this run alone, so that the unit's do not take them up.
        of_rig: effects in force for its rig, taken out before errors are compared.
    """

    run_id: str
    poses: Sequence[Pose]
    others: Sequence[Mapping[str, Any]] = ()
    of_rig: Sequence[AppliedEffect] = ()


@dataclass(frozen=True, slots=True)
class JointEffects:
    """Effects as one model of several runs.

    Attributes:
        effects: of each its name, and `{"value", "std"}` by parameter (CONTRACT section 5).
        run_offset_std_deg: standard deviation of a run's level between days and clampings, beyond what the
            poses of a run scatter by; None of a single run.
        factors: of each effect and each parameter with a standard error, a row of a triangular matrix L. The
            parameters of all effects have the covariance L·Lᵀ, to first order, and so have the first of them.
    """

    effects: list[tuple[str, Parameters]]
    run_offset_std_deg: float | None
    factors: list[dict[str, list[float]]] = field(default_factory=list)

    @property
    def applied(self) -> list[AppliedEffect]:
        """The effects as arithmetic takes them."""
        return [own_effect(name, parameters) for name, parameters in self.effects]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Runs as responses with a level each, with every effect's columns."""

    responses: Responses
    shared: tuple[Candidate, ...]
    of_runs: tuple[Candidate, ...]

    def fitted(self, chosen: npt.NDArray[np.intp] | None = None) -> JointEffects:
        """Fit all poses, or the chosen ones (without standard errors)."""
        r, candidates = self.responses, (*self.shared, *self.of_runs)
        if chosen is not None:
            r, candidates = r.rows(chosen), tuple(c.rows(chosen) for c in candidates)
        try:
            model = fitted_model(r, candidates)
            covariance = model.fitted.covariance
            if chosen is None:
                covariance = covariance_of(model.responses, model.columns, model.fitted)
        except np.linalg.LinAlgError as error:
            raise DiagnosisError(f"the effects cannot be fitted together ({error})") from error
        beta, own = model.fitted.beta, own_columns(model.columns, candidates)
        effects = [
            (one.name, one.effect.documented(one.shape, beta[at], covariance[at, at]))
            for one, at in zip(self.shared, own[: len(self.shared)], strict=True)
        ]
        names = [name for name in r.base_names if name != replaced(candidates)]
        levels = [k for k, name in enumerate(names) if name == LEVEL]
        between = _between_runs_deg(beta[levels], covariance[np.ix_(levels, levels)]) if levels else None
        stated = np.diag(model.fitted.covariance)
        # one factor for all: another for each would undo that errors of curves alike cancel
        wider = np.mean(np.divide(np.diag(covariance), stated, out=np.ones_like(stated), where=stated > 0.0))
        alike = wider * model.fitted.covariance
        factors = [] if chosen is not None else _factors(self.shared, own, beta, alike, effects)
        return JointEffects(effects, between, factors)


def _factors(
    shared: Sequence[Candidate],
    own: Sequence[slice],
    beta: FloatArray,
    covariance: FloatArray,
    effects: Sequence[tuple[str, Parameters]],
) -> list[dict[str, list[float]]]:
    """Return the rows of L (`JointEffects.factors`), by the covariance (p, p) of the coefficients."""
    known = [
        [(name, std) for name, one in found.items() if one and (std := one["std"])] for _, found in effects
    ]
    places = [(k, name) for k, names in enumerate(known) for name, _ in names]
    slopes = np.zeros((len(places), len(beta)))
    for k, (one, at) in enumerate(zip(shared, own[: len(shared)], strict=True)):
        rows = [row for row, (effect, _) in enumerate(places) if effect == k]
        for column in range(at.start, at.stop):
            step = np.zeros(len(beta))
            step[column] = SMALL * math.sqrt(covariance[column, column])
            ends = [
                one.effect.documented(one.shape, (beta + side * step)[at], covariance[at, at])
                for side in (0.5, -0.5)
            ]
            for row in rows:
                above, below = (end[places[row][1]]["value"] for end in ends)
                slopes[row, column] = (above - below) / step[column] if step[column] else 0.0
    between = slopes @ covariance @ slopes.T
    size = np.sqrt(np.diag(between))
    alone = size == 0.0  # a place that was refined (a period) is no coefficient
    size = np.where(alone, [std for names in known for _, std in names], size)
    correlation = between / np.outer(size, size) + np.diag(alone + SINGULAR)
    rows_of = (size[:, None] * np.linalg.cholesky(correlation)).tolist()
    found: list[dict[str, list[float]]] = [{} for _ in effects]
    for (k, name), row in zip(places, rows_of, strict=True):
        found[k][name] = row
    return found


def fit_together(runs: Sequence[RunOfEffects], effects: Sequence[AppliedEffect]) -> JointEffects:
    """Fit effects of a unit over several runs.

    Args:
        runs: in the order measured.
        effects: those accepted; of the values only references and places (a period) are used. Where the
            poses do not tell two of one name apart, they are one.

    Raises:
        DiagnosisError: the poses are too few, or cannot show an effect.
    """
    return _problem(runs, effects).fitted()


@dataclass(frozen=True, slots=True)
class Growth:
    """RMS errors of a run on held-out poses, degrees, under two models."""

    run_id: str
    before_deg: float
    after_deg: float

    @property
    def is_too_large(self) -> bool:
        """Whether the error grows by more than `MOST_GROWTH` allows."""
        return self.after_deg > MOST_GROWTH * self.before_deg


def held_out_growth(
    runs: Sequence[RunOfEffects],
    before: Sequence[AppliedEffect],
    n_before: int,
    after: Sequence[AppliedEffect],
) -> list[Growth]:
    """Return the error of each run on held-out poses: as before, and with one model of all runs.

    The effects are fitted without a fold of the poses: those of `before` over the first runs, those of
    `after` over all. Bias and scale are each run's own, from its poses of the other folds.

    Args:
        runs: those that the effects of `before` rest on come first.
        before: effects in force; none before the first acceptance.
        n_before: the number of these runs.
        after: all effects.

    Raises:
        DiagnosisError: as of `fit_together`.
    """
    earlier = _problem(runs[:n_before], before) if before else None
    whole = _problem(runs, after)
    tests = [_TestedRun.of(run) for run in runs]
    run_of = whole.responses.run
    errors = [(np.zeros((DEALS, len(one.theta_deg))), np.zeros((DEALS, len(one.theta_deg)))) for one in tests]
    for deal, k in product(range(DEALS), range(FOLDS)):
        fold = folds_of(whole.responses, deal)
        train = np.flatnonzero(fold != k)
        given = [] if earlier is None else earlier.fitted(train[train < len(earlier.responses)]).applied
        models = given, whole.fitted(train).applied
        for number, (one, found) in enumerate(zip(tests, errors, strict=True)):
            held_out = fold[run_of == number] == k
            for model, left in zip(models, found, strict=True):
                left[deal, held_out] = one.errors_deg(model, ~held_out, held_out)
    return [
        Growth(run.run_id, rms(without.ravel()), rms(with_all.ravel()))
        for run, (without, with_all) in zip(runs, errors, strict=True)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _TestedRun:
    """A run's poses, to be predicted by bias, scale and effects from others of them."""

    theta_deg: FloatArray
    reading_deg: FloatArray
    given: Circumstances
    of_rig: Sequence[AppliedEffect] = field(default=())

    @classmethod
    def of(cls, run: RunOfEffects) -> _TestedRun:
        ((poses,), _) = complete([run.poses])
        theta_deg, reading_deg = angles_deg(poses)
        given, of_rig = circumstances(poses), run.of_rig
        try:
            effects_on_reading_deg(of_rig, theta_deg, given)
        except ApplyError:
            of_rig = ()
        return cls(theta_deg, reading_deg, given, of_rig)

    def errors_deg(
        self, model: Sequence[AppliedEffect], train: npt.NDArray[np.bool_], test: npt.NDArray[np.bool_]
    ) -> FloatArray:
        """Return (m,) calibrated elevation less θ of the tested poses."""
        effects = [*model, *self.of_rig]
        try:
            seen, asked = self.given.rows(train), self.given.rows(test)
            angles = self.theta_deg[train], self.reading_deg[train]
            line = fit_line_with_effects(*angles, effects, seen, doubts=False)
            theta_deg = self.theta_deg[test]
            felt_deg = felt_elevation_deg(theta_deg, line.bias_deg, line.scale)
            added_deg = effects_on_reading_deg(effects, theta_deg, asked, felt_deg)
        except ApplyError as error:
            raise DiagnosisError(str(error)) from error
        left_deg = residuals_deg(theta_deg, self.reading_deg[test] - added_deg, line.bias_deg, line.scale)
        return elevation_errors_deg(theta_deg, left_deg * (line.scale or 1.0), line, effects, asked)


def _problem(runs: Sequence[RunOfEffects], effects: Sequence[AppliedEffect]) -> _Problem:
    # a term of the angle is the unit's only where the reference was taken as good
    is_good = any(effect_of(name).scope != "unit" for name, _ in effects)
    request = DiagnosisRequest("good" if is_good else "stage")
    r = with_free_levels(responses_of([run.poses for run in runs], [run.run_id for run in runs], request))
    forms: list[list[Candidate]] = []
    for name, parameters in effects:
        # an accepted effect without a name is a curve of the elevation
        covariate = ELEVATION if name == UNNAMED else effect_of(name).covariate
        options = documented_forms(r, name, covariate.name, parameters)
        if not options:
            listed = " and ".join(r.run_ids) + (" together" if len(r.run_ids) > 1 else "")
            raise DiagnosisError(f"the poses of run {listed} cannot show {name}")
        if not any(_is_same(r, one, options[0]) for one, *_ in forms):
            forms.append(options)
    names = {name for name, _ in effects}
    of_runs = [
        candidate
        for number, run in enumerate(runs)
        for document in run.others
        if document["name"] not in names and (candidate := _of_run(r, number, document)) is not None
    ]
    return _Problem(r, tuple(likeliest_forms(r, forms)), tuple(of_runs))


def _is_same(r: Responses, one: Candidate, other: Candidate) -> bool:
    """Whether two effects are one: of one name, and these poses do not tell their places apart."""
    return one.kind == other.kind and (one.effect.resolved is None or not one.is_distinct(r, other))


def _of_run(r: Responses, number: int, document: Mapping[str, Any]) -> Candidate | None:
    """Return an effect with linear columns in one run alone; None where its poses cannot show it."""
    name = document["name"]
    if name not in EFFECTS or document.get("changed") is not None:
        return None
    covariate = document.get("covariate") or effect_of(name).covariate.name
    chosen = np.flatnonzero(r.run == number)
    options = documented_forms(r.rows(chosen), name, covariate, numbers_of(document["parameters"]))
    if not options:
        return None
    (first, *_) = options
    columns = np.zeros((len(r), *first.columns.shape[1:]))
    columns[chosen] = first.columns
    linear = replace(
        first.effect,
        not_linear=None,
        on_vector_g=None,
        on_reading_deg=first.effect.on_reading_deg or (lambda p: np.zeros(len(p.theta_deg))),
    )
    return Candidate(linear, replace(first.shape, replaces=None), columns)


def _between_runs_deg(steps_deg: FloatArray, covariance: FloatArray) -> float:
    """Return the standard deviation between runs' levels, of the steps (k − 1,) from each to the next."""
    n = len(steps_deg) + 1
    about_mean = (np.eye(n) - 1.0 / n)[:, 1:] @ np.tril(np.ones((n - 1, n - 1)))
    levels_deg = about_mean @ steps_deg
    by_poses = float(np.trace(about_mean @ covariance @ about_mean.T))
    return math.sqrt(max((float(levels_deg @ levels_deg) - by_poses) / (n - 1), 0.0))
