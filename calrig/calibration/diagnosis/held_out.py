"""Error before and after correction on held-out poses: cross-validation, contiguous blocks, a fresh run.

Interleaved folds repeat search and fit, but their poses lie between the others: a curve of time predicts them
and says nothing of the next hour (Roberts et al., Ecography 40, 2017). Blocks that are contiguous in time or
angle ask more; only bias, scale and the effects' coefficients are fitted again without each. Poses of a fresh
run that did not decide confirm. Last, a name must not rest on a single pose: at a turning point one pose may
be all that separates settling from backlash.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import Candidate, model_columns, own_columns, rebuilt
from calrig.calibration.diagnosis.entering import least_standard_errors
from calrig.calibration.diagnosis.established import established, with_effects
from calrig.calibration.diagnosis.experiment_design import predicted
from calrig.calibration.diagnosis.ranking import CONTAINED, SelectedEffect, decisive_pose
from calrig.calibration.diagnosis.report import (
    covariance_with_places,
    left_deg,
    slopes_of_errors,
    words_of,
)
from calrig.calibration.diagnosis.reselection import Rivals
from calrig.calibration.diagnosis.selection import Findings, search
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model, linear_about, parts_deg
from calrig.calibration.diagnosis.significance_test import Noises
from calrig.calibration.effects.unnamed import AT_EACH_PLACE, BY_SIDE
from calrig.calibration.line import rms
from calrig.calibration.poses import Pose
from calrig.calibration.progress import Progress, unheard
from calrig.calibration.regression.effect import ELEVATION
from calrig.calibration.regression.noise_model import LARGEST_RHO, Fit, distance_of, fit, lag1_correlation
from calrig.calibration.regression.responses import Responses, responses_of
from calrig.calibration.regression.run_changes import with_free_levels
from calrig.calibration.regression.terms import goes_round, less_line
from calrig.estimation.angles import FloatArray

FOLDS = 4
LEAST_OWN = 0.1**0.5
"""Of a curve of the angle, what the others beside it leave of one that is claimed alone."""
LEAST_GAIN = 1e-3
"""Of the error on held-out poses: what lowers it by less gains nothing."""
BOOTSTRAPS = 270
"""Enough to tell ¾ % from more, one draw of noise beyond it allowed; the p-value that is reported comes from
the search over all poses.
"""


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Errors (n,) in degrees of elevation of held-out poses: neither search nor fit had seen them.

    With `is_searched` False only the fit had not: the effects are those of all poses.
    """

    base_deg: FloatArray
    final_deg: FloatArray
    folds: int
    is_searched: bool = True

    @property
    def is_gain(self) -> bool:
        """Whether the error is smaller with the effects than without."""
        return rms(self.final_deg) < (1.0 - LEAST_GAIN) * rms(self.base_deg)

    def of_nothing(self) -> CrossValidation:
        """Return the errors where no effect is listed: what folds found by themselves is not claimed."""
        return replace(self, final_deg=self.base_deg)


def cross_validate(
    r: Responses,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    rivals: Rivals | None = None,
    noises: Noises = MappingProxyType({}),
    progress: Progress = unheard,
) -> CrossValidation:
    """Predict every pose once, by a search and a fit over the other folds; base on the same folds.

    `rivals` and `noises` are of a search of all poses: its competing candidates are compared again in each
    fold, and what noise gained are likelihood ratios, which know no pose's reading. `progress` is called with
    the share of folds done before each.
    """
    fold = folds_of(r)
    base = _errors(r, (), BETWEEN)
    final = base.copy()
    folds = int(fold.max()) + 1
    for k in range(folds):
        progress(k / folds)
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        seen = r.rows(train)
        of_fold = [c.rows(train) for c in candidates]
        findings = search(
            seen, of_fold, rng, bootstraps=BOOTSTRAPS, decide_only=True, rivals=rivals, noises=noises
        )
        findings = established(findings, draws=False)
        if not findings.found:
            continue
        # a fold's model in all poses; a refined period exists in the fold's alone
        whole = [_in_all_poses(f.candidate, r, candidates) for f in findings.found]
        if None in whole:
            continue
        model = fitted_model(findings.responses, [f.candidate for f in findings.found])
        final[test] = _errors_of(r, [c for c in whole if c is not None], model, test)
    return CrossValidation(base, final, folds)


