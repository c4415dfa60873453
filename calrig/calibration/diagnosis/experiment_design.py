"""Design the follow-up run that separates competing effects best, and decide between them pose by pose.

Poses are chosen by their expected gain in likelihood; the decision is Wald's sequential probability ratio
test.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from calrig.calibration.diagnosis.candidates import Candidate, coefficients_in, model_columns, rebuilt
from calrig.calibration.diagnosis.ranking import SAME, SelectedEffect
from calrig.calibration.diagnosis.report import words_of
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.effects import covariate_of
from calrig.calibration.poses import Pose, without_unused
from calrig.calibration.progress import Progress, unheard
from calrig.calibration.regression.channels import ANGLE
from calrig.calibration.regression.effect import TEMPERATURE
from calrig.calibration.regression.noise_model import NoiseModel, fit, stacked
from calrig.calibration.regression.responses import Responses, responses_of
from calrig.calibration.regression.run_changes import with_free_levels
from calrig.estimation.angles import FloatArray

MOST_POSES = 12
CONFIRMING_POSES = 8
"""Taken after the deciding ones: what they say of before and after did not serve to decide."""
PLACES = 17
LEAST_SEPARATION = 12.0
"""Of −2 log likelihood, below which a run is not worth starting: it would name the wrong one in 1 of 25."""
TURN_THE_UNIT = (
    "turn the unit by 90° or 180° on the stage and calibrate again: what turns with it is the sensor's, what "
    "stays is the stage's"
)
OTHER_PLACES = "take poses at other angles, unevenly spaced: what looks alike at these comes apart there"
STAND_STILL = (
    "no run of poses was designed: calibrate again with the stage at rest at each pose, approached from both "
    "sides; a delay of the readings vanishes there, and backlash does not"
)
COOL_THE_UNIT = (
    "let the unit cool down and calibrate again: what comes back with the temperature is the unit's"
)


@dataclass(frozen=True, slots=True)
class FollowUp:
    """A run that is expected to separate the suspects.

    Attributes:
        separates: names of the suspects.
        separation: expected −2 log likelihood between the closest two once both runs are taken together.
        elevations_deg: of one sweep, deciding poses in their order, then confirming ones.
        deciding: how many of a sweep's poses decide.
        sweeps: two where time must pass between them.
        wait_s: before each sweep.
    """

    separates: tuple[str, ...]
    separation: float
    elevations_deg: tuple[float, ...]
    deciding: int
    sweeps: int
    wait_s: float

    def document(self, plan: dict[str, Any]) -> dict[str, Any]:
        """CONTRACT section 5's `follow_up`; `plan` holds what the run keeps of the one before."""
        names = ["settle_s", "dwell_s", "rate_hz", "seed"]
        if plan.get("kind") != "sweep":  # whose velocity is none to go from dwell to dwell with
            names.append("velocity_dps")
        kept = {name: plan[name] for name in names if name in plan}
        return {
            "separates": list(self.separates),
            "separation_sigma": round(math.sqrt(self.separation), 2),
            "separation": round(self.separation, 2),
            "deciding_poses": self.deciding,  # of each sweep, its first ones
            "plan": {
                **kept,
                "kind": "calibration",
                "elevations_deg": list(self.elevations_deg),
                "order": "given",
                "sweeps": self.sweeps,
                "wait_s": self.wait_s,
            },
        }


def ambiguous_of(findings: Findings) -> SelectedEffect | None:
    """The first effect whose rivals a run may separate: no change between runs, and not one curve."""
    suspected = (f for f in findings.found if f.verdict == "ambiguous" and f.candidate.changed is None)
    return next((f for f in suspected if not f.is_one_curve(findings.responses, findings.found)), None)