def _in_all_poses(found: Candidate, r: Responses, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return an effect of a fold in all poses: as offered, or built anew at a refined place.

    A curve built anew would have other knots where outliers have left, and its coefficients another meaning.
    """
    offered = (c for c in candidates if (c.label, c.shape.form) == (found.label, found.shape.form))
    same = next((c for c in offered if c.shape.at == found.shape.at), None)
    there = rebuilt(found, r) if same is None else same
    if there is None or there.columns.shape[2] != found.columns.shape[2]:
        return None  # the fold's coefficients mean nothing in other columns
    return there


def without_harm(
    findings: Findings, held_out: CrossValidation
) -> tuple[Findings, CrossValidation, list[str]]:
    """Reduce effects with which the error is no smaller than without them, until it is.

    So on held-out poses and on those fitted: strongly correlated noise lets a model go far from its poses.
    Where the error hardly changes from pose to pose, the neighbours of a held-out pose tell it, and blocks of
    time must gain as well. Where the folds' own searches gain nothing, the effects of all poses are fitted
    again in each fold. While an error is no smaller than without them, the effect leaves whose absence lowers
    that on held-out poses most, or that on blocks.

    Returns:
        The findings, the errors on held-out poses, and a warning if effects left.
    """
    if not findings.found:
        return findings, held_out.of_nothing(), []
    r, found = findings.responses, list(findings.found)
    left = findings.fitted.residuals[:, 0]
    hardly_changes = lag1_correlation(left, float(r.rounding[0])) >= LARGEST_RHO
    along = TIME if hardly_changes and TIME in _folds(r) else BETWEEN

    def errors(those: Sequence[SelectedEffect], along: str = along) -> FloatArray:
        return _errors(r, tuple(f.candidate for f in those), along)

    def harm_of(
        those: Sequence[SelectedEffect], held_out: CrossValidation
    ) -> tuple[str, float, float] | None:
        """Return the poses that it is on, with the RMS errors before and after; None without harm."""
        if not held_out.is_gain:
            return "held-out poses", rms(held_out.base_deg), rms(held_out.final_deg)
        before_deg, after_deg = fit_rms_deg(r, those)
        if not after_deg < before_deg:
            return "the fitted poses", before_deg, after_deg
        if along == TIME and not rms(errors(those)) < rms(errors(())):
            return "held-out blocks of time", rms(errors(())), rms(errors(those))
        return None

    harm = harm_of(found, held_out)
    if harm is None:
        return findings, held_out, []

    def refitted(those: Sequence[SelectedEffect]) -> CrossValidation:
        if not those:
            return held_out.of_nothing()
        return CrossValidation(held_out.base_deg, errors(those, BETWEEN), held_out.folds, is_searched=False)

    again = refitted(found)
    if not held_out.is_gain and again.is_gain:  # the folds' own searches are not why effects leave
        harm = harm_of(found, again) or harm
    while found and harm_of(found, again) is not None:
        fewer = [[f for f in found if f is not one] for one in found]
        found = min(fewer, key=lambda those: rms(errors(those)))
        again = refitted(found)
    dropped = [words_of(r, f.candidate) for f in findings.found if f not in found]
    if not dropped:
        return findings, again, []
    which, before_deg, after_deg = harm
    warning = (
        f"{', '.join(dropped)}: significant, but not listed, since the error on {which} is no smaller with "
        f"all effects found: RMS {before_deg:#.3g}° before and {after_deg:#.3g}° after"
    )
    return with_effects(findings, found), again, [warning]


def fit_rms_deg(r: Responses, found: Sequence[SelectedEffect]) -> tuple[float, float]:
    """Return the RMS errors of the poses fitted, in degrees of elevation: of bias and scale, of a model."""
    accepted, line = [f.candidate for f in found], _line(r)
    before_deg = (r.values[:, 0] - r.base[:, 0, :] @ line) / slopes_of_errors(r, (), line)
    return rms(before_deg), rms(left_deg(r, accepted, fitted_model(r, accepted).fitted))


def folds_of(r: Responses, deal: int | None = None) -> npt.NDArray[np.intp]:
    """Return (n,) fold of each pose, dealt out in turn along each approach's elevations.

    So every fold has both approaches, all elevations, and poses from early and late. Each round of folds is
    in random order, the same for equally many poses. If each fourth pose were left out, the same angles of a
    turn, or of each elevation the same pass, might always be missing, and one wave look like another there.
    At one angle on and on the order stays. Each numbered deal has other random orders.
    """
    approach = np.zeros(len(r)) if r.approach is None else r.approach
    order = np.lexsort((np.arange(len(r)), np.round(r.theta_deg, 1), approach))
    fold = np.empty(len(r), dtype=np.intp)
    rounds = np.tile(np.arange(FOLDS), (-(-len(r) // FOLDS), 1))
    rng = np.random.default_rng(len(r) if deal is None else [len(r), deal])
    rounds = rng.permuted(rounds, axis=1)
    if deal is None:  # at one angle on and on: no wave along it, and even gaps in time keep its noise
        anew = np.diff(r.theta_deg[order[::FOLDS]], prepend=np.inf) != 0.0
        rounds = rounds[np.maximum.accumulate(np.where(anew, np.arange(len(rounds)), 0))]
    fold[order] = rounds.ravel()[: len(r)]
    return fold


def errors_deg(
    r: Responses, accepted: Sequence[Candidate], beta: FloatArray, test: Intp, slopes: FloatArray
) -> FloatArray:
    """Return (m,) reading less prediction of some poses, in degrees of elevation.

    `beta` (p,) was fitted elsewhere; `test` (m,) are the poses to predict; `slopes` (n,) are of all poses
    (`slopes_of_errors`).
    """
    columns = model_columns(r, accepted)[test, 0, :]
    return np.asarray((r.values[test, 0] - columns @ beta) / slopes[test], dtype=np.float64)


def _errors_of(r: Responses, accepted: Sequence[Candidate], elsewhere: Model, test: Intp) -> FloatArray:
    """Return the same of a model that was fitted elsewhere, its effects given in all poses."""
    beta = elsewhere.fitted.beta
    return errors_deg(*linear_about(r, accepted, elsewhere), beta, test, slopes_of_errors(r, accepted, beta))


def _line(r: Responses) -> FloatArray:
    """Return the coefficients (p,) of bias and scale alone, by least squares, as a calibration fits them.

    Where noise wanders, those of the model's own likelihood follow what changes from pose to pose: of
    readings that lag behind a step, hardly any scale.
    """
    return np.asarray(np.linalg.lstsq(r.base[:, 0, :], r.values[:, 0], rcond=None)[0], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Confirmation:
    """RMS errors of the fresh poses in degrees of elevation, predicted without and with the effects."""

    before_rms_deg: float
    after_rms_deg: float
    n_poses: int


def confirm(
    runs: Sequence[Sequence[Pose]], fresh: Sequence[Pose], deciding: Sequence[int], findings: Findings
) -> Confirmation | None:
    """Fit base and final model to all poses but the confirming ones and predict those.

    `findings` are of the diagnosis of `runs` with the poses of the `fresh` run that served to decide, at the
    indices `deciding`: these fix its bias.

    Returns:
        None where no pose is left to confirm with, or an effect cannot show in these poses.
    """
    r = with_free_levels(responses_of([*runs, fresh], request=findings.responses.request))
    before = len(r) - len(fresh)
    test = np.array([before + k for k in range(len(fresh)) if k not in set(deciding)], dtype=np.intp)
    effects = [predicted(f.candidate, r) for f in findings.found]
    accepted = [effect for effect in effects if effect is not None]
    if len(test) == 0 or len(accepted) < len(effects) or len(r) != sum(map(len, runs)) + len(fresh):
        return None
    train = np.setdiff1d(np.arange(len(r)), test)
    seen = r.rows(train)
    errors = []
    for effects_in in ((), accepted):
        model = fitted_model(seen, [effect.rows(train) for effect in effects_in])
        errors.append(_errors_of(r, effects_in, model, test))
    return Confirmation(rms(errors[0]), rms(errors[1]), len(test))


BLOCKS = 4
TIME, BETWEEN = "time", "between"
"""Along every run; and along nothing: the interleaved folds, as many as there are blocks."""
UNSTABLE = 1e-3
"""Chance that the coefficients of a true effect differ as much between the whole and a part of the poses."""
ESTIMABLE = 1e-4
"""Of a column, what the others must leave of it: a slip in the block left out is a bias in all the others."""
WAVY, FORESEEN = 2 * BLOCKS, 0.03
"""Columns of curves that may be a wave within one block; of the size of a part, what the others must show."""
KEPT = 16
"""Models whose errors may be asked for again: with all effects, and without each."""
Intp = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Blocked:
    """Errors (n,) in degrees of elevation of poses held out in blocks that are contiguous in one thing.

    Attributes:
        along: `time` or `angle`.
        base_deg, final_deg: without and with the effects found.
    """

    along: str
    base_deg: FloatArray
    final_deg: FloatArray

    @property
    def ratio(self) -> float:
        """RMS with the effects over that without."""
        base = rms(self.base_deg)
        return rms(self.final_deg) / base if base > 0.0 else 1.0


def blocked(r: Responses, accepted: Sequence[Candidate]) -> tuple[Blocked, ...]:
    """Predict every pose once along time, and once along angle where the poses turn."""
    every = tuple(accepted)
    return tuple(Blocked(along, _errors(r, (), along), _errors(r, every, along)) for along in _folds(r))


def worse(several: Sequence[Blocked]) -> Blocked | None:
    """Return the one that the effects help least; None where there is none."""
    return max(several, key=lambda one: one.ratio, default=None)


def not_predictive(
    r: Responses, found: Sequence[SelectedEffect], whole: Fit, offered: Sequence[Candidate]
) -> tuple[SelectedEffect, ...]:
    """Return the same effects; a name that fails the blocks it has not seen is no longer claimed alone.

    It fails where the blocks' error is smaller without it and its coefficients, from the rest of the poses,
    contradict those from all of them (Hausman, Econometrica 46, 1978). A block that the rest cannot predict,
    the effect being true, contradicts nothing. Nor is a name claimed alone whose size, by the errors that are
    stated of it, is not as certain as one that enters: it differs from part to part of the run. Nor is
    one that the other curves of a part of the turn contain.

    The rival of a name is then a shape without a name among those `offered`.
    """
    if not found:
        return ()
    accepted = tuple(f.candidate for f in found)
    folds, model = _folds(r), fitted_model(r, accepted)
    own = own_columns(model.columns, accepted)
    stated = covariance_with_places(model)
    contained = _contained(model)

    def judged(place: int, one: SelectedEffect) -> SelectedEffect:
        others = tuple(c for c in accepted if c is not one.candidate)
        rival = _nameless(one.candidate, offered) if one.candidate.named else None
        if rival is None:
            return one
        if one.candidate in contained:
            return one.against(rival, CONTAINED)
        at, least = own[place], least_standard_errors(one.candidate, others)
        if distance_of(model.fitted.beta[at], stated[at, at]) < least**2:
            return one.against(rival, f"its size is below {least:g} standard errors")
        for along, fold in folds.items():
            helps = rms(_errors(r, accepted, along)) < rms(_errors(r, others, along))
            if not helps and _contradicts(r, accepted, place, whole, fold):
                return one.against(rival, f"it does not predict poses of a block of {along} left out")
        return one

    return tuple(judged(place, one) for place, one in enumerate(found))


def _contained(model: Model) -> list[Candidate]:
    """Return the named curves of a part of the turn that the others of the elevation contain nearly whole.

    One of them, taken out, would be made up for: a variance inflation factor above 10 (Belsley, Kuh & Welsch,
    Regression Diagnostics, 1980, section 3.2). So would a wave of which the arc has less than two.
    """
    r, accepted = model.responses, model.accepted
    curves = [k for k, c in enumerate(accepted) if c.covariate == ELEVATION.name]
    if goes_round(r) or len(curves) < 2:
        return []
    parts, own, found = parts_deg(r, accepted, model.fitted.beta), own_columns(model.columns, accepted), []
    for k in (k for k in curves if accepted[k].named):
        others = np.column_stack([model.columns[:, 0, own[other]] for other in curves if other != k])
        beside, part_deg = less_line(r, others), less_line(r, parts[k])
        left_deg = part_deg - beside @ np.linalg.lstsq(beside, part_deg, rcond=None)[0]
        is_long = accepted[k].shape.at.get("period_deg", 0.0) > r.arc_deg / 2.0
        if is_long or rms(left_deg) < LEAST_OWN * rms(part_deg):
            found.append(accepted[k])
    return found


def _folds(r: Responses) -> dict[str, Intp]:
    """Return (n,) block of each pose, for each way to lay them: along every run, and over the elevations."""
    first = np.unique([0, *np.flatnonzero(r.starts)])  # what a run began with may have been left out
    length = np.diff([*first, len(r)])
    since = np.arange(len(r)) - np.repeat(first, length)
    folds = {}
    if length.min() >= 2 * BLOCKS:  # a table without history has none to part
        folds[TIME] = since * BLOCKS // np.repeat(length, length)
    places = np.unique(np.round(r.theta_deg))
    if len(places) >= 2 * BLOCKS:
        edges = places[np.arange(1, BLOCKS) * len(places) // BLOCKS]
        folds["angle"] = np.searchsorted(edges, np.round(r.theta_deg), side="right")
    return folds


@lru_cache(maxsize=KEPT)
def _errors(r: Responses, accepted: tuple[Candidate, ...], along: str) -> FloatArray:
    errors, fold = np.zeros(len(r)), folds_of(r) if along == BETWEEN else _folds(r)[along]
    for k in range(BLOCKS):
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        seen, shown = r.rows(train), _foreseen(r, _shown(r, accepted, train), train)
        if not accepted:
            line = _line(seen)
            errors[test] = errors_deg(r, (), line, test, slopes_of_errors(r, (), line))
            continue
        model = fitted_model(seen, [c.rows(train) for c in shown])
        errors[test] = _errors_of(r, shown, model, test)
    return errors


def _shown(r: Responses, accepted: Sequence[Candidate], train: Intp) -> list[Candidate]:
    """Return the effects that some of the poses can show beside bias, scale and the effects before."""
    shown: list[Candidate] = []
    for candidate in accepted:
        before = _flat(model_columns(r, shown)[train])
        own = _flat(candidate.columns[train])
        left = own - before @ np.linalg.lstsq(before, own, rcond=None)[0]
        if np.linalg.norm(left) > ESTIMABLE * np.linalg.norm(own):
            shown.append(candidate)
    return shown


def _foreseen(r: Responses, shown: Sequence[Candidate], train: Intp) -> list[Candidate]:
    """Return the effects, wavy functions of one thing less what they do where no pose is left.

    A spline would fly off there, and so would many waves together: in a gap of a quarter of a turn, orders 1
    to 11 whose amplitudes are right to 0.003° make 74°.
    """
    wavy: dict[tuple[bool, str, bool], list[Candidate]] = {}
    n_columns: Counter[str] = Counter()
    for c in shown:
        is_linear = c.effect.on_vector_g is None and c.effect.not_linear is None
        if is_linear and c.beside is None and c.changed is None:
            column = c.covariate.removeprefix(BY_SIDE)
            wavy.setdefault((column != c.covariate, column, c.shape.at_elevation is None), []).append(c)
            n_columns[column] += c.columns.shape[2]
    foreseen, line = list(shown), _flat(model_columns(r, ())[train])
    for (is_by_side, column, _), those in sorted(wavy.items(), key=lambda item: item[0][0]):
        is_free = any(c.shape.form == AT_EACH_PLACE for c in those)  # at places that a block leaves none of
        if is_free or n_columns[column] >= WAVY:
            others = [c for c in foreseen if c not in those]
            # poses of one side show no more than the sum of a curve and of what changes sign with the side
            beside = _flat(model_columns(r, others)[train]) if is_by_side else line
            foreseen = [*others, _as_far_as_shown(those, train, beside)]
    return foreseen


def _as_far_as_shown(those: Sequence[Candidate], train: Intp, beside: FloatArray) -> Candidate:
    """Return several curves as one of what some poses show of them beside other columns (m, p)."""
    columns = np.concatenate([c.columns for c in those], axis=2)
    whole, _ = np.linalg.qr(_flat(columns))
    directions = whole.reshape(columns.shape)
    own = _flat(directions[train])
    left = own - beside @ np.linalg.lstsq(beside, own, rcond=None)[0]
    _, seen, turn = np.linalg.svd(left, full_matrices=False)
    kept = turn[seen > FORESEEN].T
    shape = those[0].shape
    if shape.at_elevation is not None:
        of_own = np.linalg.lstsq(_flat(columns), whole @ kept, rcond=None)[0]
        shares = [c.shape.at_elevation for c in those if c.shape.at_elevation is not None]

        def at_elevation(theta_deg: FloatArray) -> FloatArray:
            each = [of(theta_deg).reshape(len(theta_deg), -1) for of in shares]
            return np.asarray(np.concatenate(each, axis=1) @ of_own, dtype=np.float64)

        shape = replace(shape, at_elevation=at_elevation)
    return replace(those[0], shape=shape, columns=directions @ kept)


def _flat(columns: FloatArray) -> FloatArray:
    return columns.reshape(-1, columns.shape[2])


def _contradicts(r: Responses, accepted: Sequence[Candidate], place: int, whole: Fit, fold: Intp) -> bool:
    """Whether coefficients without some block differ from the whole's by more than their errors allow."""
    from scipy.special import chdtrc

    model = fitted_model(r, accepted)
    r, accepted, columns = model.responses, model.accepted, model.columns
    at = own_columns(columns, accepted)[place]
    for k in range(BLOCKS):
        train = np.flatnonzero(fold != k)
        if len(_shown(r, accepted, train)) < len(accepted):
            continue
        part = fit(r.rows(train), columns[train])
        change = part.beta[at] - whole.beta[at]
        # Var(change) = Var(part) − Var(whole), which errs with both: the first alone is on the safe side
        distance = distance_of(change, part.covariance[at, at])
        if chdtrc(len(change), distance) < UNSTABLE:
            return True
    return False


def _nameless(claimed: Candidate, offered: Sequence[Candidate]) -> Candidate | None:
    """A shape without a name that follows the same column as the claimed effect, the smoothest first."""
    return next((c for c in offered if not c.named and c.covariate == claimed.covariate), None)


def standing_without_one(r: Responses, found: Sequence[SelectedEffect]) -> tuple[SelectedEffect, ...]:
    """Return the same effects; a name that one pose alone tells from a runner-up is ambiguous with it."""
    return tuple(
        _doubted(r, one, [f.candidate for f in found if f is not one]) if one.verdict == "named" else one
        for one in found
    )


def _doubted(r: Responses, claimed: SelectedEffect, others: Sequence[Candidate]) -> SelectedEffect:
    doubted = claimed
    for rival in claimed.runners_up:
        pose = decisive_pose(r, others, claimed.candidate, rival)
        if pose is not None:
            only = f"only the pose at {r.theta_deg[pose]:.4g}°"
            doubted = doubted.against(rival, f"{only} tells it from {words_of(r, rival)}: the rest does not")
    return doubted