def design(
    runs: Sequence[Sequence[Pose]],
    findings: Findings,
    limits_deg: tuple[float, float],
    seed: int = 0,
    progress: Progress = unheard,
) -> FollowUp | str:
    """Return the follow-up run for a diagnosis, or the reason why no run on this rig would help.

    Each next elevation is the one of a grid over the limits (jittered, so that no period hides in it) that
    adds most to the distance between the closest two suspects. Of A from B it is ‖(I − P_B)·W·μ_A‖²: what is
    left of A's effect, at the size found, when base and B are fitted to it, in units of the noise
    (T-optimality: Atkinson & Fedorov, Biometrika 62, 1975).

    `limits_deg` are soft limits of elevation, `seed` is of the grid's jitter, and `progress` is called with
    the share of the poses that have been chosen.
    """
    found = ambiguous_of(findings)
    if found is None:
        return "nothing is left to separate: the diagnosis names no suspects that look alike"
    if any(pose.mount_deg for run in runs for pose in run):
        return "a run that separates suspects is designed for a unit clamped at 0° alone"
    suspects = [found.candidate, *found.rivals]
    if any(suspect.effect.late_by_deg is not None for suspect in suspects):
        return STAND_STILL
    others = [f.candidate for f in findings.found if f is not found]
    trial = _Trial(runs, findings, others, suspects)
    rng = np.random.default_rng(seed)
    spread = [round(float(p), 3) for p in np.linspace(*limits_deg, MOST_POSES // 2 + 2)[1:-1]]
    waits_s = _waits(runs, suspects)
    shuffled = [round(float(p), 3) for p in rng.permutation(np.linspace(*limits_deg, 2 * MOST_POSES))]
    undesigned = trial.why_none(findings.responses, shuffled)
    if undesigned:
        return f"no run is designed that would separate the suspects: {undesigned}"
    trial.keep_distinguishable([(shuffled, 0.0), *((spread * 2, wait_s) for wait_s in waits_s)])
    chosen = _greedy(trial, limits_deg, rng, progress)
    separation, sweeps, wait_s = trial.separation(chosen), 1, 0.0
    for waited_s in waits_s:
        waiting = trial.separation(spread * 2, waited_s)
        if waiting > separation:
            separation, chosen, sweeps, wait_s = waiting, spread, 2, waited_s
    names = trial.names
    if separation < LEAST_SEPARATION:
        r = findings.responses
        by_hand = COOL_THE_UNIT if TEMPERATURE.name in trial.covariates else TURN_THE_UNIT
        has_unit = ANGLE in r.channels and not r.reference_is_good  # an encoder has no face to be turned on
        if by_hand is TURN_THE_UNIT and not has_unit:
            by_hand = OTHER_PLACES
        suspected = " and ".join(dict.fromkeys(words_of(r, one) for one in trial.separable()))
        return (
            f"a further run of {MOST_POSES} poses cannot separate {suspected}: expected −2 log likelihood "
            f"between them {separation:.1f}, required {LEAST_SEPARATION:g}; {by_hand}"
        )
    elevations = (*chosen, *_confirming(limits_deg, rng))
    return FollowUp(names, separation, elevations, len(chosen), sweeps, wait_s)


class _Trial:
    """The poses so far with some that are only thought of, and how far apart they set the suspects."""

    def __init__(
        self,
        runs: Sequence[Sequence[Pose]],
        findings: Findings,
        others: Sequence[Candidate],
        suspects: Sequence[Candidate],
    ) -> None:
        self._runs = without_unused(runs)
        self._request = findings.responses.request
        self._noise: NoiseModel = findings.fitted.noise
        self._others, self._suspects = others, suspects
        r = with_free_levels(responses_of(self._runs, request=self._request))
        self._sizes = [self._size(r, suspect) for suspect in suspects]
        self.pairs = list(combinations(range(len(suspects)), 2))
        last = self._runs[-1][-1]
        self._pose_s = _pose_time_s(self._runs)
        self._temperature_c = last.temperature_c

    def _size(self, r: Responses, suspect: Candidate) -> FloatArray:
        columns = model_columns(r, [*self._others, suspect])
        return fit(r, columns).beta[-suspect.columns.shape[2] :]

    def separation(self, elevations_deg: Sequence[float], wait_s: float = 0.0) -> float:
        """Expected −2 log likelihood between the closest two suspects that are distinguishable at all."""
        if not self.pairs:
            return 0.0
        return min(self._distances(elevations_deg, wait_s).values())

    def keep_distinguishable(self, designs: Sequence[tuple[Sequence[float], float]]) -> None:
        """Drop the pairs of suspects that none of some rich designs would separate."""
        tried = [self._distances(elevations, wait_s) for elevations, wait_s in designs]
        self.pairs = [p for p in self.pairs if max(d[p] for d in tried) >= LEAST_SEPARATION]

    @property
    def names(self) -> tuple[str, ...]:
        """The suspects that a run may separate, in their order; all where none can be."""
        return tuple(dict.fromkeys(suspect.name for suspect in self.separable()))

    @property
    def covariates(self) -> set[str]:
        return {suspect.covariate for suspect in self.separable()}

    def separable(self) -> list[Candidate]:
        """Return the suspects that a run may separate; all where none can be."""
        within = {k for pair in self.pairs for k in pair} or range(len(self._suspects))
        return [self._suspects[k] for k in sorted(within)]

    def why_none(self, r: Responses, elevations_deg: Sequence[float]) -> str:
        """Return why nothing can be said of further poses; empty where it can."""
        further = self._with(elevations_deg, 0.0)
        if further.channels != r.channels:  # they bring in one that was exact
            return "a witness repeats the elevation exactly"
        there = self._suspects_in(with_free_levels(further))
        unknown = [suspect for suspect, again in zip(self._suspects, there, strict=True) if again is None]
        if len(there) - len(unknown) >= 2:
            return ""
        untold = " and ".join(dict.fromkeys(words_of(r, one) for one in unknown))
        return f"these poses do not determine how {untold} acts at other elevations or times"

    def _with(self, elevations_deg: Sequence[float], wait_s: float) -> Responses:
        return responses_of([*self._runs, self._imagined(elevations_deg, wait_s)], request=self._request)

    def _suspects_in(self, r: Responses) -> list[tuple[Candidate, FloatArray] | None]:
        """Each suspect in other poses with its sizes there; None where these are not known."""
        there: list[tuple[Candidate, FloatArray] | None] = []
        for suspect, sizes in zip(self._suspects, self._sizes, strict=True):
            again = predicted(suspect, r)
            known = None if again is None else coefficients_in(again, suspect, sizes)
            there.append(None if again is None or known is None else (again, known))
        return there

    def _distances(self, elevations_deg: Sequence[float], wait_s: float) -> dict[tuple[int, int], float]:
        """Of each pair that counts, with the one true that is the harder to tell."""
        r = with_free_levels(self._with(elevations_deg, wait_s))
        others = [c for c in (predicted(o, r) for o in self._others) if c is not None]
        known = [(k, one) for k, one in enumerate(self._suspects_in(r)) if one is not None]
        if not known:
            return dict.fromkeys(self.pairs, 0.0)
        shown = np.array([(effect.columns @ sizes) * r.known for _, (effect, sizes) in known])
        targets = self._noise.whiten(shown, r.starts).reshape(len(known), -1).T
        found: dict[tuple[int, int], float] = {}
        for j, (rival, _) in known:
            design = stacked(self._noise, r.starts, model_columns(r, [*others, rival]))
            left = targets - design @ np.linalg.lstsq(design, targets, rcond=1e-9)[0]
            for (k, _), distance in zip(known, (left**2).sum(axis=0), strict=True):
                if (pair := (min(j, k), max(j, k))) in self.pairs:
                    found[pair] = min(found.get(pair, math.inf), float(distance))
        return {pair: found.get(pair, 0.0) for pair in self.pairs}

    def _imagined(self, elevations_deg: Sequence[float], wait_s: float) -> list[Pose]:
        """Return poses as they would be measured, free of error, the second half of them after a wait."""
        template = self._runs[-1][0]
        poses: list[Pose] = []
        before, approach = self._runs[-1][-1].theta_deg, 0
        for k, elevation in enumerate(elevations_deg):
            move = elevation - before
            approach = int(np.sign(move)) or approach
            norm = math.radians(elevation)
            poses.append(
                Pose(
                    target_deg=elevation,
                    reading_deg=elevation,
                    approach=approach if template.approach is not None else None,
                    time_s=None
                    if template.time_s is None
                    else (k + 1) * self._pose_s + (wait_s if 2 * k >= len(elevations_deg) else 0.0),
                    temperature_c=self._temperature_c,
                    stage_deg=elevation if template.stage_deg is not None else None,
                    accel_x_g=None if template.accel_x_g is None else 0.0,
                    accel_y_g=None if template.accel_y_g is None else math.sin(norm),
                    accel_z_g=None if template.accel_z_g is None else math.cos(norm),
                    gyro_move_deg=None if self._runs[-1][-1].gyro_move_deg is None else move,
                    settle_s=template.settle_s,
                    covariates=dict(template.covariates),
                )
            )
            before = elevation
        return poses


def _greedy(
    trial: _Trial,
    limits_deg: tuple[float, float],
    rng: np.random.Generator,
    progress: Progress,
) -> list[float]:
    low, high = limits_deg
    step = (high - low) / (PLACES - 1)
    chosen: list[float] = [round(low, 3), round(high, 3)]
    while len(chosen) < MOST_POSES:
        grid = low + step * np.arange(PLACES) + rng.uniform(-step / 3, step / 3, PLACES)
        places = [round(float(p), 3) for p in np.clip(grid, low, high)]
        gains = [trial.separation([*chosen, place]) for place in places]
        best = max(gains)
        chosen.append(next(place for place, gain in zip(places, gains, strict=True) if gain >= best - SAME))
        progress(len(chosen) / MOST_POSES)
    return chosen


def _waits(runs: Sequence[Sequence[Pose]], suspects: Sequence[Candidate]) -> list[float]:
    """Between two sweeps, where time is a suspect: half of what the runs took, as long, and twice."""
    times = [pose.time_s for run in runs for pose in run if pose.time_s is not None]
    followed = [covariate_of(suspect.covariate) for suspect in suspects]
    if not times or not any(covariate.needs_time for covariate in followed):
        return []
    took_s = max(times) - min(times)
    return [round(share * took_s, 1) for share in (0.5, 1.0, 2.0)]


def _pose_time_s(runs: Sequence[Sequence[Pose]]) -> float:
    times = np.array([pose.time_s if pose.time_s is not None else np.nan for pose in runs[-1]])
    steps = np.diff(times)
    return float(np.nanmedian(steps)) if np.isfinite(steps).any() else 1.0


def _confirming(limits_deg: tuple[float, float], rng: np.random.Generator) -> list[float]:
    """Return poses over the whole range, from both sides, in random order."""
    low, high = limits_deg
    places = np.linspace(low + 0.1 * (high - low), high - 0.1 * (high - low), CONFIRMING_POSES)
    return [round(float(p), 3) for p in rng.permutation(places)]


def predicted(candidate: Candidate, r: Responses) -> Candidate | None:
    """Return a candidate in poses that it was not found in; a shape without a name says nothing of others."""
    return rebuilt(candidate, r) if candidate.named else None


ERROR_RATE = 0.01
"""Of naming the wrong one of two suspects, either way."""
DECIDED = 2.0 * math.log((1.0 - ERROR_RATE) / ERROR_RATE)
"""In −2 log likelihood (Wald, Sequential Analysis, 1947: A = (1 − β)/α, B = β/(1 − α))."""
FEWEST_POSES = 3


class SequentialTest:
    """Holds the suspects of a diagnosis against each other with every new pose.

    The likelihoods are maximised over all other parameters, so that the error rates hold for many poses and
    nearly so for the few of a follow-up.
    """

    def __init__(self, runs: Sequence[Sequence[Pose]], findings: Findings) -> None:
        self._runs = without_unused(runs)
        self._request = findings.responses.request
        found = ambiguous_of(findings)
        self._suspects = () if found is None else (found.candidate, *found.rivals)
        self._others = [f.candidate for f in findings.found if f is not found]

    def decided(self, poses: Sequence[Pose]) -> bool:
        """Whether one suspect leads all others by more than the test's bound, with the new poses taken in."""
        if len(poses) < FEWEST_POSES or len(self._suspects) < 2:
            return False
        r = with_free_levels(responses_of([*self._runs, list(poses)], request=self._request))
        others = [again for other in self._others if (again := predicted(other, r)) is not None]
        criteria = sorted(
            fit(r, model_columns(r, [*others, suspect])).criterion
            for candidate in self._suspects
            if (suspect := predicted(candidate, r)) is not None
        )
        return len(criteria) > 1 and criteria[1] - criteria[0] > DECIDED
